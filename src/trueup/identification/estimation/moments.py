# SPDX-License-Identifier: Apache-2.0
"""Regressors condensed to Gram matrices, one for each joint and block of time: weights and choices of columns are free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array, Integers
from trueup.errors import IdentificationError
from trueup.identification.rows import Rows
from trueup.rounding import NEGLIGIBLE, ROUNDED, TINY

RIDGE = ROUNDED
"""Of the mean squared size of a column: keeps what the data cannot tell at its prior, changes nothing else."""


@dataclass(frozen=True, eq=False)
class Normal:
    """Weighted normal equations of all columns, of one fit or of K blocks."""

    gram: Array
    """(..., p, p)."""
    cross: Array
    """(..., p)."""
    square: Array
    """(...) torque with itself."""

    def whole(self) -> Normal:
        """Of all blocks together."""
        return Normal(self.gram.sum(axis=0), self.cross.sum(axis=0), self.square.sum(axis=0))

    def without(self, k: int) -> Normal:
        """Of all blocks but one."""
        whole = self.whole()
        return Normal(whole.gram - self.gram[k], whole.cross - self.cross[k], whole.square - self.square[k])


@dataclass(frozen=True, eq=False)
class Moments:
    """Sums over the samples of K blocks and n joints of columns and torque; columns scaled to unit size."""

    gram: Array
    """(K, n, p, p)."""
    cross: Array
    """(K, n, p) columns with torque."""
    square: Array
    """(K, n) torque with itself."""
    count: Array
    """(K,) samples."""
    scale: Array
    """(p,) root mean square of each column over all joints: parameter = scaled parameter / scale; 0 for absent ones."""
    shrink: Array
    """(p,) share of its own squares that draws each parameter towards zero in a fit; errors do not count it."""

    def take(self, blocks: Sequence[int] | Integers) -> Moments:
        """Some of the blocks."""
        k = np.asarray(blocks, dtype=np.int64)
        return Moments(self.gram[k], self.cross[k], self.square[k], self.count[k], self.scale, self.shrink)

    def only(self, columns: Sequence[int] | Integers) -> Moments:
        """Some of the columns."""
        c = np.asarray(columns, dtype=np.int64)
        K, n, p = self.cross.shape
        # Contiguous, which what indexing gives is not: all that reads it is ten times as fast.
        gram = self.gram.reshape(K * n, p * p).take((p * c[:, None] + c).ravel(), axis=1).reshape(K, n, len(c), len(c))
        return Moments(gram, self.cross[:, :, c], self.square, self.count, self.scale[c], self.shrink[c])

    def errors(self, scaled: Array) -> Array:
        """(K, n) sums of squared errors for scaled parameters (p,), or one vector for each block (K, p)."""
        x = np.broadcast_to(scaled, (len(self.count), scaled.shape[-1]))
        quadratic = (((self.gram @ x[:, None, :, None])[..., 0]) @ x[:, :, None])[..., 0]
        return np.maximum(self.square - 2.0 * (self.cross @ x[:, :, None])[..., 0] + quadratic, 0.0)

    def parameters(self, scaled: Array) -> Array:
        """(p,) parameters of scaled ones (p,)."""
        return np.divide(scaled, self.scale, out=np.zeros(len(self.scale)), where=self.scale > 0.0)

    def with_shrinkage(self, share: float) -> Moments:
        """With `share` of what draws parameters towards zero."""
        return replace(self, shrink=share * self.shrink)

    def weighted(self, weights: Array) -> tuple[Array, Array]:
        """(K, p, p) and (K, p): the normal equations of each block with weights (n,) for the joints."""
        K, n, p = self.cross.shape
        gram = (weights @ self.gram.reshape(K, n, p * p)).reshape(K, p, p)
        diagonal = np.einsum("kpp->kp", gram)
        diagonal *= 1.0 + self.shrink
        return gram, weights @ self.cross

    def ridge(self, strength: float) -> Array:
        """(p,) for solve: `strength` for bodies and rotors, no more than needed for what is drawn to zero anyway."""
        return np.where(self.shrink > 0.0, RIDGE, strength)

    def normal(self, weights: Array) -> Normal:
        """As `weighted`, of the columns as they are: for parameters that are not scaled."""
        gram, cross = self.weighted(weights)
        return Normal(gram * self.scale[:, None] * self.scale, cross * self.scale, self.square @ weights)


def moments_of(parts: Sequence[Rows]) -> Moments:
    """The moments of blocks (one Rows each)."""
    if not parts:
        raise IdentificationError("no stretch of the logs holds motion and torque of all joints: nothing to fit")
    n, p = len(parts[0].values), parts[0].p
    gram, cross = np.zeros((len(parts), n, p, p)), np.zeros((len(parts), n, p))
    square, count = np.zeros((len(parts), n)), np.array([part.length for part in parts], dtype=float)
    for k, part in enumerate(parts):
        for j, (c, v) in enumerate(zip(part.columns, part.values, strict=True)):
            gram[k, j][np.ix_(c, c)] = v @ v.T
            cross[k, j, c] = v @ part.torque[:, j]
        square[k] = np.sum(part.torque**2, axis=0)
    size = np.sqrt(np.einsum("kjpp->p", gram) / (n * count.sum()))
    inverse = np.divide(1.0, size, out=np.zeros(p), where=size > 0.0)
    gram *= inverse[:, None] * inverse
    cross *= inverse
    return Moments(gram, cross, square, count, size, np.broadcast_to(parts[0].shrink, p))


def solve(gram: Array, cross: Array, prior: Array, strength: float | Array = RIDGE) -> Array:
    """(..., p) minimisers of the weighted squares plus a ridge towards `prior` (p,); gram (..., p, p), cross (..., p).

    The ridge is `strength` times the mean diagonal of the Gram matrix, the same for all scaled columns or one for each.
    """
    size = np.maximum(np.einsum("...pp->...", gram) / gram.shape[-1], TINY)
    ridge = np.asarray(size)[..., None] * np.broadcast_to(strength, gram.shape[-1])
    full = gram + ridge[..., None] * np.eye(gram.shape[-1])
    return np.asarray(np.linalg.solve(full, (cross + ridge * prior)[..., None])[..., 0], dtype=np.float64)


def weighted_fit(
    moments: Moments, active: Integers, prior: Array, strength: float = RIDGE, variance: Array | None = None
) -> tuple[Array, Array]:  # fmt: skip
    """(p,) scaled parameters by weighted least squares, and (n,) the error variance of each joint that weighs it.

    Found by repetition from `variance` (1 without). `prior` (p,) is scaled too.
    """
    part, scaled = moments.only(active), np.zeros(len(moments.scale))
    floor = NEGLIGIBLE * moments.square.sum() / moments.count.sum()
    spread = np.ones(moments.square.shape[1]) if variance is None else variance
    for _ in range(4):
        gram, cross = (x.sum(axis=0) for x in part.weighted(1.0 / spread / np.mean(1.0 / spread)))
        scaled[active] = solve(gram, cross, prior[active], part.ridge(strength))
        spread = np.maximum(part.errors(scaled[active]).sum(axis=0) / moments.count.sum(), floor)
    return scaled, spread
