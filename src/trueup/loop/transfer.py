# SPDX-License-Identifier: Apache-2.0
"""Tries candidates on the robot: several distinct ones beside the incumbent, and keeps the best that the robot showed."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import Simulator
from trueup.errors import RobotFellError, TrialAbortedError
from trueup.loop.confirm import steadiness
from trueup.loop.correction import Correction
from trueup.loop.optimize import Optimum, TrustRegion, judge
from trueup.loop.ranking import Agreement, agreement
from trueup.loop.safety import require_safe
from trueup.recording import Recording
from trueup.robots.robot import Robot
from trueup.rounding import ROUNDED
from trueup.tasks.task import DoneOrNot, Task, robot_scores, robot_trials
from trueup.trial import Limits, Trial


@dataclass(frozen=True, eq=False)
class Shortlist:
    """What is to be tried on the robot, and what the simulator expects of it. Arrays are by candidate."""

    unit: Array
    """(c, m) in the unit box of the task's parameters."""
    predicted: Array
    """(c,) mean scores over the models."""
    spreads: Array
    incumbent: int
    """Row of the incumbent, -1 if it is not among them."""


def shortlist(
    optimum: Optimum, region: TrustRegion, count: int, *, apart: float = 0.2, incumbent: bool = True,
    task: Task, simulator: Simulator, models: Array, correction: Correction | None = None,
) -> Shortlist:  # fmt: skip
    """The incumbent (the region's centre), then up to `count` candidates `apart` (a share of the region's width).

    Of a task that is done or not (`tasks.task.DoneOrNot`) four times as many are replayed under noise over all models, and
    those that succeed in most replays are taken: the best score may be luck.
    """
    replayed = 4  # times as many candidates are replayed as are taken
    width = float((region.high - region.low).max())
    if isinstance(task, DoneOrNot):
        most = np.array(optimum.distinct(replayed * count, apart * width), dtype=np.int64)
        values = task.parameters.from_unit(optimum.unit[most])
        steady = steadiness(task, simulator, models, values, np.random.default_rng(0))
        rows = most[np.argsort(-steady, kind="stable")][:count]
    else:
        rows = np.array(optimum.distinct(count, apart * width), dtype=np.int64)
    unit, means, spreads = optimum.unit[rows], optimum.means[rows], optimum.spreads[rows]
    if not incumbent:
        return Shortlist(unit, means, spreads, -1)
    now = judge(task, simulator, models, region.centre, correction=correction)
    new = np.abs(unit - region.centre).max(axis=1) > ROUNDED
    return Shortlist(
        np.concatenate([region.centre[None], unit[new]]), np.concatenate([now.means, means[new]]),
        np.concatenate([now.spreads, spreads[new]]), 0,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Tested:
    """One candidate on the robot."""

    scores: Array
    """(repeats,) by the task; NaN where a run was not done."""
    recordings: tuple[tuple[Recording, ...], ...]
    """For each of the task's trials, its repeats."""
    fell: bool = False

    @property
    def score(self) -> float:
        """Mean over the repeats; NaN without any."""
        return mean_score(self.scores)


def mean_score(scores: Array) -> float:
    """The mean of the scores that there are; NaN where there is none."""
    known = np.asarray(scores)[np.isfinite(scores)]
    return float(known.mean()) if len(known) else float("nan")


def try_on_robot(
    robot: Robot, task: Task, candidate: Array, *, repeats: int = 1, limits: Limits | None = None, label: str = ""
) -> Tested:
    """Performs the task's trials with a candidate (m,) in the parameters' units, after checking them against limits.

    A fall or an aborted run leaves scores of NaN. Raises TrialError where a trial goes beyond a limit.
    """
    trials = [prepared(t, limits, repeats) for t in robot_trials(task, candidate, label)]
    for trial in trials:
        require_safe(trial)
    runs: list[tuple[Recording, ...]] = []
    for trial in trials:
        try:
            runs.append(tuple(robot.perform(trial)))
        except (RobotFellError, TrialAbortedError) as error:
            return Tested(np.full(repeats, np.nan), tuple(runs), isinstance(error, RobotFellError))
    return Tested(robot_scores(task, runs, candidate), tuple(runs))


def prepared(trial: Trial, limits: Limits | None, repeats: int) -> Trial:
    """A trial with the campaign's limits, where it has none of its own, and so many repeats."""
    return dataclasses.replace(trial, limits=trial.limits or limits, repeats=repeats)


@dataclass(frozen=True, eq=False)
class Transferred:
    """What the robot said of a shortlist."""

    measured: Array
    """(c,) scores on the robot."""
    best: int
    """The best row; -1 where no run could be scored."""
    agreement: Agreement
    """Between the simulator's ranking and the robot's."""


def transfer(
    robot: Robot, task: Task, chosen: Shortlist, *, repeats: int = 1, limits: Limits | None = None
) -> tuple[Transferred, list[Tested]]:
    """Performs a shortlist on the robot. Raises TrialError where a trial goes beyond a limit."""
    values = task.parameters.from_unit(chosen.unit)
    tested = [
        try_on_robot(robot, task, v, repeats=repeats, limits=limits, label=f", candidate {k + 1}")
        for k, v in enumerate(values)
    ]
    return compared(chosen.predicted, np.array([t.score for t in tested])), tested


def compared(predicted: Array, measured: Array) -> Transferred:
    """The outcome of a transfer from predicted and measured scores (c,)."""
    best = int(np.nanargmin(measured)) if np.isfinite(measured).any() else -1
    return Transferred(measured, best, agreement(predicted, measured))


def best_known(
    units: Sequence[Array], scores: Sequence[Array], fell: Sequence[bool] | None = None
) -> tuple[Array, float]:
    """The settings with the lowest mean score over all runs that the robot made with them.

    Repeats of one candidate, in whatever round, are pooled, so that one lucky run does not keep a place for good. Settings
    with which the robot `fell` at least every other time come after all others, however good their other runs were.
    Raises ValueError where no score is known.
    """
    falls: dict[bytes, list[bool]] = {}
    runs: dict[bytes, list[float]] = {}
    points: dict[bytes, Array] = {}
    for unit, known, down in zip(units, scores, fell or [False] * len(units), strict=True):
        key = np.round(np.asarray(unit, dtype=np.float64), 12).tobytes()
        points[key] = np.asarray(unit, dtype=np.float64)
        runs.setdefault(key, []).extend(float(s) for s in known if np.isfinite(s))
        falls.setdefault(key, []).append(down)
    means = {key: float(np.mean(found)) for key, found in runs.items() if found}
    if not means:
        raise ValueError("no run on the robot has a score")
    best = min(means, key=lambda k: (2 * sum(falls[k]) >= len(falls[k]), means[k]))
    return points[best], means[best]
