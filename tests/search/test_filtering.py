# SPDX-License-Identifier: Apache-2.0
"""Implicit filtering goes down bowls with stairs, where slopes at a point lead nowhere."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.errors import CalibrationError
from trueup.search.filtering import ImplicitFiltering
from trueup.search.least_squares import LeastSquares
from trueup.testing import check_search

Array = NDArray[np.float64]
TRUTH = np.array([0.42, 0.37, 0.61])


def stairs(points: Array, tread: float) -> Array:
    """(b, 400) residuals: decaying waves of which the second parameter acts in stairs, as a delay does in ticks."""
    time = np.linspace(0.0, 4.0, 400)
    delay = tread * (np.floor(points[:, 1:2] / tread) + np.clip((points[:, 1:2] / tread) % 1.0 / 0.03, 0.0, 1.0))
    noise = np.random.default_rng(5).standard_normal(400)
    wave = np.exp(-2.0 * points[:, :1] * time) * np.sin(6.0 * (time - 2.0 * delay) * (0.5 + points[:, 2:]))
    return wave / 0.01 + noise


def residuals(points: Array, tread: float) -> Array:
    return stairs(points, tread) - stairs(TRUTH[None], tread) + np.random.default_rng(6).standard_normal(400)


def test_it_keeps_the_contract_of_searches() -> None:
    check_search(ImplicitFiltering, residuals=True)


@pytest.mark.parametrize("seed", range(8))
def test_stairs_on_which_slopes_stop_are_gone_down(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tread = 0.02
    slopes = LeastSquares(np.clip(TRUTH + rng.uniform(-0.15, 0.15, 3), 0, 1), np.zeros(3), robust=np.inf)
    while not slopes.done:
        asked = slopes.ask()
        slopes.tell(asked, residuals(asked, tread))
    search = ImplicitFiltering(slopes.best[0], jacobian=slopes.jacobian, residual=slopes.residual, seed=seed)
    evaluations = 0
    while not search.done:
        asked = search.ask()
        evaluations += len(asked)
        search.tell(asked, residuals(asked, tread))
    bottom = 0.5 * float(np.sum(residuals(TRUTH[None], tread) ** 2))
    assert search.loss < bottom + 0.5
    assert search.loss <= slopes.best[1]
    assert evaluations < 300


def test_stairs_do_stop_slopes() -> None:
    # or the test above shows nothing
    bottom = 0.5 * float(np.sum(residuals(TRUTH[None], 0.02) ** 2))
    stuck = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        search = LeastSquares(np.clip(TRUTH + rng.uniform(-0.15, 0.15, 3), 0, 1), np.zeros(3), robust=np.inf)
        while not search.done:
            asked = search.ask()
            search.tell(asked, residuals(asked, 0.02))
        stuck += search.best[1] > bottom + 10.0
    assert stuck >= 3


def test_a_start_that_fails_is_said() -> None:
    search = ImplicitFiltering(np.full(3, 0.5))
    with pytest.raises(CalibrationError, match="fails at the start"):
        search.tell(search.ask(), np.full((7, 4), np.nan))


def test_few_directions_at_a_time_suffice_where_slopes_are_known() -> None:
    rng = np.random.default_rng(1)
    matrix, target = rng.standard_normal((200, 25)) * 30.0, rng.uniform(0.3, 0.7, 25)
    start = np.clip(target + 0.05 * rng.standard_normal(25), 0, 1)
    search = ImplicitFiltering(start, jacobian=matrix, residual=matrix @ (start - target), directions=5)
    first = search.ask()
    assert len(first) == 10
    while not search.done:
        asked = search.ask()
        search.tell(asked, (asked - target) @ matrix.T)
    assert np.allclose(search.point, target, atol=1e-6)
