# SPDX-License-Identifier: Apache-2.0
"""Tunes a controller in the calibrated simulator, and keeps the search from exploiting what the simulator has wrong.

Guards: every candidate is scored on several samples of what the calibration is unsure of, the search stays in a trust
region around what the robot has shown, several distinct candidates come out rather than one, and where it is asked for the
robot's own scores correct the simulator's.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import Simulator
from trueup.errors import CalibrationError
from trueup.evaluation.evaluator import Evaluator
from trueup.loop.correction import Correction
from trueup.search.search import Search
from trueup.tasks.task import Task, simulated_scores

_TOLERATED = 0.2  # share of the samples in which a candidate may fail and still have a loss


@dataclass(frozen=True, eq=False)
class TrustRegion:
    """A box in the unit box of a task's parameters: `radius` to each side of `centre` (m,), cut at the bounds."""

    centre: Array
    radius: float

    @property
    def low(self) -> Array:
        """(m,) its lower corner."""
        return np.clip(self.centre - self.radius, 0.0, 1.0)

    @property
    def high(self) -> Array:
        """(m,) its upper corner."""
        return np.clip(self.centre + self.radius, 0.0, 1.0)

    def inside(self, unit: Array) -> Array:
        """Points (..., m) of the unit box as the search sees them: 0 and 1 are the region's sides."""
        return np.clip((unit - self.low) / (self.high - self.low), 0.0, 1.0)

    def outside(self, seen: Array) -> Array:
        """The reverse of `inside`."""
        return self.low + seen * (self.high - self.low)

    def moved(self, centre: Array, *, success: bool, least: float = 0.02) -> TrustRegion:
        """The next region: twice as wide where the robot did better as the simulator said, half as wide where not."""
        radius = min(1.0, 2.0 * self.radius) if success else max(least, 0.5 * self.radius)
        return TrustRegion(np.asarray(centre, dtype=np.float64), radius)


@dataclass(frozen=True, eq=False)
class Tried:
    """One generation of a search: candidates (b, m) in its own box, losses, means and spreads (b,) of their scores."""

    candidates: Array
    losses: Array
    means: Array
    spreads: Array


@dataclass(frozen=True, eq=False)
class Optimum:
    """All that a search tried, in the unit box of the task's parameters, in the order in which it was tried."""

    unit: Array
    """(N, m)."""
    losses: Array
    """(N,) mean plus risk; NaN where too many samples failed."""
    means: Array
    spreads: Array
    ended: str

    @property
    def best(self) -> int:
        """Row of the lowest loss. Raises CalibrationError where all failed."""
        if not np.isfinite(self.losses).any():
            raise CalibrationError(
                f"none of {len(self.losses)} candidates has a score in the simulator: their runs broke off, or the task's "
                "score was NaN for all. Begin with settings that work there (nominal values), or search less far (trust)"
            )
        return int(np.nanargmin(self.losses))

    def distinct(self, count: int, apart: float) -> tuple[int, ...]:
        """Rows of up to `count` candidates, the best first, each `apart` from the others in some parameter.

        Only candidates in the better half are considered: one that the simulator says is bad teaches the robot little.
        Where these lie too close together for so many, `apart` is halved, twice at most.
        """
        good = np.flatnonzero(np.isfinite(self.losses))
        order = good[np.argsort(self.losses[good], kind="stable")][: max(count, (len(good) + 1) // 2)]
        chosen: list[int] = []
        for distance in (apart, apart / 2, apart / 4):
            chosen = []
            for k in order:
                if len(chosen) < count and all(np.abs(self.unit[k] - self.unit[c]).max() >= distance for c in chosen):
                    chosen.append(int(k))
            if len(chosen) == count:
                break
        return tuple(chosen)


def optimize(
    task: Task, simulator: Simulator, models: Array, search: Search, region: TrustRegion | None = None, *,
    risk: float = 1.0, evaluations: int | None = None, past: Sequence[Tried] = (),
    watch: Callable[[Tried], Tried] | None = None, correction: Correction | None = None,
    evaluator: Evaluator | None = None,
) -> Optimum:  # fmt: skip
    """Searches the task's free parameters for the lowest mean score over `models` (p, n) plus `risk` deviations.

    `search` works in the region's box (the whole unit box without one) and ends by itself or after `evaluations`
    candidates. `past` are generations of an interrupted run: asked for again and told the same, which brings the search
    to where it was. `watch` sees each new generation. With a `correction` means and spreads are those expected on the
    robot. `evaluator` says where candidates are simulated (None: here). Raises CalibrationError where the search asks for
    other candidates than it did in the past, and where all candidates fail.
    """
    space = task.parameters
    whole = region or TrustRegion(np.full(int(space.free.sum()), 0.5), 0.5)
    tried: list[Tried] = []
    count, left = 0, list(past)
    while not search.done and (evaluations is None or count < evaluations):
        asked = search.ask()
        if not len(asked):
            break
        if left:
            now = left.pop(0)
            if not np.array_equal(now.candidates, asked):
                raise CalibrationError("the search asks for other candidates than before the interruption")
        else:
            unit = whole.outside(asked)
            scores = simulated_scores(task, simulator, models, space.from_unit(unit), evaluator)
            now = _judged(asked, unit, scores, risk, correction)
            now = watch(now) if watch is not None else now
        search.tell(asked, now.losses)
        tried.append(now)
        count += len(asked)
    if not tried:
        raise CalibrationError(f"the search asked for nothing ({search.done or 'no evaluations allowed'})")
    rows = [np.concatenate([getattr(t, f.name) for t in tried]) for f in dataclasses.fields(Tried)]
    ended = search.done or f"stopped after {count} candidates, as planned"
    result = Optimum(whole.outside(rows[0]), rows[1], rows[2], rows[3], ended)
    _ = result.best  # raises where all failed
    return result


def judge(
    task: Task,
    simulator: Simulator,
    models: Array,
    unit: Array,
    *,
    risk: float = 1.0,
    correction: Correction | None = None,
) -> Tried:
    """The same judgement of given candidates (b, m) in the unit box of the task's parameters."""
    given = np.atleast_2d(unit)
    scores = simulated_scores(task, simulator, models, task.parameters.from_unit(given))
    return _judged(given, given, scores, risk, correction)


def _judged(candidates: Array, unit: Array, scores: Array, risk: float, correction: Correction | None) -> Tried:
    """From scores (p, b): a sample that fails counts like the candidate's worst; too many of them, and it has no loss.

    `unit` (b, m) are the candidates in the unit box of the task's parameters.
    """
    failed = ~np.isfinite(scores)
    worst = np.where(failed, -np.inf, scores).max(axis=0)
    filled = np.where(failed, np.where(np.isfinite(worst), worst, 0.0), scores)
    means, spreads = filled.mean(axis=0), filled.std(axis=0)
    if correction is not None:
        means, spreads = correction(unit, means, spreads)
    lost = failed.mean(axis=0) > _TOLERATED
    means, spreads = np.where(lost, np.nan, means), np.where(lost, np.nan, spreads)
    return Tried(candidates, means + risk * spreads, means, spreads)
