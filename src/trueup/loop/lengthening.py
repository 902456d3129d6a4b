# SPDX-License-Identifier: Apache-2.0
"""Values searched in windows that grow, from ones so short that slopes lead to as long as errors at their start allow."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.evidence import explained
from trueup.loop.descent import Descent, Look
from trueup.loop.problem import WORTH, Problem
from trueup.loop.shoot import LONGER, SHORTEST
from trueup.loop.watch import Watch
from trueup.loop.windows import in_windows, window_length
from trueup.parameters import ParameterSpace

_NAME = "windows that grow"


def lengthened(problem: Problem, space: ParameterSpace, values: Array, lasting: float) -> tuple[Array, float]:
    """Values (n,) to which windows lead that grow, and how long these may be in s by `window_length` there.

    What is unstable has valleys of its own at every length: a model that is a third off replays a pole that goes over the top
    for 0.1 s, but not for 1 s, where slopes lead to whichever values keep it from parting once more. In short windows its
    states are known anew before they part, and the loss is nearly that of linear regression (H. G. Bock, Recent advances in
    parameter identification techniques for o.d.e., 1983; A. H. Ribeiro et al., On the smoothness of nonlinear system
    identification, Automatica 121, 2020). How long they may be is asked anew each time: with wrong values other
    errors grow. Windows that are replayed to their noise tell nothing, and are passed over.
    """
    looked = problem.shortened(WORTH / len(problem.trials))
    descent = Descent(space, np.clip(space.to_unit(values), 0.0, 1.0), Watch(), robust=3.0)
    length = SHORTEST
    while length < lasting and length < max(t.duration for t in looked.trials):
        part = in_windows(looked, length)
        residual = part.residuals(values[None])[0]
        if np.isfinite(residual).all() and not explained(residual):
            descent.restart(descent.point)
            descent.descend(Look(_NAME, part, part, 5.0, 15))
            values = space.from_unit(descent.point)
            lasting = window_length(looked, values)
        length *= LONGER
    return values, lasting
