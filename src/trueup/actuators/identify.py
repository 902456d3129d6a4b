# SPDX-License-Identifier: Apache-2.0
"""From recordings of one servo to a model of it: what joins the rest."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from trueup.actuators.actuator import Actuator, Judged, mjcf_text, replay_text
from trueup.actuators.bench import Bench, Run, runs_of
from trueup.actuators.choose import Chooser, Model, choose
from trueup.actuators.experiment import Value, experiment
from trueup.actuators.fit import Problem, Slopes, coarseness, spread
from trueup.actuators.output import output_of
from trueup.actuators.structures import (
    ASKEW,
    BY_NAME,
    DELAY,
    FORCE,
    LIMIT,
    LIMITS,
    LOAD,
    PUNCH,
    QUADRATIC,
    RATIO,
    VISCOUS,
    ZERO,
    Scales,
    declared,
    law_of,
)
from trueup.arrays import Array
from trueup.articulated.gains import Gains
from trueup.errors import CalibrationError, unknown_name
from trueup.evidence import evidence, half_interval, jackknife
from trueup.inspection.pauses import parted_at_pauses
from trueup.inspection.spikes import without_lone_spikes
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.trial import STEP

_SOFTER = (
    "kp, kd and kc by regression: friction grows with the load here, which a regression takes for a softer servo; take "
    "those by simulation"
)


def identify_actuator(
    recordings: Sequence[Recording], hold_out: Sequence[Recording] = (), *, bench: Bench | None = None, joint: str = "",
    step: float = STEP, ask: Sequence[str] | None = None, told: Callable[[str, float], None] = lambda *_: None,
) -> Actuator:  # fmt: skip
    """A servo that moves a known load: its law, by the structures that left-out recordings want.

    `bench` says what it carries (where the recordings do not name mass and length), `ask` which structures are asked about
    (None: all), `told(what, error)` is called on the way.

    Raises RecordingError, ParameterError, CalibrationError, UnknownNameError.
    """
    began = time.perf_counter()
    ask = _structures(ask)
    fitted, kept, gains, notes = _runs(recordings, hold_out, bench or Bench(), joint)
    runs = [*fitted, *kept]
    if not fitted:
        raise CalibrationError("no recordings to identify a servo from: all are held out")
    shown = output_of(fitted)
    full = np.inf if shown is None else shown.full_error
    seen, notes = experiment(fitted, full), [*notes, *([] if shown is None else [shown.sentence])]
    common = {"bench": fitted[0].bench, "setting": gains.given_for.get("kp", 0.0), "step": step}
    if not all(run.bench.known for run in runs):
        notes.append(
            "nothing is simulated: without a known load (--mass and --length, or --inertia) torques have no scale"
        )
        return Actuator(None, None, (), (), (), experiment=seen, judged=(), runs=tuple(runs), notes=tuple(notes),
                        seconds=time.perf_counter() - began, **common)  # fmt: skip
    problem = Problem(fitted, step)
    fixed = {"full_error": full} if np.isfinite(full) else {}
    chooser = Chooser(problem, declared(Scales.of(fitted)), fixed)
    never = {*(() if shown is None else (LIMIT,) if fixed else LIMITS), *_untellable(fitted)}
    model, asked = choose(chooser, [n for n in ask if n not in never], told)
    hangs = {n: x for n, x in model.optimum.values.items() if n == "hangs_at"}
    if hangs:
        runs = [r.hung(**hangs) for r in runs]
        seen, common["bench"] = experiment(runs[: len(fitted)], full), runs[0].bench
        notes += [f"the load hangs straight down at {hangs['hangs_at']:.3g} rad, by the recordings themselves"]
    if LOAD in model.structures and seen.gains:
        seen = replace(seen, cannot=(*seen.cannot, _SOFTER))
    told("what a file can hold", model.error)
    held = Chooser(Problem(fitted, step, file=True), chooser.declared, {**fixed, **hangs, "back_emf": 0.0})
    file, said = _held_by_a_file(held, model, PUNCH in ask)
    judged = (*_left_out(problem, model, file), *(_held_out(r, problem, model, file) for r in kept))
    return Actuator(law_of(model.optimum.values), law_of(file.optimum.values), tuple(_values(problem, model)),
                    (*([LIMIT] if fixed else []), *model.structures), tuple(asked), experiment=seen,
                    judged=judged, runs=tuple(runs),
                    notes=(*notes, *said), seconds=time.perf_counter() - began, **common)  # fmt: skip


def _runs(
    recordings: Sequence[Recording], hold_out: Sequence[Recording], bench: Bench, joint: str
) -> tuple[list[Run], list[Run], Gains, list[str]]:
    """Runs to fit and runs to judge by, in parts where the logger stopped, without spikes; see `runs_of`."""
    sound, spikes = without_lone_spikes([*recordings, *hold_out])
    (parts, paused), (others, also_paused) = (
        parted_at_pauses(own) for own in (sound[: len(recordings)], sound[len(recordings) :])
    )
    runs, gains, notes = runs_of([*parts, *others], bench, joint)
    return runs[: len(parts)], runs[len(parts) :], gains, [*notes, *spikes, *paused, *also_paused]


def _structures(ask: Sequence[str] | None) -> Sequence[str]:
    """Those that are asked about by name. Raises UnknownNameError."""
    for name in ask or ():
        if name not in BY_NAME:
            raise unknown_name("structure", name, list(BY_NAME), "those of a servo")
    return tuple(BY_NAME) if ask is None else ask


def _untellable(runs: Sequence[Run]) -> tuple[str, ...]:
    """Structures that these runs cannot tell: firmware whose damping follows its gain is back-EMF at one setting, and where a
    load without a moment hangs is nowhere.
    """
    one_setting = len({run.gain for run in runs}) == 1
    hanging = any(run.bench.moment > 0.0 for run in runs)
    return (*((RATIO,) if one_setting else ()), *(() if hanging else (ASKEW,)))


def _held_by_a_file(held: Chooser, model: Model, onset: bool) -> tuple[Model, list[str]]:
    """The nearest servo that MJCF can hold, and notes: its damping also acts while the motor is off, so it is fitted so.

    A limit and a delay that were found stay unless left-out recordings are replayed better without, as where either only
    makes up for what the file cannot hold; what else it has a place for goes in where they want it.
    """
    # without back-EMF both limits are one range of force
    limits = [n for n in (FORCE, LIMIT) if n in model.structures][:1]
    both = [*limits, *(n for n in (DELAY,) if n in model.structures)]
    ways = [some for count in range(len(both), -1, -1) for some in combinations(both, count)]
    file = min((held.plain((VISCOUS, *some)) for some in ways), key=lambda m: m.error)
    for name in (*(n for n in (QUADRATIC, ZERO) if n in model.structures), *((PUNCH,) if onset else ())):
        richer = held.plain((*file.structures, name))
        if evidence(file.errors, richer.errors).holds:
            file = richer
    said = "the MJCF has a second actuator at the joint, for the same command: it gives the steep onset of torque"
    return file, [said] if PUNCH in file.structures else []


def _values(problem: Problem, model: Model) -> list[Value]:
    """Values with 95 % intervals by Student's t with as many degrees of freedom as blocks but one.

    The wider of two: by how differently the blocks pull at the optimum, and by where fits without each of them went (the
    jackknife), which also sees what is not smooth. What the replay's own steps put into the values comes on top: the servo
    has none.
    """
    found = model.optimum
    space = ParameterSpace(found.searched)
    whole = space.to_unit([found.values[n] for n in space.names])
    each = space.to_unit([[v[n] for n in space.names] for v in model.left_out])
    slopes = Slopes.at(problem, found)
    half = half_interval(len(each)) * np.maximum(np.sqrt(np.diag(spread(problem, slopes))), jackknife(each))
    half += coarseness(problem, found, slopes)
    low, high = (space.from_unit(np.clip(whole + sign * half, 0.0, 1.0)) for sign in (-1.0, 1.0))
    return [
        Value(p.name, found.values[p.name], float(a), float(b), p.unit)
        for p, a, b in zip(space.parameters, low, high, strict=True)
    ]


def _left_out(problem: Problem, model: Model, file: Model) -> list[Judged]:
    """Each fitted run by fits that never saw it, stretch by stretch where stretches were left out."""
    rows = []
    for k, run in enumerate(problem.runs):
        total = np.zeros(2)
        for block, values, held in zip(problem.blocks, model.left_out, file.left_out, strict=True):
            if block.run == k:
                misses = np.stack([problem.misses(values, run), _file_misses(held, run, problem.step)])
                total += np.abs(misses[:, block.samples]).sum(axis=1) / len(run.time)
        rows.append(Judged(run.name, False, float(total[0]), float(total[1])))
    return rows


def _held_out(run: Run, problem: Problem, model: Model, file: Model) -> Judged:
    misses = problem.misses(model.optimum.values, run), _file_misses(file.optimum.values, run, problem.step)
    return Judged(run.name, True, *(float(np.mean(np.abs(m))) for m in misses))


def _file_misses(values: Mapping[str, float], run: Run, step: float) -> Array:
    """(T,) rad by which MuJoCo's replay of one run with the MJCF of these values is off, with the run's own load."""
    bench = run.hung(values.get("hangs_at")).bench
    return replay_text(mjcf_text(law_of(values), bench, step), run) - run.position
