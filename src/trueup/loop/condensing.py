# SPDX-License-Identifier: Apache-2.0
"""Start corrections eliminated from the residuals of a trial, and a trial cut out of a longer one.

H. G. Bock and K. J. Plitt, A multiple shooting algorithm for direct solution of optimal control problems, IFAC 1984.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.rounding import SAME_INSTANT
from trueup.trial import Observed, Trial


@dataclass(frozen=True, eq=False)
class Eliminated:
    """Start corrections of one trial, eliminated from its residuals (condensing, by a Schur complement).

    A start that is off by d changes the residuals r, in units of their size, by S d, and costs |d|^2, where d is in standard
    deviations of the measured start. The least over d of |r + S d|^2 + |d|^2 is r' (1 + S S')^-1 r: plain least squares of r
    times the root of that inverse, which takes the share `shrink` off each of the `directions`. What bends, B, no slope
    foretells: it counts as noise of that size, (1 + S S' + B B')^-1 (the second-order filter of M. Athans, R. Wishner and
    A. Bertolini, IEEE Trans. Automatic Control 13(5), 1968).
    """

    columns: slice
    """The trial's part of the residual vector."""
    changes: Array
    """(m, k) S."""
    begun: Array
    """(k,) corrections that the trial begins with already."""
    size: float
    """Of the residuals, in units of noise."""
    directions: Array
    """(m, 2 k) orthonormal."""
    shrink: Array
    """(2 k,)"""

    @classmethod
    def of(cls, columns: slice, changes: Array, bends: Array, begun: Array, size: float) -> Eliminated:
        """From the `changes` (m, k) of residuals of some `size` (in noise units) by a standard deviation of each number, and
        what of them is the same to either side.
        """
        directions, sizes, _ = np.linalg.svd(np.concatenate([changes, bends], axis=1) / size, full_matrices=False)
        return cls(columns, changes / size, begun, size, directions, 1.0 - 1.0 / np.sqrt(1.0 + sizes**2))

    def apply(self, residuals: Array) -> None:
        """Changes residuals (b, M) in place."""
        residuals[:, self.columns] -= self.size * (self.changes @ self.begun)
        part = residuals[:, self.columns]
        part -= ((part @ self.directions) * self.shrink) @ self.directions.T

    def solved(self, residuals: Array, damping: float) -> Array:
        """(k,) the corrections, those begun with included, that go best with residuals (M,), damped."""
        slopes = self.changes.T @ residuals[self.columns] / self.size + self.begun
        normal = self.changes.T @ self.changes
        normal += np.eye(len(slopes)) + damping * np.diag(np.diag(normal))
        return self.begun - np.linalg.solve(normal, slopes)

    def root(self) -> Array:
        """(k, k) symmetric square root of the covariance (1 + S' S)^-1 that replays leave of the corrections; nothing below a
        thirtieth of what was measured, for over ever shorter steps a jump is an ever steeper slope.
        """
        _, sizes, axes = np.linalg.svd(self.changes, full_matrices=False)
        return np.eye(axes.shape[1]) - (axes.T * (1.0 - 1.0 / np.sqrt(1.0 + np.minimum(sizes, 30.0) ** 2))) @ axes

    def loss(self, residuals: Array, amounts: Array) -> Array:
        """(b,) half the squares of residuals (b, M), in units of their size, and of corrections (b, k)."""
        return 0.5 * (np.sum((residuals[:, self.columns] / self.size) ** 2, axis=1) + np.sum(amounts**2, axis=1))


def cut(trial: Trial, start: float, length: float) -> Trial:
    """The part of a trial from an instant on, `length` s at most; it starts where the robot was measured to be then."""
    stop = start + length
    observed = {}
    for name, o in trial.observed.items():
        inside = (o.time >= start - SAME_INSTANT) & (o.time <= stop)
        if inside.any():
            observed[name] = Observed(o.labels, o.unit, o.time[inside])
    left = trial.start + trial.duration - start
    return replace(trial, start=start, duration=min(length, left), observed=observed)


def thinned(trials: Sequence[Trial]) -> Sequence[Trial]:
    """With every so many samples only, where there are more than tell anything new."""
    most_residuals = 600_000  # more cost memory and time and hardly add knowledge: samples are thinned evenly
    total = sum(len(o.time) * len(o.labels) for t in trials for o in t.observed.values())
    stride = int(np.ceil(total / most_residuals))
    if stride <= 1:
        return trials
    return [
        replace(t, observed={n: Observed(o.labels, o.unit, o.time[::stride]) for n, o in t.observed.items()})
        for t in trials
    ]
