# SPDX-License-Identifier: Apache-2.0
"""Looks at an optimum from further away: where the loss has stairs or cracks, wide differences lead further down."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trueup.loop.descent import Fit, descended
from trueup.loop.probe import ROUGH, unexplained
from trueup.loop.problem import Problem
from trueup.search.filtering import ImplicitFiltering
from trueup.search.robust import robust_weights


@dataclass(frozen=True)
class Wide:
    """How far is looked, and for what it is searched again."""

    looks: tuple[float, ...] = (8.0, 32.0)
    """Standard deviations away."""
    pairs: int = 3
    """Points at each, with their mirror images."""
    rounds: int = 3
    """Of looking wide and going down from there."""
    gain: float = 0.01
    """Share of the loss: for less it is not searched again from a lower place."""
    gross: float = 10.0
    """Noise units of the residuals' rms beyond which the model is wrong by far more than stairs could explain."""


def widened(problem: Problem, fit: Fit, seed: int = 0, robust: float = 3.0, how: Wide | None = None) -> Fit:
    """The fit, or a lower one with the slopes that are seen from there at the width of the estimate's own uncertainty.

    Costs twelve simulations where the loss is smooth, and none where the model is nowhere near the recordings.
    """
    how = how or Wide()
    if np.sqrt(np.mean(fit.residual**2)) > how.gross:
        return fit
    for _ in range(how.rounds):
        wider = _wider(problem, fit, seed, how)
        if wider.loss > (1.0 - how.gain) * fit.loss:
            return wider
        # Past a crack the way down is often smooth again for a while.
        smoother = descended(problem, wider, wider.unit, robust)
        fit = smoother if smoother.loss < wider.loss else wider
    return _wider(problem, fit, seed, how)


def _wider(problem: Problem, fit: Fit, seed: int, how: Wide) -> Fit:
    # Not with `fit.near`: a coarser step has other stairs.
    search = ImplicitFiltering(fit.unit, fit.bend, fit.jacobian, fit.residual, chance=problem.chance, seed=seed)
    if _roughness(problem, fit, search, how) < ROUGH:
        return fit
    while not search.done:
        candidates = search.ask()
        search.tell(candidates, problem.residuals(fit.space.from_unit(candidates)))
    if search.residual is None or search.jacobian is None:
        return fit
    return replace(
        fit, unit=search.point, residual=search.residual, jacobian=search.jacobian, loss=search.loss,
        weights=robust_weights(search.residual, fit.bend), near=None,
        ended="converged: nothing lower at any width of the differences; the loss has jumps",
    )  # fmt: skip


def _roughness(problem: Problem, fit: Fit, search: ImplicitFiltering, how: Wide) -> float:
    """Which share of differences across the optimum its slopes do not explain, in the worse of the looks."""
    looks = [search.around(width, how.pairs) for width in how.looks]
    return max(unexplained(points, problem.residuals(fit.space.from_unit(points)), fit.jacobian) for points in looks)
