# SPDX-License-Identifier: Apache-2.0
"""How unsure the estimates are because every simulation starts from a state that was itself measured with noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.loop.uncertainty import curvature_inverse
from trueup.noise import estimate_noise
from trueup.trial import Trial

Array = NDArray[np.float64]

_DRAWS = 8


def with_start_scatter(problem: Problem, fit: Fit, rng: np.random.Generator) -> Fit:
    """The fit with its `scatter` grown by what other noise at the starts would have changed.

    An error of the start lasts: a foot that begins 1 cm/s too fast slides further whatever its friction, so the estimate
    moves with it. The noise is drawn anew on the samples from which the simulator estimates the start, by whatever rule
    it has, and one step with the slopes at the optimum says where each of `_DRAWS` draws would have led.
    """
    cheap = fit.near or problem  # a coarser step will do for differences
    noise = [
        {name: np.nan_to_num(estimate_noise(c.values, c.time)) for name, c in t.initial.items()} for t in cheap.trials
    ]
    drawn = cheap.restarted(
        [[_again(t, n, rng) for t, n in zip(cheap.trials, noise, strict=True)] for _ in range(_DRAWS)]
    )
    residuals = drawn.residuals(fit.values[None]).reshape(_DRAWS, -1)
    changed = residuals - cheap.restarted([cheap.trials]).residuals(fit.values[None])  # both without a shifted level
    changed = changed[np.isfinite(changed).all(axis=1)]
    if not len(changed):
        return fit
    moved = np.clip((changed * fit.weights) @ fit.jacobian @ curvature_inverse(fit), -1.0, 1.0)
    scatter = moved.T @ moved / len(moved)
    return replace(fit, scatter=scatter if fit.scatter is None else fit.scatter + scatter)


def _again(trial: Trial, noise: Mapping[str, Array], rng: np.random.Generator) -> Trial:
    """The trial with other noise, of standard deviation (k,) for each channel, on the measurements around its start."""
    initial = {
        name: c.replace(values=c.values + noise[name] * rng.standard_normal(c.values.shape))
        for name, c in trial.initial.items()
    }
    return replace(trial, initial=initial)
