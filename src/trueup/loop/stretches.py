# SPDX-License-Identifier: Apache-2.0
"""How sure estimates are of a simulator that predicts a trial in stretches, each from what was measured until it begins."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from trueup.arrays import Array, Integers
from trueup.engines.simulator import InPlaceOf
from trueup.evidence import jackknife
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.trial import Trial


@runtime_checkable
class Stretched(Protocol):
    """Such a Simulator."""

    def stretches(self, trial: Trial) -> Callable[[Array], tuple[Array, Integers]]:
        """Of instants (T,): how long before each its stretch began, in s, NaN outside of all; and the number of that."""
        ...


def without_each_stretch(problem: Problem, fit: Fit, prior: float) -> Array | None:
    """(n_free,) variances by leaving out each of the stretches in turn that trials are predicted in (the cluster jackknife:
    J. MacKinnon, M. Nielsen, M. Webb, J. Applied Econometrics 38(5), 2023): what lasts as long as one, in all that is
    measured there, and what is wrong in a few of them alone, where slopes are large. None where these are no more than the
    parameters.
    """
    simulator = problem.simulator
    while isinstance(simulator, InPlaceOf):
        simulator = simulator.whole
    if not isinstance(simulator, Stretched):
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
