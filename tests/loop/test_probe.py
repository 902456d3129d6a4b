# SPDX-License-Identifier: Apache-2.0
"""Looking around an optimum: cracks of the loss widen the intervals."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.loop.fit import Fit
from trueup.loop.probe import probed, stairs
from trueup.parameters import Parameter, ParameterSpace

Array = NDArray[np.float64]
SPACE = ParameterSpace(tuple(Parameter(n, "", 0.5, 0.0, 1.0) for n in "xyz"))
SLOPES = np.random.default_rng(1).standard_normal((600, 3)) * 40.0
NOISE = np.random.default_rng(2).standard_normal(600)


def cracked(crack: float, jump: Array) -> tuple[Any, Fit]:
    """A linear problem whose residuals change by `jump` (600,) where x exceeds `crack`, and its fit on the near side."""

    def residuals(values: Array) -> Array:
        return (values - 0.5) @ SLOPES.T + NOISE + np.where(values[:, :1] > crack, jump, 0.0)

    unit = np.asarray(0.5 - np.linalg.lstsq(SLOPES, NOISE, rcond=None)[0], dtype=np.float64)
    residual = residuals(unit[None])[0]
    fit = Fit(SPACE, unit, residual, SLOPES, np.ones(600), "", loss=0.5 * float(residual @ residual))
    return SimpleNamespace(residuals=residuals, chance=lambda r: 0.5 * float(np.mean(r**2))), fit


def test_an_even_bowl_adds_nothing_to_the_intervals() -> None:
    problem, fit = cracked(2.0, np.zeros(600))
    found = probed(problem, fit, 0)
    assert found.scatter is not None
    assert np.sqrt(np.diag(found.scatter)).max() < 1e-6
    assert np.array_equal(found.unit, fit.unit)


@pytest.mark.parametrize("shift", [0.5, 3.0])
def test_a_crack_beyond_which_another_place_is_best_widens_the_intervals(shift: float) -> None:
    problem, fit = cracked(0.5, np.zeros(600))
    sigma = float(np.sqrt(np.linalg.inv(SLOPES.T @ SLOPES)[1, 1]))
    # Beyond the crack, half a standard deviation away in x, the best y lies `shift` standard deviations off.
    jump = -SLOPES[:, 1] * shift * sigma
    problem, fit = cracked(float(fit.unit[0]) + 0.5 * sigma, jump)
    found = probed(problem, fit, 0)
    assert found.scatter is not None
    assert 0.2 * shift * sigma < np.sqrt(found.scatter[1, 1]) < shift * sigma


def test_failed_simulations_around_the_optimum_change_nothing() -> None:
    problem, fit = cracked(2.0, np.zeros(600))
    problem.residuals = lambda values: np.full((len(values), 600), np.nan)
    assert probed(problem, fit, 0) is fit


def test_a_valley_that_bends_adds_no_stairs_and_stairs_are_told_by_their_height() -> None:
    away = np.random.default_rng(3).uniform(1.0, 2.0, 5)
    far, near = (np.concatenate([30.0 * d**4 + 4.0 * d**3, 30.0 * d**4 - 4.0 * d**3]) for d in (away, 0.5 * away))
    smooth = np.concatenate([far, near])
    assert stairs(smooth) < 1e-9
    assert np.isclose(stairs(smooth + 7.0), 7.0)


def test_a_cliff_on_one_side_counts_by_half_and_failed_simulations_not_at_all() -> None:
    above = np.zeros((2, 2, 5))
    above[:, 0] = 50.0
    assert stairs(above.ravel()) == 25.0
    above[:, :, 1:] = np.nan  # simulations that failed
    assert stairs(above.ravel()) == 25.0
    assert stairs(np.full(20, np.nan)) == 0.0
