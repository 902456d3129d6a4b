# SPDX-License-Identifier: Apache-2.0
"""Looks around an optimum: slopes over the estimate's own uncertainty, and how unsure jumps leave it beyond that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.loop.descent import Fit
from trueup.loop.identifiability import NO_EFFECT, effects
from trueup.loop.problem import Problem
from trueup.loop.uncertainty import PRIOR
from trueup.search.filtering import ImplicitFiltering
from trueup.search.robust import robust_weights

Array = NDArray[np.float64]

_REACH = 2.5  # standard deviations: 95 % intervals end at two
_PAIRS = 8  # points looked at, each with its mirror image
_ROUNDS = 3  # of looks, each as wide as the last one shows that it must be
ROUGH = 0.15  # share of a wide difference that slopes do not explain; smooth problems stay below 0.05


def probed(problem: Problem, fit: Fit, seed: int) -> Fit:
    """The fit with `scatter` filled in, and with slopes as wide as it is unsure where those at the optimum do not hold.

    Contacts, saturated drives and dry friction switch from one step of a simulation to the next: the loss is a bowl with
    cracks, and a slope at a crack foretells nothing. From every probe one step with the slopes leads back to the optimum
    in a bowl; across a crack it leads elsewhere. Where it leads is what an estimate from that side would be, so the scatter
    of these ends is uncertainty that no slope knows of.
    """
    problem = fit.near or problem
    search = ImplicitFiltering(fit.unit, fit.bend, fit.jacobian, fit.residual, chance=problem.chance, seed=seed)
    weak = effects(fit) < NO_EFFECT
    points = residuals = np.zeros((0, 0))
    for _ in range(_ROUNDS):
        points = search.around(_REACH, _PAIRS)
        points[:, weak] = fit.unit[weak]
        residuals = problem.residuals(fit.space.from_unit(points))
        if not np.isfinite(residuals).all(axis=1).any():
            return fit
        if unexplained(points, residuals, search.slopes) < ROUGH:
            break
        search.see(points, residuals, _REACH)
    good = np.isfinite(residuals).all(axis=1)
    points, residuals = points[good], residuals[good]
    steps = -(robust_weights(residuals, fit.bend) * residuals) @ search.slopes @ _inverse(problem, fit, search.slopes)
    away = np.clip(points + steps, 0.0, 1.0) - fit.unit
    scatter = away.T @ away / len(away)
    return replace(fit, jacobian=search.slopes, scatter=scatter if fit.scatter is None else scatter + fit.scatter)


def unexplained(points: Array, residuals: Array, slopes: Array) -> float:
    """Median share of the differences across pairs (2 k, n), (2 k, m) that slopes (m, n) do not explain: 0 in a bowl."""
    k = len(points) // 2
    seen = residuals[:k] - residuals[k:]
    left = np.linalg.norm(seen - (points[:k] - points[k:]) @ slopes.T, axis=1)
    shares = left / np.maximum(np.linalg.norm(seen, axis=1), 1e-300)
    shares = shares[np.isfinite(shares)]
    return float(np.median(shares)) if len(shares) else 0.0


def _inverse(problem: Problem, fit: Fit, slopes: Array) -> Array:
    """(n, n) inverse of the loss' curvature."""
    curvature = slopes.T @ (slopes * fit.weights[:, None])
    inverse = np.linalg.inv(curvature + 2.0 * problem.chance(fit.residual) * PRIOR * np.eye(len(curvature)))
    return 0.5 * (inverse + inverse.T)
