# SPDX-License-Identifier: Apache-2.0
"""Parameters of one kind searched as one, where feet touch and let go: a dozen numbers in place of a hundred, to begin with.

Drives of one robot are mostly alike, and what its file says of them is mostly wrong alike (partial pooling: A. Gelman and
J. Hill, Data Analysis Using Regression and Multilevel Models, 2007, 12). What all of them change together leads along a
contact where slopes for each end at the next crack, and costs a simulation for each kind, not for each drive.
"""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.loop.descent import HELD
from trueup.loop.problem import Problem
from trueup.loop.stages import Run
from trueup.loop.windows import carried
from trueup.parameters import ParameterSpace
from trueup.search.least_squares import LeastSquares

_LOOSELY = 5.0  # times chance: what one kind gains less is for each of its own


def alike(problem: Problem, space: ParameterSpace, start: Array, robust: float = 3.0) -> Array:
    """(n_free,) where least squares lead from `start` in the unit box, all parameters of a kind moved by the same share of
    their ranges; where it begins if that cannot be simulated.
    """
    if not np.isfinite(problem.residuals(space.from_unit(start[None]))).all():
        return start
    kinds, free = space.kinds, [p for p in space.parameters if not p.frozen]
    begun = np.bincount(kinds, start) / np.bincount(kinds)
    first = [free[int(np.argmax(kinds == k))] for k in range(len(begun))]
    ranges = np.array([p.log_range for p in first])
    search = LeastSquares(
        begun, ranges, robust=robust, nudge=0.0, least_damping=HELD, share=3e-2, tolerance=_LOOSELY, max_iterations=15,
        confirm=False, worth=lambda residual: problem.chance(residual) * len(begun),
    )  # fmt: skip

    def points(means: Array) -> Array:
        return np.clip(start + (means - begun)[..., kinds], 0.0, 1.0)

    while not search.done:
        asked = search.ask()
        search.tell(asked, problem.residuals(space.from_unit(points(asked))))
    return points(search.best[0])


def all_alike(run: Run) -> None:
    """The first search of what stands on a floor by itself: kind by kind."""
    descent, look = run.descent, run.first
    if run.begun or run.looks or run.resumed or run.saved is not None or not carried(run.problem):
        return
    point = alike(look, descent.space, run.start, descent.robust)
    residual = look.residuals(descent.space.from_unit(point[None]))[0]
    descent.watch.saw("all alike", look, float(0.5 * residual @ residual), look.rmse(residual))
    descent.restart(point)
