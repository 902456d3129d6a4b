# SPDX-License-Identifier: Apache-2.0
"""Torque along a log as sparse columns, joint by joint, and what passes filters and cuts with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array, Integers, Mask


@dataclass(frozen=True)
class Rows:
    """A regressor joint by joint, with the columns only that a joint's torque depends on, and the torque measured."""

    columns: tuple[Integers, ...]
    """For each joint the columns that are not zero."""
    values: tuple[Array, ...]
    """For each joint (p_j, S)."""
    torque: Array
    """(S, n) in N m (N); NaN where there is none."""
    time: Array
    """(S,) in s."""
    p: int
    shrink: Array | float = 0.0
    """(p,) share of its own squares that draws each parameter towards zero, see Effect.shrink."""

    @property
    def length(self) -> int:
        """S, the number of samples."""
        return len(self.time)

    def predict(self, parameters: Array) -> Array:
        """(S, n) torque for parameters (p,)."""
        return np.stack([parameters[c] @ v for c, v in zip(self.columns, self.values, strict=True)], axis=1)

    def filtered(self, lowpass: Callable[..., Array], every: int) -> Rows:
        """Each column and the torque through the same filter, then every `every`-th sample of both."""
        values = tuple(np.ascontiguousarray(lowpass(v, axis=1)[:, ::every]) for v in self.values)
        torque = lowpass(self.torque, axis=0)[::every] if np.isfinite(self.torque).all() else self.torque[::every]
        return replace(self, values=values, torque=torque, time=self.time[::every])

    def part(self, keep: slice | Integers | Mask) -> Rows:
        """Some of the samples."""
        values = tuple(v[:, keep] for v in self.values)
        return replace(self, values=values, torque=self.torque[keep], time=self.time[keep])

    def scaled(self, by: Array) -> Rows:
        """With each sample of each joint multiplied by (S, n) factors."""
        values = tuple(v * by[:, j] for j, v in enumerate(self.values))
        return replace(self, values=values, torque=self.torque * by)

    def with_shrinkage(self, share: float) -> Rows:
        """With `share` of what draws parameters towards zero."""
        return replace(self, shrink=share * self.shrink)

    def dense(self) -> Array:
        """(S, n, p) the whole regressor."""
        full = np.zeros((len(self.values), self.p, self.length))
        for j, (c, v) in enumerate(zip(self.columns, self.values, strict=True)):
            full[j, c] = v
        return np.moveaxis(full, -1, 0)
