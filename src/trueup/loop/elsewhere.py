# SPDX-License-Identifier: Apache-2.0
"""Looks for a lower place where slopes do not lead: in the whole box, by CMA-ES."""

from __future__ import annotations

from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.loop.descent import Watch
from trueup.loop.problem import Problem
from trueup.parameters import ParameterSpace
from trueup.search.cma_es import CmaEs
from trueup.search.least_squares import LeastSquares
from trueup.search.robust import robust_losses

EVOLVING = "cma-es"  # the name of its stage
FEW = 8  # parameters: so few can be searched widely where slopes end far above the noise
_BETTER = 0.98  # a place elsewhere is worth going to if the loss falls at least to this share
_BEND = 10.0  # noise units from which losses grow linearly where places far apart are compared: one fall is not all


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
        losses = robust_losses(residuals, _BEND)
        search.tell(candidates, losses)
        watch.save(EVOLVING, space, search.state())
        k = int(np.nanargmin(losses)) if np.isfinite(losses).any() else 0
        watch.saw(EVOLVING, problem, search.best[1], problem.rmse(np.nan_to_num(residuals[k])))
    return search.best[0]


def anywhere(problem: Problem, space: ParameterSpace, last: LeastSquares, watch: Watch, seed: int) -> Array | None:
    """A better point wherever it is, if there is one: a foot that sticks has no slope towards the friction it slides with."""
    point = evolved(problem, space, last.point, watch, seed, short=True)
    there, here = losses_at(problem, space, np.stack([point, last.point]))
    return point if there < _BETTER * here else None


def losses_at(problem: Problem, space: ParameterSpace, points: Array) -> Array:
    """(b,) what points in the unit box cost; inf where the simulation fails."""
    losses = robust_losses(problem.residuals(space.from_unit(points)), _BEND)
    return np.where(np.isfinite(losses), losses, np.inf)
