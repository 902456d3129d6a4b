# SPDX-License-Identifier: Apache-2.0
"""Looks around an optimum: cracks and stairs that slopes do not show, and how unsure these leave the estimates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.loop.descent import Fit
from trueup.loop.identifiability import NO_EFFECT, effects
from trueup.loop.problem import Problem
from trueup.loop.uncertainty import curvature_inverse
from trueup.search.filtering import ImplicitFiltering
from trueup.search.robust import robust_losses, robust_weights

PROBED = 2.5  # standard deviations to either side, within which replays are looked at: 95 % intervals end at two
ROUGH = 0.15  # share of a wide difference that slopes do not explain; smooth problems stay below 0.05


def probed(problem: Problem, fit: Fit, seed: int) -> Fit:
    """The fit with the uncertainty in its `scatter` that slopes do not know of.

    Contacts, saturated drives and dry friction switch from one step of a simulation to the next: the loss is a bowl with
    cracks. From every probe one step with the slopes leads back to the optimum in a bowl; across a crack it leads elsewhere.
    Where it leads is what an estimate from that side would be, so these ends scatter as estimates do. And among stairs
    that are higher all around than the bowl foretells, the lowest may be any where the bowl is no deeper than they are.
    """
    pairs = 5  # points looked at, each with its mirror image
    search = ImplicitFiltering(fit.unit, fit.bend, fit.jacobian, fit.residual, chance=problem.chance, seed=seed)
    points = search.around(PROBED, pairs)
    weak = effects(fit) < NO_EFFECT
    points[:, weak] = fit.unit[weak]
    points = np.concatenate([points, 0.5 * (fit.unit + points)])
    residuals = problem.residuals(fit.space.from_unit(points))
    far, good = np.arange(len(points)) < len(points) // 2, np.isfinite(residuals).all(axis=1)
    inverse = curvature_inverse(fit, 2.0 * problem.chance(fit.residual))
    stepped = (robust_weights(residuals, fit.bend) * residuals)[far & good] @ fit.jacobian @ inverse
    ends = np.clip(points[far & good] - stepped, 0.0, 1.0) - fit.unit
    if not len(ends):
        return fit
    scatter = ends.T @ ends / len(ends)
    bowl = 0.5 * np.sum((((points - fit.unit) @ fit.jacobian.T) ** 2) * fit.weights, axis=1)
    scatter += 2.0 * stairs(np.where(good, robust_losses(residuals, fit.bend) - fit.loss - bowl, np.nan)) * inverse
    return replace(fit, scatter=scatter if fit.scatter is None else scatter + fit.scatter)


def stairs(above: Array) -> float:
    """How high stairs stand, of losses (4 k,) above a bowl: of pairs, all of one side first, and of those half as far away.

    What a smooth valley rises above its bowl because it bends is a sixteenth at half the way, as what is odd cancels in a
    pair; stairs are as high near by. So they are what is left at no distance (L. F. Richardson, Philosophical Transactions
    of the Royal Society A 210, 1911). A cliff on one side counts by half: of legs that land, the truth is often beyond.
    """
    far, near = np.mean(above.reshape(2, 2, -1), axis=1)
    left = (16.0 * near - far) / 15.0
    return max(0.0, float(np.median(left[np.isfinite(left)]))) if np.isfinite(left).any() else 0.0


def unexplained(points: Array, residuals: Array, slopes: Array) -> float:
    """Median share of the differences across pairs (2 k, n), (2 k, m) that slopes (m, n) do not explain: 0 in a bowl."""
    k = len(points) // 2
    seen = residuals[:k] - residuals[k:]
    left = np.linalg.norm(seen - (points[:k] - points[k:]) @ slopes.T, axis=1)
    size = np.linalg.norm(seen, axis=1)
    told = np.isfinite(left) & (size > 0.0)
    return float(np.median(left[told] / size[told])) if told.any() else 0.0
