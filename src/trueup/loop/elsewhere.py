# SPDX-License-Identifier: Apache-2.0
"""Looks for a lower place where slopes do not lead: along single parameters, and in the whole box by CMA-ES."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.loop.descent import SETTLED
from trueup.loop.problem import Problem
from trueup.loop.watch import Watch
from trueup.loop.whole_runs import BEND
from trueup.parameters import ParameterSpace
from trueup.rounding import TINY
from trueup.search.cma_es import CmaEs
from trueup.search.least_squares import LeastSquares
from trueup.search.robust import robust_losses

EVOLVING = "cma-es"  # the name of its stage
FEW = 8  # parameters: so few can be searched widely where slopes end far above the noise
EDGE = 5e-3  # share of the box: whatever is closer to a bound is on it
LOOKED_AT = 5  # parameters without much slope, at most: those with the least
_BLIND = 5.0  # a slope that across the whole box changes the residuals by less than this many times what they are


def evolved(
    problem: Problem, space: ParameterSpace, point: Array, watch: Watch, seed: int, *, short: bool,
    saved: dict[str, Any] | None = None,
) -> Array:  # fmt: skip
    """The best point that CMA-ES comes to from `point` (n,), in the unit box."""
    most = 60 * (len(point) + 5) if short else 300 * (len(point) + 5)
    search = CmaEs(
        point, seed=seed, max_evaluations=most, restarts=0 if short else 1, tolerance=1e-2 if short else 1e-4
    )
    if saved is not None:
        search.resume(saved)
    while not search.done:
        candidates = search.ask()
        residuals = problem.residuals(space.from_unit(candidates))
        losses = robust_losses(residuals, BEND)
        search.tell(candidates, losses)
        watch.save(EVOLVING, space, search.state())
        k = int(np.nanargmin(losses)) if np.isfinite(losses).any() else 0
        watch.saw(EVOLVING, problem, search.best[1], problem.rmse(np.nan_to_num(residuals[k])))
    return search.best[0]


def anywhere(problem: Problem, space: ParameterSpace, last: LeastSquares, watch: Watch, seed: int) -> Array | None:
    """A better point wherever it is, if there is one: a foot that sticks has no slope towards the friction it slides with."""
    point = evolved(problem, space, last.point, watch, seed, short=True)
    there, here = losses_at(problem, space, np.stack([point, last.point]))
    return point if there < (1.0 - SETTLED) * here else None


def along_axes(problem: Problem, space: ParameterSpace, last: LeastSquares, first: Problem) -> Array | None:
    """A better point along the axis of a parameter that has no slope where it is, or is at a bound, if there is one.

    The friction of a foot that sticks and the force limit of a drive that never saturates have none: slopes alone would
    leave them where they started, however wrong that is, or where one wrong step took them. Where the `first` stage costs
    far less it is looked at in the problem's place, which only judges what was found there.
    """
    if last.jacobian is None or last.residual is None:
        return None
    bound = (last.point < EDGE) | (last.point > 1.0 - EDGE)
    effect = np.sqrt(np.mean(last.jacobian**2, axis=0) / max(float(np.mean(last.residual**2)), TINY))
    weakest = np.argsort(np.where(bound, 0.0, effect))[:LOOKED_AT]
    few = len(last.point) <= FEW
    blind = weakest[(effect < (4.0 if few else 1.0) * _BLIND)[weakest] | bound[weakest]]
    if not len(blind):
        return None
    here = float(robust_losses(last.residual[None], BEND)[0])
    if _simulated(first) > 0.5 * _simulated(problem):
        point, loss = _along(problem, space, last.point, blind)
        return point if loss < (1.0 - SETTLED) * here else None
    point, loss = _along(first, space, last.point, blind)
    if loss >= (1.0 - SETTLED) * losses_at(first, space, last.point[None])[0]:
        return None
    return point if losses_at(problem, space, point[None])[0] < (1.0 - SETTLED) * here else None


def _along(problem: Problem, space: ParameterSpace, point: Array, columns: NDArray[np.intp]) -> tuple[Array, float]:
    """The lowest point on lines along some axes, and its loss."""

    def candidates(columns: NDArray[np.intp], places: Array) -> tuple[Array, Array]:
        points = np.repeat(point[None], len(columns), axis=0)
        points[np.arange(len(points)), columns] = places
        return points, losses_at(problem, space, points)

    # Ground friction counts in a narrow range only: above it a foot sticks, below it the robot slips away.
    places = np.linspace(0.05, 0.95, 28 if len(point) <= FEW else 10)
    _, losses = candidates(np.repeat(columns, len(places)), np.tile(places, len(columns)))
    column, place = divmod(int(np.argmin(losses)), len(places))
    # Where it has no slope on one side of a place and too much on the other, what is best lies between two places.
    closer = np.clip(places[place] + np.linspace(-1.0, 1.0, 11) * (places[1] - places[0]), 0.0, 1.0)
    points, losses = candidates(np.full(len(closer), columns[column]), closer)
    best = int(np.argmin(losses))
    return points[best], float(losses[best])


def losses_at(problem: Problem, space: ParameterSpace, points: Array) -> Array:
    """(b,) what points in the unit box cost; inf where the simulation fails."""
    losses = robust_losses(problem.residuals(space.from_unit(points)), BEND)
    return np.where(np.isfinite(losses), losses, np.inf)


def _simulated(problem: Problem) -> float:
    """Number of steps that one candidate costs."""
    return sum(t.duration for t in problem.trials) / problem.simulator.step
