# SPDX-License-Identifier: Apache-2.0
"""Looks around an optimum: jumps and lower places that slopes do not show, and how unsure these leave the estimates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.loop.descent import Fit
from trueup.loop.identifiability import NO_EFFECT, effects
from trueup.loop.problem import Problem
from trueup.loop.uncertainty import PRIOR
from trueup.search.robust import robust_losses, robust_weights

Array = NDArray[np.float64]

_REACH = 2.5  # standard deviations: 95 % intervals end at two
_FAR = 0.1  # share of the box: further out slopes foretell nothing
_PAIRS = 8  # points looked at, each with its mirror image
_SHARES = (0.6, 0.8, 0.9, 0.97, 1.0)  # of the way from a probe to the optimum that it foretells


def probed(problem: Problem, fit: Fit, rng: np.random.Generator) -> Fit:
    """The fit with `scatter` filled in, and at a lower place if the probes have found one.

    Contacts, saturated drives and dry friction switch from one step of a simulation to the next: the loss is a bowl with
    cracks. From every probe (drawn from the estimate's own uncertainty, `_REACH` times wider) one step with the
    slopes at the optimum leads back to it in a bowl; across a crack it leads elsewhere. Where it leads is what an estimate
    from that side would be, so the scatter of these ends is uncertainty that no slope knows of.
    """
    problem = fit.near or problem
    inverse, root = _spread(problem, fit)
    drawn = rng.standard_normal((min(_PAIRS, 2 * len(fit.unit)), len(fit.unit)))
    away = np.clip(_REACH * drawn @ root.T, -_FAR, _FAR)
    away[:, effects(fit) < NO_EFFECT] = 0.0
    points = np.clip(fit.unit + np.concatenate([away, -away]), 0.0, 1.0)
    residuals = problem.residuals(fit.space.from_unit(points))
    good = np.isfinite(residuals).all(axis=1)
    if not good.any():
        return fit
    points, residuals = points[good], residuals[good]
    slopes = (robust_weights(residuals, fit.bend) * residuals) @ fit.jacobian
    steps = -slopes @ inverse
    hoped = robust_losses(residuals, fit.bend) + 0.5 * np.einsum("bn,bn->b", slopes, steps)
    away = np.clip(points + steps, 0.0, 1.0) - fit.unit
    seen = replace(fit, scatter=away.T @ away / len(away))
    lower = np.flatnonzero(hoped < fit.loss - problem.chance(fit.residual))
    return _lowest(problem, seen, points, steps, lower[np.argsort(hoped[lower])][:2])


def _spread(problem: Problem, fit: Fit) -> tuple[Array, Array]:
    """(n, n) inverse of the curvature, and a root of the covariance that it stands for."""
    curvature = fit.jacobian.T @ (fit.jacobian * fit.weights[:, None])
    size = 2.0 * problem.chance(fit.residual)
    inverse = np.linalg.inv(curvature + size * PRIOR * np.eye(len(curvature)))
    inverse = 0.5 * (inverse + inverse.T)
    root = np.asarray(np.linalg.cholesky(size * inverse + 1e-18 * np.eye(len(inverse))), dtype=np.float64)
    return inverse, root


def _lowest(problem: Problem, fit: Fit, points: Array, steps: Array, promising: NDArray[np.int64]) -> Fit:
    """The lowest place on the ways back from promising probes; a crack may close the last part of each."""
    if not len(promising):
        return fit
    places = np.clip(np.concatenate([points[promising] + share * steps[promising] for share in _SHARES]), 0.0, 1.0)
    residuals = problem.residuals(fit.space.from_unit(places))
    losses = np.nan_to_num(robust_losses(residuals, fit.bend), nan=np.inf, posinf=np.inf)
    k = int(losses.argmin())
    if losses[k] > fit.loss - problem.chance(fit.residual):
        return fit
    return replace(
        fit, unit=places[k], residual=residuals[k], weights=robust_weights(residuals[k], fit.bend),
        loss=float(losses[k]),
    )  # fmt: skip
