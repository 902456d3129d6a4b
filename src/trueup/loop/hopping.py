# SPDX-License-Identifier: Apache-2.0
"""Leaves a place where slopes end though the model could replay the recordings better: jumps, and searches from there.

Basin hopping, D. J. Wales and J. P. K. Doye, J. Physical Chemistry A 101(28), 1997.
"""

from __future__ import annotations

import numpy as np

from trueup.loop.descent import Fit, descended, explained
from trueup.loop.problem import Problem

_NOISE = 1.15  # mean square of the residuals, in noise units, up to which nothing better is to be hoped for
_HOP = 0.05  # of the box, in every direction
_TRIES = 4
_BOWL = 2  # first tries that come back: what this leaves unexplained lies elsewhere than in the search
_BACK = 2e-3  # share of the loss, and of the box: closer is the same place again
_LOWER = 0.9  # share of the loss to fall to: what is lower by less replays these recordings better, and others not


def hopped(problem: Problem, fit: Fit, rng: np.random.Generator, robust: float = 3.0) -> Fit:
    """The fit, or a lower one. Drives that saturate leave long bent valleys with cracks across: delay against damping
    against the force limit; beyond a crack the way down goes on.

    Only where the recordings are almost explained, so that noise alone is worth the way, and for no more simulations
    than it took to get here.
    """
    spent, back = problem.evaluations, 0
    for tried in range(_TRIES):
        if not explained(fit.residual) or float(np.mean(fit.residual**2)) < _NOISE or problem.evaluations > 2 * spent:
            break
        lower = descended(problem, fit, fit.unit + _HOP * rng.standard_normal(len(fit.unit)), robust)
        back += abs(lower.loss - fit.loss) < _BACK * fit.loss and float(np.abs(lower.unit - fit.unit).max()) < _BACK
        if back == _BOWL == tried + 1:
            break
        fit = lower if lower.loss < _LOWER * fit.loss else fit
    return fit
