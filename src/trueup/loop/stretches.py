# SPDX-License-Identifier: Apache-2.0
"""How sure estimates are of a simulator that predicts a trial in stretches, each from what was measured until it begins.

Commands that take effect just before or just after a stretch begins put kinks and walls into the loss: a hair's change of any
number ends a search elsewhere, and slopes there are those of one side of a kink. What was simulated on the way tells more.
"""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.evidence import half_interval, jackknife
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.loop.visited import stretched


def without_each_stretch(problem: Problem, fit: Fit, prior: float) -> Array | None:
    """(n_free,) variances by leaving out each of the stretches in turn that trials are predicted in (the cluster jackknife:
    J. MacKinnon, M. Nielsen, M. Webb, J. Applied Econometrics 38(5), 2023): what lasts as long as one, in all that is
    measured there, and what is wrong in a few of them alone, where slopes are large. None where these are no more than the
    parameters.
    """
    simulator = stretched(problem.simulator)
    if simulator is None:
        return None
    n = fit.jacobian.shape[1]
    pulls, curvatures = dict[tuple[int, int], Array](), dict[tuple[int, int], Array]()
    for segment in problem.segments:
        trial = problem.trials[segment.trial]
        _, number = simulator.stretches(trial)(trial.observed[segment.channel].time)
        of = np.broadcast_to(number[:, None], segment.mask.shape)[segment.mask]
        slopes, counts, errors = (a[segment.columns] for a in (fit.jacobian, fit.weights, fit.residual))
        for k in np.unique(of).tolist():
            here, at = of == k, (segment.trial, k)
            weighted = slopes[here].T * counts[here]
            pulls[at] = pulls.get(at, np.zeros(n)) + weighted @ errors[here]
            curvatures[at] = curvatures.get(at, np.zeros((n, n))) + weighted @ slopes[here]
    if len(pulls) <= n:
        return None
    whole = sum(curvatures.values(), prior * np.eye(n))
    steps = np.array([np.linalg.solve(whole - curvatures[at], pull) for at, pull in pulls.items()], dtype=np.float64)
    return jackknife(steps) ** 2


def seen_as_good(problem: Problem, fit: Fit) -> Array | None:
    """(n_free,) variances with which 95 % intervals reach as far as places were seen whose loss is no higher than chance may
    make it: a likelihood region (W. Q. Meeker, L. A. Escobar, Am. Statistician 49, 1995). None where trials are replayed
    whole.
    """
    if stretched(problem.simulator) is None:
        return None
    good = problem.visited.below(fit.loss + half_interval() ** 2 * problem.chance(fit.residual))
    if not len(good):
        return np.zeros(len(fit.unit))
    away = np.clip(fit.space.to_unit(good), 0.0, 1.0) - fit.unit
    return (np.abs(away).max(axis=0) / half_interval()) ** 2
