# SPDX-License-Identifier: Apache-2.0
"""The model folder: every form of what was identified, written, read back from disk, and judged as it is there."""

from __future__ import annotations

import json
import runpy
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from trueup.arrays import Array
from trueup.errors import OutputError, listed
from trueup.formats.aside import write_aside
from trueup.identification.delivery.compiled import Compiled, compiled
from trueup.identification.delivery.model_file import read_back, write_model_file
from trueup.identification.delivery.source import c_header, prefix, python_file
from trueup.identification.estimation.result import Deliverable, Identification, Prediction, log_errors
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.torque_model import FILE, TorqueModel, load

HEADER, PYTHON = "torque.h", "torque.py"


def deliver(
    result: Identification, model: str | Path, folder: str | Path
) -> tuple[tuple[Deliverable, ...], tuple[str, ...]]:
    """Writes predictor, header, Python file and model file into `folder`; returns each with its errors, and notes.

    `model` is the file that the tree was read from. Raises OutputError, and ModelError for a model file that cannot be
    written.
    """
    tree, where, source, notes = result.model.tree, Path(folder), Path(model), tuple[str, ...]()
    if (where / source.name).resolve() == source.resolve():
        raise OutputError(f"{source} is the model that was given; name another folder")
    parts = [_fit(result)]
    texts = ((FILE, json.dumps(result.model.to_dict(), indent=1) + "\n"), (HEADER, c_header(result.model)),
             (PYTHON, python_file(result.model)))  # fmt: skip
    for name, text in texts:
        write_aside(text, where / name)
    predictor = load(where)
    parts += [
        _predictor(result, predictor),
        _header(result, where / HEADER),
        _python(result, predictor, where / PYTHON),
    ]
    if result.for_file is not None:
        notes = write_model_file(result.for_file, tree, source, where / source.name)
        parts += _model_file(result, tree, where / source.name, parts[0])
    return tuple(parts), notes


def _fit(result: Identification) -> Deliverable:
    errors = log_errors(result.predictions, [p.fitted for p in result.predictions])
    return Deliverable("fit", (), "all that was identified; what the files below are compared with", errors, 0.0)


def _predicted_torques(result: Identification, model: TorqueModel | Compiled) -> list[Array]:
    """(S, n) what a model says of each log; the fit itself where the log is no longer at hand."""
    return [p.fitted if p.by is None else p.by(model.torque) for p in result.predictions]


def _predictor(result: Identification, predictor: TorqueModel) -> Deliverable:
    use, said = (
        "computed torque, observers, analysis: trueup.load(FOLDER).torque(q, qd, qdd)",
        _predicted_torques(result, predictor),
    )
    return Deliverable(
        "predictor",
        (FILE,),
        use,
        log_errors(result.predictions, said),
        _furthest(result.predictions, said),
    )


def _header(result: Identification, path: Path) -> Deliverable:
    use, p = "control loops in C or C++: the same, without memory or libraries", result.predictions[0]
    with compiled(path, prefix(result.model)) as runs:
        if isinstance(runs, str):
            return Deliverable("C header", (path.name,), use, note=f"not run here: {runs}")
        said = _predicted_torques(result, runs)
        seconds = runs.seconds(p.position, p.velocity, np.zeros_like(p.velocity))
    return Deliverable(
        "C header",
        (path.name,),
        use,
        log_errors(result.predictions, said),
        _furthest(result.predictions, said),
        seconds,
    )


def _python(result: Identification, predictor: TorqueModel, path: Path) -> Deliverable:
    """The Python file, compared with the predictor at the first instants of a log."""
    compared = 100  # Instants at which the Python file is compared: it takes a tenth of a millisecond for each
    p = result.predictions[0]
    q, v = p.position[:compared], p.velocity[:compared]
    a = np.gradient(v, p.time[:compared], axis=0)
    names = runpy.run_path(str(path))
    state, begun = names["State"](), time.perf_counter()
    said = [names["torque"](*instant, state) for instant in zip(q.tolist(), v.tolist(), a.tolist(), strict=True)]
    seconds = (time.perf_counter() - begun) / len(said)
    return Deliverable(
        "Python file", (path.name,), "the same where trueup is not installed", (),
        float(np.abs(np.array(said) - predictor.torque(q, v, a)).max()), seconds,
        f"compared with the predictor at {len(said)} instants",
    )  # fmt: skip


def _model_file(result: Identification, tree: KinematicTree, path: Path, fit: Deliverable) -> list[Deliverable]:
    """The model file that was written, and the one that was given."""
    read, held = read_back(path, tree), bool(result.held_out())
    written = TorqueModel.of_file(read, result.units)
    files = tuple(f.name for f in (path, path.with_suffix(".srdf")) if f.is_file())
    errors = log_errors(result.predictions, _predicted_torques(result, written))
    made = Deliverable("model file", files, "simulators: possible bodies, rotors, Coulomb and viscous friction", errors)
    note = f"{made.relative(held_out=held) / fit.relative(held_out=held):.2f} times the error of the fit: what its form costs"
    if np.count_nonzero(result.model.drives) > tree.n:
        note += "; it has no place for friction and rotors of drives that turn with two joints"
    springs = result.for_file.springs if result.for_file else ()
    lacking = [j for j, said, k in zip(tree.joints, springs, read.stiffness, strict=False) if said and not k]
    note += f"; it has no place for the spring of {listed(lacking)}" if lacking else ""
    given = [p.file for p in result.predictions if p.file is not None]
    before = (
        [Deliverable("model file as given", (), "for comparison", log_errors(result.predictions, given))]
        if given
        else []
    )
    return [replace(made, note=note), *before]


def _furthest(predictions: Sequence[Prediction], said: Sequence[Array]) -> float:
    return max(float(np.abs(p.fitted - x).max()) for p, x in zip(predictions, said, strict=True))
