# SPDX-License-Identifier: Apache-2.0
"""Where a search begins whose start lies on bounds."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.evidence import HALVED
from trueup.loop.problem import Problem
from trueup.parameters import ParameterSpace
from trueup.search.least_squares import LeastSquares


def nudge(problem: Problem, space: ParameterSpace, point: Array) -> float:
    """How far from all bounds a search from `point` (n_free,) in the unit box begins.

    On them limits are not met and logarithms have almost no slope. But what is moved in this way drives a robot elsewhere:
    where that alone more than doubles the errors, as of an arm that torques swing, a search begins where it is.
    """
    moved = np.clip(point, LeastSquares.nudge, 1.0 - LeastSquares.nudge)
    here, there = np.linalg.norm(problem.residuals(space.from_unit(np.stack([point, moved]))), axis=1)
    return 0.0 if np.isfinite(here) and not here >= HALVED * there else LeastSquares.nudge
