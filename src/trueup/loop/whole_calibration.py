# SPDX-License-Identifier: Apache-2.0
"""Whole runs that fall and touch, calibrated as `calibrate` does it for others: what was estimated, how surely, and replays.

What is worth it is chosen first (`worth.py`) and searched (`whole_runs.py`); from there all that is free settles. Intervals
are those of the posterior where it does: the prior of `whole_runs`, narrowed by what slopes of the replays tell (Laplace's
approximation: A. Tarantola, "Inverse Problem Theory", 2005, section 3.2.3). What may be done by either of two parameters is
known of neither, whichever was searched.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from math import nan

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Calibration, Estimate, TracePoint
from trueup.discrepancies.whole_body import WholeBody
from trueup.ends import End
from trueup.engines.simulator import Simulator
from trueup.errors import CalibrationError
from trueup.evidence import half_interval
from trueup.inspection.repeats import BASE
from trueup.loop.checks import check
from trueup.loop.problem import Problem
from trueup.loop.replay import replays
from trueup.loop.watch import Progress
from trueup.loop.whole_runs import WholeRuns, whole_body, whole_runs
from trueup.loop.worth import SAMPLES, Choice, slopes, worth_calibrating
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.verdicts import PRIOR, judged


def calibrate_whole(
    simulator: Simulator, recordings: Sequence[Recording], hold_out: Sequence[Recording] = (), *,
    ends: Sequence[End] = (), choose: bool = True, seed: int = 0, progress: Progress | None = None,
) -> Calibration:  # fmt: skip
    """Fits those of the simulator's free parameters that are worth it (`choose`; else all) to whole runs of a free base.

    `recordings` have the torso's `base_orientation` or `base_position`; repeats of one command count as their average.
    `ends` stop simulated runs. Raises CalibrationError where none has either, where nothing is free or simulated, and
    RecordingError where the torso's pose was lost for too long.
    """
    began, cpu = time.perf_counter(), time.process_time()
    warnings = check(recordings, hold_out)
    if not any(channel in BASE for r in recordings for channel in simulator.observable(r)):
        raise CalibrationError(
            "whole runs are compared by the torso's pose, and no recording has 'base_orientation' or 'base_position' of "
            f"'{simulator.name}'; with joints alone [calibrate] method = \"fit\" is the one to take"
        )
    problem, space = whole_body(simulator, recordings, ends), simulator.parameters
    channels = tuple(dict.fromkeys(s.channel for s in problem.segments))
    choice = worth_calibrating([problem], space, rng=np.random.default_rng(seed)) if choose else None
    trace = _Trace(problem, began, progress)
    trace.saw(problem.evaluations, nan)
    found = whole_runs([problem], _chosen(choice, space), seed=seed, told=trace.saw)
    if choice is not None:
        found = whole_runs([problem], space, seed=seed, generations=0, members=len(found.values),
                           start=found.values, told=trace.saw)  # fmt: skip
    values = found.values[0]
    covariance = _posterior(problem, space, values) + _between(space, found)
    shown = replays(simulator, values, recordings, hold_out, WholeBody(), channels=channels, windows=np.inf)
    slope = space.unit_slope(values)
    return Calibration(
        model_name=simulator.name,
        estimates=_estimates(space, values, covariance),
        replays=shown,
        trace=tuple(trace.points),
        covariance=covariance * np.outer(slope, slope),
        warnings=tuple(warnings),
        seconds=time.perf_counter() - began,
        cpu_seconds=time.process_time() - cpu,
        evaluations=problem.evaluations,
        notes=() if choice is None else choice.notes[:1],
    )


class _Trace:
    """The search as it goes, with losses as half of sums of squares."""

    def __init__(self, problem: Problem, began: float, progress: Progress | None) -> None:
        self._problem, self._began, self._progress, self.points = problem, began, progress, list[TracePoint]()

    def saw(self, evaluations: int, loss: float) -> None:
        """After `evaluations` candidates the lowest loss is this one."""
        point = TracePoint("whole runs", evaluations, 0.5 * loss, nan, time.perf_counter() - self._began)
        self.points.append(point)
        if self._progress is not None:
            self._progress(point)


def _chosen(choice: Choice | None, space: ParameterSpace) -> ParameterSpace:
    """Those that are worth it free. Raises CalibrationError where none is."""
    if choice is None:
        return space
    if not choice.chosen:
        raise CalibrationError(f"nothing is worth calibrating on these recordings: {choice.notes[1]}")
    return choice.of(space)


def _posterior(problem: Problem, space: ParameterSpace, values: Array) -> Array:
    """(f, f) covariance in the unit box."""
    seen = slopes(problem, space, np.clip(space.to_unit(values), 0.0, 1.0))
    return np.asarray(np.linalg.inv(SAMPLES * seen @ seen.T + PRIOR * np.eye(len(seen))), dtype=np.float64)


def _between(space: ParameterSpace, found: WholeRuns) -> Array:
    """(f, f) how members scatter about the best: valleys of their own, of which slopes in one of them know nothing."""
    away = space.to_unit(found.values) - space.to_unit(found.values[0])
    return away.T @ away / len(away)


def _estimates(space: ParameterSpace, values: Array, covariance: Array) -> tuple[Estimate, ...]:
    """All parameters, in their order."""
    spread, unit = np.sqrt(np.diag(covariance)), np.clip(space.to_unit(values), 0.0, 1.0)
    low, high = (space.from_unit(np.clip(unit + s * half_interval() * spread, 0.0, 1.0)) for s in (-1.0, 1.0))
    free = iter(zip(unit.tolist(), spread.tolist(), strict=True))
    rows = []
    for p, value, lo, hi in zip(space.parameters, values.tolist(), low.tolist(), high.tolist(), strict=True):
        row = Estimate(
            p.name, p.unit, p.nominal, value, nan, nan, p.lower, p.upper, not p.frozen, "frozen", "as declared"
        )
        if not p.frozen:
            verdict = judged(p, *next(free), value, lo, hi)
            row = replace(row, low=lo, high=hi, verdict=verdict.word, note=verdict.note)
        rows.append(row)
    return tuple(rows)
