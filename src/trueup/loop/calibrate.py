# SPDX-License-Identifier: Apache-2.0
"""Makes a simulator replay recordings of the robot: fit, choose what the data support, say how sure it is."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Calibration, CrossValidation, Estimate, Replay
from trueup.controllers.controller import ControllerFactory
from trueup.discrepancies.discrepancy import Discrepancy
from trueup.discrepancies.weighted import Weighted
from trueup.ends import End
from trueup.engines.simulator import Simulator
from trueup.errors import CalibrationError
from trueup.loop.changed import changes
from trueup.loop.checks import check
from trueup.loop.chooser import Chooser
from trueup.loop.earlier import Earlier
from trueup.loop.fit import Checkpoint, Fit, Progress, Stage, Watch, fit, searched_by
from trueup.loop.horizon import cut_for_search
from trueup.loop.identifiability import unseen_directions, verdicts
from trueup.loop.limits import Seen, is_limit, limits_seen
from trueup.loop.missing import Missing, missing, unasked_by
from trueup.loop.problem import Problem
from trueup.loop.replay import replays
from trueup.loop.rivals import SAME, doubted, rivals, widened
from trueup.loop.selection import Choice
from trueup.loop.ties import STEP, Considered, considered
from trueup.loop.uncertainty import intervals, unit_covariance
from trueup.loop.untold import as_open, open_covariance
from trueup.loop.validate import by_recording, left_out_errors
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import PART_OF, Recording
from trueup.search.least_squares import LeastSquares

_LOOSE = 0.5  # share of a value beyond which half of its interval is no knowledge of it


@dataclass(frozen=True)
class Options:
    """How to calibrate; the defaults are meant to be right."""

    search: str = "auto"
    """'auto', 'gradient', 'cma-es' or 'hybrid'."""
    select: bool = True
    """Freeze what the recordings cannot tell, and leave out optional structures that do not help."""
    robust: float = 3.0
    """Residuals beyond this many robust standard deviations count less; inf for plain least squares."""
    channels: tuple[str, ...] | None = None
    """Which measured channels to fit. None: positions and sensors that the simulator reproduces, or whatever there is;
    velocities repeat positions, and torques are often currents of unknown scale, so both wait to be asked for."""
    seed: int = 0
    cross_validate: bool = True
    later: tuple[str, ...] = ()
    """Optional structures (`Parameter.optional`) that are tried from the fit without them, beside those that say what it is
    like to be `Parameter.absent`."""
    windows: float | None = None
    """Recordings are replayed in windows of so many s, each from where the robot was measured to be then; inf: whole. None:
    as short as an unstable robot needs, or one that walks (`loop.windows`), whole with a discrepancy or controllers."""
    stages: tuple[Stage, ...] | None = None
    """What the search does, one thing after the other (`trueup.loop.fit.STAGES`), in place of `search`."""
    ends: tuple[End, ...] = ()
    """Conditions that stop a simulated run early: its last state is then compared with what the robot went on to do."""
    lacking: bool = False
    """Ask recordings of more than a minute, too, what the simulator lacks, which can double the time."""
    solver: Callable[..., LeastSquares] = LeastSquares
    """Makes the least squares that every look at the recordings is solved by."""


def calibrate(
    simulator: Simulator, recordings: Sequence[Recording], hold_out: Sequence[Recording] = (), *,
    options: Options | None = None, discrepancy: Discrepancy | None = None, controllers: ControllerFactory | None = None,
    progress: Progress | None = None, checkpoint: Checkpoint | None = None, resume: dict[str, Any] | None = None,
    space: ParameterSpace | None = None, start: Array | None = None, earlier: Earlier | None = None,
) -> Calibration:  # fmt: skip
    """Fits the simulator's free parameters to `recordings`, and judges the result on `hold_out` too.

    `space` may freeze more of them, `start` (n,) are values to search from (None: the nominal ones);
    `earlier` knew some of the recordings, and what its model lacks is not asked as if it had not.

    Raises CalibrationError where nothing can be fitted and SimulationFailedError where the start values already fail.
    """
    began, cpu, warnings = time.perf_counter(), time.process_time(), check(recordings, hold_out)
    space = simulator.parameters if space is None else space
    chosen = _with_entering(options or Options(), space)
    left, chosen_before = _searched(space, chosen.later, resume)
    channels = sorted({c for r in recordings for c in simulator.observable(r)})
    measure = discrepancy or Weighted.estimated(recordings, channels)
    fitted = chosen.channels or usual(channels)
    problem = Problem(simulator, recordings, measure, fitted, controllers=controllers, ends=chosen.ends)
    waiting = [p.name for p in space.parameters if p.optional in chosen.later and not p.frozen]
    begin = space.without(waiting).nominal if start is None else start
    free = chosen.windows is None and discrepancy is None and controllers is None
    smooth = space.without(waiting) if free else None
    problem, led, lasting, cut = cut_for_search(problem, begin, smooth, chosen.windows or np.inf, chosen.seed)
    watch, chooser = Watch(progress, checkpoint), Chooser()
    select = chooser if chosen.select and not chosen_before else None
    found = fit(problem, left, led if start is None else start, watch, resume=resume, select=select, **_how(chosen))
    if chosen.select:
        found = chooser.ended(problem, found, watch, {**_how(chosen), "later": ()})
    watch.saw("what the model lacks", problem, found.loss, problem.rmse(found.residual))
    findings = _findings(problem, found, chooser.choices, cut, earlier, chosen.lacking)  # before the seconds
    watch.saw("left-out recordings", problem, found.loss, problem.rmse(found.residual))
    shown = replays(simulator, found.values, recordings, hold_out, measure, channels=fitted, controllers=controllers,
                    windows=lasting)  # fmt: skip
    crossing = chosen.cross_validate and len(recordings) > 1
    return Calibration(
        replays=shown,
        cross_validation=_cross_validation(problem, found, [r for r in shown if not r.held_out]) if crossing else (),
        trace=tuple(watch.trace),
        warnings=(*warnings, *changes(problem, found)),
        seconds=time.perf_counter() - began,
        cpu_seconds=time.process_time() - cpu,
        evaluations=problem.evaluations,
        **findings,
    )  # fmt: skip


def _with_entering(options: Options, space: ParameterSpace) -> Options:
    """With the structures that say what it is like to be without them among those that are tried later."""
    entering = [p.optional for p in space.parameters if p.optional and p.absent is not None]
    return replace(options, later=tuple(dict.fromkeys((*options.later, *entering))))


def _searched(
    space: ParameterSpace, later: Sequence[str], resume: dict[str, Any] | None
) -> tuple[ParameterSpace, bool]:
    """What is searched, and whether an interrupted search had already chosen from it. Raises CalibrationError."""
    if not space.free.any():
        raise CalibrationError("all parameters are frozen: nothing to calibrate")
    frozen, waiting = ([], later) if resume is None else (resume.get("frozen", ()), resume.get("waiting", later))
    gone = [n for n in frozen if space[n].optional not in waiting]
    asked = [n for n in gone if space[n].optional in later]
    left = space.freeze(gone).without(asked)
    past = set(later).difference(waiting)  # what was kept of these is no longer asked about
    left = ParameterSpace(tuple(p.replace(optional="") if p.optional in past else p for p in left.parameters))
    return left, len(gone) - len(asked) > int((~space.free).sum())


def _how(options: Options) -> dict[str, Any]:
    stages = options.stages or searched_by(options.search)
    return {"stages": stages, "robust": options.robust, "seed": options.seed, "solver": options.solver,
            "later": options.later}  # fmt: skip


def usual(channels: Sequence[str]) -> tuple[str, ...]:
    """The channels that are compared unless told otherwise (see `Options.channels`)."""
    return tuple(c for c in channels if c not in ("velocity", "torque")) or tuple(channels)


def _findings(
    problem: Problem, found: Fit, choices: Sequence[Choice], cut: Sequence[str], earlier: Earlier | None, ask: bool
) -> dict[str, Any]:
    """The fields of a Calibration that follow from the fit alone; `cut`: what is said of windows."""
    covariance = unit_covariance(problem, found)
    unasked = () if ask else unasked_by(problem, found)
    lacking = None if unasked else missing(problem, found, earlier)
    notes = (*found.notes, *(n for c in choices[1:] for n in c.notes), *unasked)
    limits = limits_seen(problem, found)
    declared = problem.simulator.parameters
    untold = [declared[n] for n in (choices[0].freeze if choices else ()) if found.space[n].frozen]
    open_, shared = open_covariance(problem, found, untold)
    estimates = _estimates(found, open_, choices, declared, limits, notes)
    known, opened = (verdicts(found, c) for c in (covariance, open_))
    estimates = as_open(estimates, known, opened, shared, [p.name for p in untold])
    others = rivals(problem, found)
    wide = widened(_with_structure(estimates, lacking), others)
    return {
        "model_name": problem.simulator.name,
        "estimates": doubted(_tied(wide, considered(problem, found, covariance), limits), others),
        "covariance": _in_units(found, covariance),
        "unidentified": (*unseen_directions(found, covariance, limits), *(n for c in choices[:1] for n in c.notes)),
        "notes": (*cut, found.ended, *notes),
        "lacking": lacking.words() if lacking else "",
        "lacked": lacking.lacked(p.name for p in found.space.parameters if not p.frozen) if lacking else None,
    }  # fmt: skip


def _estimates(
    found: Fit,
    covariance: Array,
    choices: Sequence[Choice],
    declared: ParameterSpace,
    limits: Mapping[str, Seen],
    notes: Sequence[str],
) -> tuple[Estimate, ...]:
    low, high = intervals(found, covariance)
    words = iter(zip(low, high, verdicts(found, covariance), strict=True))
    unseen, vague = (choices[0].freeze, choices[0].vague) if choices else ((), ())
    rows = []
    for p, start, value in zip(found.space.parameters, declared.nominal, found.values, strict=True):
        lo, hi, verdict = (nan, nan, None) if p.frozen else next(words)
        if verdict is not None and p.name not in unseen:
            word, note = verdict.word, verdict.note
            if seen := limits.get(p.name):
                if seen.word == "identified" and word in ("identified", "weak"):  # slopes know what jumps leave unsure
                    lo, hi = min(lo, seen.low), max(hi, seen.high)
                else:
                    lo, hi = seen.low, seen.high
                word, note = seen.word, seen.note
            elif word == "not identified" and p.name in vague:
                word, note = (
                    "weak",
                    "left-out recordings replay better with it than at its start value, yet it is vague",
                )
        else:
            word, note = _frozen(declared[p.name], unseen, notes)
        rows.append(
            Estimate(p.name, p.unit, float(start), float(value), float(lo), float(hi), p.lower, p.upper, not p.frozen, word,
                     note, absent=p.frozen and ((is_limit(p) and value == p.absent) or value == p.unidentified))
        )  # fmt: skip
    return tuple(rows)


def _with_structure(estimates: Sequence[Estimate], lacking: Missing | None) -> tuple[Estimate, ...]:
    """With intervals that hold whether the robot has a structure or not, and a word for what replays best in its place."""
    if lacking is None:
        return tuple(estimates)
    free = iter(zip(lacking.values, lacking.low, lacking.high, strict=True))
    rows = []
    for e in estimates:
        if e.fitted:
            value, low, high = map(float, next(free))
            wide = replace(e, low=min(e.low, low), high=max(e.high, high))
            if e.verdict in ("identified", "weak") and abs(value - e.value) > SAME * abs(e.value):
                wide = replace(wide, verdict="effective", note=f"replays best, yet with {lacking.name} it would be "
                               f"{value:.4g} [{low:.4g}, {high:.4g}] {e.unit}".rstrip())  # fmt: skip
            elif e.verdict == "identified" and wide.high - wide.low > 2.0 * _LOOSE * abs(e.value):
                wide = replace(wide, verdict="weak", note=f"known roughly only: the model lacks {lacking.name}")
            e = wide
        rows.append(e)
    return tuple(rows)


def _tied(
    estimates: Sequence[Estimate], others: Sequence[Considered], limits: Mapping[str, Seen]
) -> tuple[Estimate, ...]:
    """With intervals that hold whatever related quantities are that nobody asked for, and words where those rule. Limits
    are told by when they are met, and owe to the step alone.
    """
    places = {e.name: k for k, e in enumerate(e for e in estimates if e.fitted)}
    step = [o for o in others if o.parameter.name == STEP]
    return tuple(
        _with_others(e, step if e.name in limits else others, places[e.name]) if e.fitted else e for e in estimates
    )


def _with_others(e: Estimate, others: Sequence[Considered], place: int) -> Estimate:
    reaches = np.array([o.reach(float(o.trade[place])) for o in others]).reshape(-1, 2)
    down, up = np.sqrt(np.array([e.value - e.low, e.high - e.value]) ** 2 + np.sum(reaches**2, axis=0))
    width = e.high - e.low
    wide = replace(e, low=float(max(e.value - down, e.lower_bound)), high=float(min(e.value + up, e.upper_bound)))
    if e.verdict not in ("identified", "weak") or not wide.high - wide.low > 2.0 * width:
        return wide
    k = int(np.argmax(reaches.max(axis=1)))
    if others[k].parameter.name == STEP and reaches[k].max() < SAME * abs(e.value):
        return wide
    return replace(wide, verdict=others[k].verdict, note=others[k].words(e, float(others[k].trade[place])))


def _frozen(p: Parameter, unseen: Sequence[str], notes: Sequence[str]) -> tuple[str, str]:
    if p.frozen:
        return "frozen", "as declared"
    if p.name in unseen:
        kept = "kept at its start value" if p.unidentified is None else "none is simulated"
        return "not identified", f"these recordings cannot tell it; {kept}"
    judged = next((n for n in notes if p.optional and n.startswith(f"{p.optional} left out: ")), "")
    if judged:
        return "not supported", judged.removeprefix(f"{p.optional} left out: ")
    if any(n.startswith(f"{p.optional} kept") for n in notes):
        return "not supported", "this signal is not replayed better with one of its own"
    return "not supported", "leaving it out does not raise the error on left-out recordings"


def _in_units(found: Fit, covariance: Array) -> Array:
    slope = found.space.unit_slope(found.values)
    return covariance * np.outer(slope, slope)


def _cross_validation(problem: Problem, found: Fit, shown: Sequence[Replay]) -> tuple[CrossValidation, ...]:
    """Replay errors of what is left out together, as shipped and by a fit that never saw it."""
    blocks = by_recording(problem)
    main, unit = problem.main
    rows = []
    for block, after in zip(blocks, left_out_errors(problem, found, blocks), strict=True):
        own = [problem.recordings[problem.owners[k]] for k in block.trials]
        names = {r.name for r in own}
        before = [np.ravel(r.before - r.measured) for r in shown if r.recording in names and r.channel == main]
        if np.isnan(after) or not before:
            continue
        whole = own[0].provenance.get(PART_OF, own[0].name) if len(own) > 1 else own[0].name
        rows.append(CrossValidation(whole, float(np.sqrt(np.nanmean(np.concatenate(before) ** 2))), float(after), unit))
    return tuple(rows)
