# SPDX-License-Identifier: Apache-2.0
"""Models one column larger or smaller than another, all at once: borders of normal equations instead of new solutions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.identification.estimation.moments import Moments

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Neighbours:
    """K fits of m columns, each without one block, from which those of m + 1 and m - 1 columns follow.

    Golub & Van Loan, "Matrix computations", 4th ed., 2013, section 2.1.4 (block inverses).
    """

    moments: Moments
    active: Integers
    """(m,)."""
    normal: Array
    """(K, p, p) of the blocks that a fit saw, with its ridge."""
    right: Array
    """(K, p)."""
    inverse: Array
    """(K, m, m) of the active part of `normal`."""
    x: Array
    """(K, m) scaled parameters."""

    @classmethod
    def of(cls, moments: Moments, active: Integers, weights: Array, prior: Array, strength: float) -> Neighbours:
        """The fits with these weights (n,) of joints, drawn to `prior` (p,) with `strength`."""
        gram, cross = moments.weighted(weights)
        normal, right = gram.sum(axis=0) - gram, cross.sum(axis=0) - cross
        diagonal = np.einsum("kpp->kp", normal)
        ridge = diagonal[:, active].mean(axis=1)[:, None] * moments.ridge(strength)
        diagonal += ridge
        right += ridge * prior
        inverse = np.linalg.inv(normal[:, active[:, None], active])
        return cls(moments, active, normal, right, inverse, (inverse @ right[:, active, None])[..., 0])

    def larger(self, columns: Integers) -> Array:
        """(C, K, n) squared errors of the block left out, of fits with one column (C,) more each."""
        border = self.normal[:, self.active[:, None], columns]  # (K, m, C)
        across = self.inverse @ border
        left = self.normal[:, columns, columns] - np.sum(border * across, axis=1)
        step = (self.right[:, columns] - np.einsum("kmc,km->kc", border, self.x)) / np.maximum(left, 1e-300)
        return self._errors(-across, step, columns)

    def smaller(self, places: Integers) -> Array:
        """(C, K, n) likewise, of fits without one of the active columns each, `places` (C,) among them."""
        return self._errors(self.inverse[:, :, places], -self.x[:, places] / self.inverse[:, places, places], None)

    def _errors(self, along: Array, step: Array, own: Integers | None) -> Array:
        """Errors of x + step along (K, m, C), and `step` at a new column `own` of each."""
        gram, cross, at = self.moments.gram, self.moments.cross, self.active
        G, h, x, along = gram[:, :, at[:, None], at], cross[:, :, at], self.x[:, None, :], along[:, None]
        back = (G @ x[..., None])[..., 0]  # (K, n, m)
        error = self.moments.square + np.sum(x * (back - 2.0 * h), axis=-1)
        slope = ((back - h)[:, :, None] @ along)[:, :, 0]  # (K, n, C)
        bend = np.sum((G @ along) * along, axis=2)
        if own is not None:
            beside = gram[:, :, at[:, None], own]
            slope = slope + (x[:, :, None] @ beside)[:, :, 0] - cross[:, :, own]
            bend = bend + 2.0 * np.sum(beside * along, axis=2) + gram[:, :, own, own]
        found = error[..., None] + step[:, None] * (2.0 * slope + step[:, None] * bend)
        return np.maximum(np.moveaxis(found, -1, 0), 0.0)
