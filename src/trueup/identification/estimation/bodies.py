# SPDX-License-Identifier: Apache-2.0
"""Possible bodies, and the same fits without one block of time each, by which they are judged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers
from trueup.evidence import STANDARD_ERRORS, jackknife
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.estimation.consistent import NEAREST, PULL, ConsistentFit, consistent_fit
from trueup.identification.estimation.moments import Moments, Normal
from trueup.identification.estimation.selection import clearly_smaller


@dataclass(frozen=True, eq=False)
class Bodies:
    """The consistent fit to all blocks, and K to all but one each; none of these where there is but one block."""

    fit: ConsistentFit
    folds: tuple[ConsistentFit, ...]
    errors: Array
    """(K, n) squared errors of the block that each did not see."""
    pull: float
    """Towards the model file, see `consistent_fit`."""
    without: Callable[[Moments], tuple[ConsistentFit, ...]]
    """Fits to all but one of other parts each."""


def cross_validated_fit(
    model: DynamicModel, moments: Moments, weights: Array, active: Integers, prior: Array, *, lag: bool = True
) -> Bodies:  # fmt: skip
    """Possible bodies with the `active` effects, as near to the model file as no farther ones are clearly better.

    A file that does not weigh all links draws no more than it must. Torque may fall with acceleration where it does so
    clearly, unless `lag` is false: drives are asked whose inertia would be clearly below zero, and it stays where left-out
    blocks are clearly better predicted with it.
    """
    folds = _Folds(model, moments, weights, active, prior)
    best = folds.bodies(PULL)
    if len(best.folds) < 2:
        return best
    for pull in (10.0 * PULL, NEAREST) if np.isfinite(model.tree.inertial).all() else ():
        nearer = folds.bodies(pull, near=best.fit)
        if clearly_smaller(best.errors, nearer.errors):
            break
        best = nearer
    if not lag:
        return best
    lags = model.columns_of("lag")
    drives = [model.effect(int(k))[0] for k in lags]
    below = np.array([fit.parameters[lags] for fit in folds.bodies(best.pull, tuple(drives), best.fit).folds])
    clear = below.mean(axis=0) < -STANDARD_ERRORS * jackknife(below)
    if not clear.any():
        return best
    lagging = tuple(d for d, negative in zip(drives, clear.tolist(), strict=True) if negative)
    released = folds.bodies(best.pull, lagging, best.fit)
    return released if clearly_smaller(released.errors, best.errors) else best


@dataclass(frozen=True, eq=False)
class _Folds:
    """What bodies are fitted to, with one block after the other left out."""

    model: DynamicModel
    moments: Moments
    weights: Array
    active: Integers
    prior: Array

    def bodies(self, pull: float, lagging: tuple[int, ...] = (), near: ConsistentFit | None = None) -> Bodies:
        """The fit to all blocks and its folds; `near` is a similar fit to start from."""

        def fit(of: Normal, start: ConsistentFit | None) -> ConsistentFit:
            return consistent_fit(self.model, of, self.active, self.prior, pull=pull, lagging=lagging, near=start)

        def without(parts: Moments) -> tuple[ConsistentFit, ...]:
            normal, K = parts.normal(self.weights), len(parts.count)
            return tuple(fit(normal.without(k), whole) for k in range(K if K > 1 else 0))

        whole = fit(self.moments.normal(self.weights).whole(), near)
        folds = without(self.moments)
        scaled = np.array([fold.parameters * self.moments.scale for fold in folds])
        return Bodies(whole, folds, self.moments.errors(scaled) if folds else np.zeros((0, 0)), pull, without)
