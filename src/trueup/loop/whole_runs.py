# SPDX-License-Identifier: Apache-2.0
"""Calibration on whole runs that fall and touch: CMA-ES to a valley, least squares down it, for several priors at once.

J. Tan et al., "Simulation-based design of dynamic controllers for humanoid balancing", IROS 2016, VI: CMA-ES alone. Some
seconds of one motion leave most of 30 parameters open. A prior keeps these where they were; and each member of an ensemble
has a prior of its own, drawn around the file's values, so that the members differ where the recordings do not tell
(randomized maximum likelihood: D. S. Oliver, N. He and A. C. Reynolds, ECMOR V, 1996).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from trueup.arrays import Array, Integers
from trueup.discrepancies.whole_body import SCALES, WholeBody
from trueup.ends import End
from trueup.engines.simulator import Simulator
from trueup.inspection.repeats import bridged, grouped, together
from trueup.loop.problem import Problem
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.rounding import TINY
from trueup.search.cma_es import CmaEs
from trueup.search.robust import robust_weights
from trueup.verdicts import PRIOR

Told = Callable[[int, float], None]
"""Candidates tried, and the lowest loss."""

BEND = 5.0  # residuals from which losses grow linearly where runs or places far apart are compared: one fall is not all


@dataclass(frozen=True, eq=False)
class WholeRuns:
    """What was found, the best first."""

    values: Array
    """(k, n) one row a member of the ensemble."""
    losses: Array
    """(k,)"""
    evaluations: int


def whole_runs(
    problems: Sequence[Problem], space: ParameterSpace, *, seed: int, population: int = 32, generations: int = 10,
    members: int = 4, descents: int = 6, prior: float = 0.02, start: Array | None = None, told: Told | None = None,
) -> WholeRuns:  # fmt: skip
    """Values of `space` with the least losses plus `prior` times the squared distance from nominal, in standard deviations
    of what may be anywhere in the box.

    Losses of several motions add, as logarithms of likelihoods do: what two motions tell counts twice as much against
    the prior as what one does. Their average would make each of them the fainter the more there are.
    `generations` of CMA-ES, then so many `descents` by least squares of `members`, of which the first has the nominal values
    as its prior; no descents: the best of CMA-ES alone. Several `problems` are several simulators of the same parameters.
    Without generations the descents begin at `start` (k, n) (None: the nominal values).
    """
    begin, rng = np.clip(space.to_unit(space.nominal), 0.02, 0.98), np.random.default_rng(seed)
    search = CmaEs(begin, seed=seed, sigma=0.12, population=population, restarts=0, tolerance=1e-3,
                   max_evaluations=population * generations)  # fmt: skip
    first = begin[None] if start is None else np.clip(space.to_unit(start), 0.02, 0.98)
    kept: list[tuple[float, Array]] = [(np.inf, point) for point in first]
    while generations and not search.done:
        candidates = search.ask()
        values = space.from_unit(candidates)
        seen = np.sum([losses(problem, values) for problem in problems], axis=0)
        seen = seen + prior * PRIOR * np.sum((candidates - begin) ** 2, axis=1)
        search.tell(candidates, seen)
        kept += zip(np.nan_to_num(seen, nan=np.inf).tolist(), candidates, strict=True)
        if told is not None:
            told(problems[0].evaluations, search.best[1])
    best = sorted(kept, key=lambda k: k[0])[:members]
    points = np.array([p for _, p in best])[np.arange(members) % len(best)]
    if not descents:
        return WholeRuns(space.from_unit(points[:1]), np.array([best[0][0]]), problems[0].evaluations)
    centres = begin + 0.5 / np.sqrt(PRIOR) * rng.standard_normal(points.shape) * (np.arange(members) > 0)[:, None]
    descent = _Descent(problems, space, np.clip(centres, 0.0, 1.0), prior)
    points, found = descent.run(np.clip(points, 0.01, 0.99), descents, told)
    order = np.argsort(found)
    return WholeRuns(space.from_unit(points[order]), found[order], problems[0].evaluations)


class _Descent:
    """Levenberg-Marquardt of several members in lockstep, each with a prior of its own: batches, not loops.

    Slopes that a member has taken serve it for a second step, corrected by what the first one showed (C. G. Broyden, Math.
    Comp. 19, 1965): of four whole runs of a humanoid three came as far with three quarters of the simulations, or further;
    the fourth went into another valley, where its best member ended higher.
    """

    dampings: ClassVar[tuple[float, ...]] = (0.01, 0.1, 1.0, 10.0, 100.0)
    step: ClassVar[float] = 0.01
    """Share of the box over which slopes are taken: contacts have none over less."""

    def __init__(self, problems: Sequence[Problem], space: ParameterSpace, centres: Array, prior: float) -> None:
        self._problems, self._space, self._centres, self._prior = problems, space, centres, prior
        self._weights = np.concatenate([weights(p) for p in problems])

    def run(self, points: Array, iterations: int, told: Told | None) -> tuple[Array, Array]:
        """(k, n) points in the unit box and (k,) losses."""
        k, n = points.shape
        members, damping = np.arange(k), np.ones(k)
        residuals = self._residuals(points)
        loss, stale = self._losses(residuals, points, members), np.ones(k, dtype=bool)
        corrected, slopes = np.zeros(k, dtype=bool), np.zeros((k, n, residuals.shape[1]))
        for _ in range(iterations):
            if stale.any():
                slopes[stale] = self._slopes(points[stale], residuals[stale])
                corrected[stale] = False
            tried, lambdas = [], damping[:, None] * np.array(self.dampings)
            for i, p in enumerate(points):
                tried.append(self._steps(p, residuals[i], slopes[i], self._centres[i], lambdas[i]))
            candidates, owners = np.concatenate(tried), np.repeat(members, len(self.dampings))
            seen = self._residuals(candidates)
            found = self._losses(seen, candidates, owners).reshape(k, -1)
            chosen = found.argmin(axis=1)
            better = found[members, chosen] < loss
            rows = members * len(self.dampings) + chosen
            for i in np.flatnonzero(better & ~corrected):
                slopes[i] += _broyden(slopes[i], candidates[rows[i]] - points[i], seen[rows[i]] - residuals[i])
            # Slopes taken where a member still stands are what they were.
            stale, corrected = corrected, corrected | better
            damping = np.where(better, np.maximum(lambdas[members, chosen], 1e-4), 10.0 * damping)
            points, residuals = (
                np.where(better[:, None], x[rows], y) for x, y in ((candidates, points), (seen, residuals))
            )
            loss = np.where(better, found[members, chosen], loss)
            if told is not None:
                told(self._problems[0].evaluations, float(loss.min()))
        return points, loss

    def _slopes(self, points: Array, residuals: Array) -> Array:
        """(k, n, m) by differences towards the middle of the box."""
        k, n = points.shape
        steps = self.step * np.where(points > 0.5, -1.0, 1.0)
        shifted = points[:, None] + steps[:, :, None] * np.eye(n)
        there = self._residuals(shifted.reshape(-1, n)).reshape(k, n, -1)
        return (there - residuals[:, None]) / steps[:, :, None]

    def _steps(self, point: Array, residual: Array, slopes: Array, centre: Array, lambdas: Array) -> Array:
        """(5, n) the next point with several dampings; `slopes` are (n, m)."""
        share = self._weights * np.sqrt(robust_weights(residual, BEND))
        slopes = np.where(np.isfinite(slopes), slopes, 0.0) * share
        pull = self._prior * PRIOR
        normal = slopes @ slopes.T + pull * np.eye(len(point))
        slope = slopes @ (residual * share) + pull * (point - centre)
        steps = [np.linalg.solve(normal + x * np.diag(np.diag(normal)), slope) for x in lambdas]
        return np.clip(point - np.array(steps), 0.01, 0.99)

    def _residuals(self, points: Array) -> Array:
        """(b, m); what fails is far off."""
        values = self._space.from_unit(points)
        found = np.concatenate([p.residuals(values) for p in self._problems], axis=1)
        return np.where(np.isfinite(found), found, 10.0 * BEND)

    def _losses(self, residuals: Array, points: Array, members: Integers) -> Array:
        away = PRIOR * np.sum((points - self._centres[members]) ** 2, axis=1)
        return _robust(residuals, self._weights) + self._prior * away


def _broyden(slopes: Array, step: Array, change: Array) -> Array:
    """(n, m) the least correction of slopes after which a step (n,) explains the change of the residuals (m,)."""
    return np.outer(step, change - step @ slopes) / max(float(step @ step), TINY)


def whole_body(simulator: Simulator, recordings: Sequence[Recording], ends: Sequence[End] = ()) -> Problem:
    """Recordings of a robot with a free base as something that is replayed whole, the torso's orientation first.

    Repeats, which were commanded alike, count as their average as far as they agree. `ends` are conditions under which a
    simulated run ends. Raises RecordingError where the pose of the base was lost for too long (`repeats.LONGEST_GAP`).
    """
    for recording in recordings:
        bridged(recording)  # says what was lost
    groups = grouped(recordings)
    alone = [r for r in recordings if not any(r is other for group in groups for other in group)]
    seen = [*(together(group).average for group in groups), *alone]
    return Problem(simulator, seen, WholeBody(), tuple(SCALES), ends=ends)


def losses(problem: Problem, values: Array) -> Array:
    """(b,) robust mean squares of the residuals, added over channels and trials; NaN where one failed."""
    return _robust(problem.residuals(values), weights(problem))


def weights(problem: Problem) -> Array:
    """(m,) such that each channel of each trial counts alike, however many samples it has."""
    found = np.empty(problem.segments[-1].columns.stop)
    for segment in problem.segments:
        found[segment.columns] = 1.0 / np.sqrt(max(segment.count, 1))
    return found


def _robust(residuals: Array, weights: Array) -> Array:
    return 2.0 * BEND**2 * ((np.sqrt(1.0 + (residuals / BEND) ** 2) - 1.0) @ weights**2)
