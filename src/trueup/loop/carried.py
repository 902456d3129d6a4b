# SPDX-License-Identifier: Apache-2.0
"""Slopes carried over to a space in which other parameters are free: only those of new ones are taken.

One structure more, or one parameter held elsewhere, changes little of what all other columns say, and each of them that is
taken anew costs a simulation. Where they do not serve, least squares take new ones.
"""

from __future__ import annotations

import numpy as np

from trueup.loop.descent import Descent, Fit, Look
from trueup.search.bounded_step import careful_difference
from trueup.search.least_squares import LeastSquares


def carry(descent: Descent, look: Look, known: Fit) -> None:
    """Has a search begin its look with the slopes of a fit to the same residuals, and those of what was not free there."""
    free, before = ([p.name for p in s.parameters if not p.frozen] for s in (descent.space, known.space))
    new = np.array([k for k, name in enumerate(free) if name not in before], dtype=np.intp)
    slopes = np.zeros((len(known.residual), len(free)))
    slopes[:, np.isin(free, before)] = known.jacobian[:, [before.index(name) for name in free if name in before]]
    if len(new):
        steps = np.where(descent.point > 0.5, -1.0, 1.0) * careful_difference(known.residual, LeastSquares.difference)
        beside = descent.point + np.diag(steps)[new]
        seen = look.columns(descent.space, np.concatenate([descent.point[None], beside]))
        columns = (seen[1:] - seen[0]) / steps[new, None]
        slopes[:, new] = np.where(np.isfinite(columns).all(axis=1)[:, None], columns, 0.0).T
    descent.take_up(slopes)
