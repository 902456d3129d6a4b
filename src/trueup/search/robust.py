# SPDX-License-Identifier: Apache-2.0
"""A loss that grows with the square of small residuals and with the size of large ones: P. Huber's, in its smooth form."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array


def robust_losses(residuals: Array, bend: float) -> Array:
    """(b,) sums over residuals (b, m) of bend^2 (sqrt(1 + (r / bend)^2) - 1): half the squares far below `bend`."""
    if not np.isfinite(bend):
        return 0.5 * np.einsum("bm,bm->b", residuals, residuals)
    ratio = residuals / bend
    ratio *= ratio
    return bend**2 * (np.sqrt(1.0 + ratio) - 1.0).sum(axis=1)


def robust_weights(residuals: Array, bend: float) -> Array:
    """As the residuals: how much each counts, 1 for small ones, bend / |r| for outliers."""
    return 1.0 / np.sqrt(1.0 + (residuals / bend) ** 2)
