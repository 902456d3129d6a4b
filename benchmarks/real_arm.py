# SPDX-License-Identifier: Apache-2.0
"""What the benchmarks on real arms share: where the logs are, the peer's plain fit, what is handed over, and the lines."""

from __future__ import annotations

import argparse
import importlib
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from results import result
from yardstick import PINOCCHIO, pinocchio_seconds

from trueup.identification.delivery.folder import deliver
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.estimation import identify as module
from trueup.identification.estimation.consistent import consistent_fit
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.moments import moments_of, weighted_fit
from trueup.identification.estimation.result import Identification, Prediction, relative_error
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.rows import Rows
from trueup.identification.torque_model import TorqueModel
from trueup.recording import Recording

Array = NDArray[np.float64]


def data_folder() -> Path:
    """The folder of recordings of real robots: TRUEUP_DATA, else shared/data beside the project."""
    said = os.environ.get("TRUEUP_DATA")
    folder = Path(said) if said else Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        raise SystemExit(f"no recordings of real robots in {folder}; set TRUEUP_DATA to their folder")
    return folder


def arguments(what: str | None) -> argparse.Namespace:
    """--quick is taken as every benchmark takes it; these are quick anyway."""
    parser = argparse.ArgumentParser(description=what)
    parser.add_argument("--quick", action="store_true", help="nothing is left out")
    return parser.parse_args()


def show(found: Identification, plain: Identification) -> None:
    """Errors by joint of ours, of ours with possible bodies, and of a plain fit."""
    print(f"{'joint':24s} ours %   possible bodies %   plain fit %     effects kept")
    rows = [_by_joint(found, "fitted"), _by_joint(found, "consistent"), _by_joint(plain, "fitted")]
    for j, joint in enumerate(found.joints):
        errors = "   ".join(f"{row[j]:10.2f}" for row in rows)
        print(f"{joint:24s}{errors}     {', '.join(found.structure[j])}")
    for name, which in (("fitted", found), ("plain fit", plain)):
        print(
            f"{name}: trained {100 * relative_error(which.training()):.3f} %, "
            f"held out {100 * relative_error(which.held_out()):.3f} %"
        )
    for sentence in found.warnings:
        print("mind:", sentence)


def _by_joint(found: Identification, which: str) -> Array:
    from trueup.identification.estimation.result import relative_errors

    return 100.0 * relative_errors(found.held_out(), which)


def held_out(name: str, urdf: Path, tree: KinematicTree, runs: Sequence[Recording], *, goal: float) -> None:
    """The protocol of Panda and UR10: 10 Hz, the last 30 % held out; peer: Coulomb, viscous, offset, weighted, unaligned."""
    options = Options(cutoff=10.0, hold_out=0.3)
    found, seconds = timed_consistent(tree, runs, options)
    free = identify(tree, runs, options=replace(options, consistent=False))
    plain = identify(tree, runs, options=replace(options, structure="common", align="off", consistent=False))
    show(found, plain)
    peer = 100.0 * relative_error(plain.held_out())
    result(
        f"{name}_held_out_relative_percent", 100.0 * relative_error(found.held_out()), "%", goal,
        peer="weighted least squares with Coulomb, viscous, offset", peer_value=peer,
    )  # fmt: skip
    consistent_lines(name, found, free, seconds)
    delivered_lines(name, found, tree, urdf)


def timed_consistent(
    tree: KinematicTree, runs: Sequence[Recording], options: Options, drives: Drives | None = None
) -> tuple[Identification, float]:
    """The identification, and the CPU time in s that possible bodies took, the choice of their pull to the file included."""
    took: list[float] = []
    real = module.cross_validated_fit

    def timed(*given: Any, **more: Any) -> Any:
        begun = time.process_time()
        made = real(*given, **more)
        took.append(time.process_time() - begun)
        return made

    with patch.object(module, "cross_validated_fit", timed):
        identify(tree, runs, drives=drives, options=options)  # once to warm up
        return identify(tree, runs, drives=drives, options=options), took[-1]


def consistent_lines(name: str, found: Identification, free: Identification, seconds: float) -> None:
    """What possible bodies cost against a fit that knows nothing of bodies, in accuracy and time."""
    possible, without = relative_error(found.held_out(), "consistent"), relative_error(free.held_out())
    print(f"unconstrained: held out {100 * without:.3f} %, possible bodies {100 * possible:.3f} %")
    result(f"{name}_consistent_over_unconstrained", possible / without, "", 1.02)
    result(f"{name}_consistent_seconds", seconds, "s", 1.0, peer=f"{PINOCCHIO}, a hundred thousand samples",
           peer_value=pinocchio_seconds(1e5), ratio_goal=True)  # fmt: skip


def delivered_lines(name: str, found: Identification, tree: KinematicTree, urdf: Path) -> None:
    """How good the files are that are handed over: evaluated by others (Pinocchio, a C compiler) from the files alone."""
    with tempfile.TemporaryDirectory() as scratch:
        parts, _ = deliver(found, urdf, scratch)
        by_name = {d.name: d for d in parts}
        evaluated = _in_pinocchio(Path(scratch) / urdf.name, tree)
        held = found.held_out()
        written = _error(held, [p.by(evaluated) for p in held if p.by is not None])
    fit, form = by_name["fit"].relative(held_out=True), _best_of_form(found, tree)
    print(
        f"held out: fit {100 * fit:.3f} %, model file in Pinocchio {100 * written:.3f} %, best of its form {100 * form:.3f} %"
    )
    result(
        f"{name}_written_over_form", written / form, "", 1.05,
        peer="the best direct fit of possible bodies, rotors, Coulomb and viscous friction",
    )  # fmt: skip
    result(f"{name}_written_over_fit", written / fit, "", 2.5)
    result(f"{name}_predictor_over_fit", by_name["predictor"].relative(held_out=True) / fit, "", 1.001)
    header = by_name["C header"]
    result(f"{name}_header_difference", header.difference, found.unit, 1e-9)
    result(f"{name}_header_call_us", 1e6 * header.seconds, "us", 2.0)


def _in_pinocchio(urdf: Path, tree: KinematicTree) -> Callable[[Array, Array, Array], Array]:
    """Torque by Pinocchio from the URDF and the SRDF beside it; joints that are not identified are held at zero."""
    pin: Any = importlib.import_module("pinocchio")
    whole: Any = pin.buildModelFromUrdf(str(urdf))
    pin.loadRotorParameters(whole, str(urdf.with_suffix(".srdf")), False)
    still = [whole.getJointId(name) for name in list(whole.names)[1:] if name not in tree.joints]
    at = [whole.idx_vs[whole.getJointId(name)] for name in tree.joints]
    friction, damping = (np.array(x)[at] for x in (whole.friction, whole.damping))
    model: Any = pin.buildReducedModel(whole, still, np.zeros(whole.nq))
    data, order = model.createData(), [model.idx_vs[model.getJointId(name)] for name in tree.joints]

    def torque(q: Array, v: Array, a: Array) -> Array:
        made, state = np.empty_like(q), np.zeros((3, model.nv))
        for k in range(len(q)):
            state[:, order] = q[k], v[k], a[k]
            made[k] = pin.rnea(model, data, *state)[order]
        return made + damping * v + friction * np.sign(v)

    return torque


def _error(predictions: Sequence[Prediction], said: Sequence[Array]) -> float:
    squares = sum(float(np.sum((p.measured - x) ** 2)) for p, x in zip(predictions, said, strict=True))
    return float(np.sqrt(squares / sum(float(np.sum(p.measured**2)) for p in predictions)))


def _best_of_form(found: Identification, tree: KinematicTree) -> float:
    """The least held-out error of possible bodies, rotors, Coulomb and viscous friction of joints, fitted to the rest.

    Four fits, joints weighed by their noise or alike, the file's bodies as good as ignored or not: the best counts.
    """
    n = tree.n
    model = DynamicModel.with_friction(tree, ("coulomb", "viscous"))
    p, rows = model.p, []
    for prediction in found.predictions:
        assert prediction.by is not None
        columns = [prediction.by(_of_column(model, k)) for k in range(p)]
        values = tuple(np.array([c[:, j] for c in columns]) for j in range(n))
        rows.append(Rows(tuple(np.arange(p) for _ in range(n)), values, prediction.measured, prediction.time, p))
    fitted = moments_of([r for r, x in zip(rows, found.predictions, strict=True) if not x.held_out])
    base = model.only(range(n)).base(np.repeat([2.0, 1.0], [10 * n, n]))
    active = np.concatenate([base.independent, np.arange(11 * n, p)])
    spread = weighted_fit(fitted, active, np.zeros(p))[1]
    prior = np.where(np.isfinite(nominal := model.nominal()), nominal, 0.0)
    held = [(r, x) for r, x in zip(rows, found.predictions, strict=True) if x.held_out]
    errors = []
    for weights in (1.0 / spread / np.mean(1.0 / spread), np.ones(n)):
        for pull in (1e-6, 1e-3):
            fit = consistent_fit(model, fitted.normal(weights).whole(), active, prior, pull=pull).parameters
            errors.append(_error([x for _, x in held], [r.predict(fit) for r, _ in held]))
    return min(errors)


def _of_column(model: DynamicModel, k: int) -> Callable[[Array, Array, Array], Array]:
    """Torque of one unit of a parameter."""
    one = TorqueModel.of(model, np.eye(model.p)[k], np.zeros((model.tree.n, 10)), ())
    return one.torque
