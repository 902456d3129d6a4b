# SPDX-License-Identifier: Apache-2.0
"""Least squares reaches optima that are known, with bounds active, failures, outliers and logarithms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from trueup.search.least_squares import LeastSquares
from trueup.testing import check_search

Array = NDArray[np.float64]


def solve(search: LeastSquares, residual: Callable[[Array], Array]) -> Array:
    while not search.done:
        candidates = search.ask()
        search.tell(candidates, np.array([residual(c) for c in candidates]))
    return search.point


def test_it_keeps_the_contract_of_searches() -> None:
    check_search(lambda start: LeastSquares(start, np.zeros(len(start)), robust=np.inf, tolerance=1e-9), residuals=True)


@pytest.mark.parametrize("seed", range(8))
def test_a_linear_problem_with_active_bounds_is_solved_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix, target = rng.standard_normal((40, 6)), rng.standard_normal(40) * 3
    best = lsq_linear(matrix, target, (0.0, 1.0)).x
    assert ((best < 1e-6) | (best > 1 - 1e-6)).any()
    search = LeastSquares(rng.uniform(0, 1, 6), np.zeros(6), robust=np.inf, tolerance=1e-10)
    assert np.allclose(solve(search, lambda x: matrix @ x - target), best, atol=1e-4)


@pytest.mark.parametrize("start", [(0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0)])
def test_a_start_on_bounds_does_not_stall(start: tuple[float, float]) -> None:
    # Rosenbrock's valley as least squares, optimum at (0.6, 0.6) of the box
    def residual(x: Array) -> Array:
        a, b = x / 0.6
        return np.array([10 * (b - a * a), 1 - a])

    search = LeastSquares(np.array(start), np.zeros(2), robust=np.inf, tolerance=1e-10, max_iterations=200)
    assert np.allclose(solve(search, residual), 0.6, atol=1e-3)


@pytest.mark.parametrize("start", [0.0, 0.02, 0.5, 1.0])
def test_logarithmic_parameters_come_back_from_where_they_have_no_effect(start: float) -> None:
    # decay rates over four decades: at the lower bound the signal hardly depends on them
    span = np.full(2, np.log(1e4))
    time = np.linspace(0, 3, 200)
    truth = np.array([0.8, 5.0])

    def signal(unit: Array) -> Array:
        rate = 1e-3 * np.exp(unit * span)
        return np.exp(-rate[0] * time) + 0.5 * np.sin(rate[1] * time)

    goal = signal(np.log(truth / 1e-3) / span)
    search = LeastSquares(np.array([start, 0.9]), span, tolerance=1e-9, max_iterations=100)
    found = 1e-3 * np.exp(solve(search, lambda u: 100 * (signal(u) - goal)) * span)
    assert np.allclose(found, truth, rtol=1e-2)


def test_outliers_do_not_pull_the_robust_fit() -> None:
    rng = np.random.default_rng(0)
    x = np.linspace(0, 1, 300)
    y = 0.4 * x + 0.3 + 0.01 * rng.standard_normal(300)
    y[::15] += 3.0
    search = LeastSquares(np.array([0.5, 0.5]), np.zeros(2), tolerance=1e-8)
    found = solve(search, lambda p: (p[0] * x + p[1] - y) / 0.01)
    assert np.allclose(found, [0.4, 0.3], atol=0.02)


def test_a_bent_valley_is_followed_with_few_new_slopes() -> None:
    # mass and lever of a link: their product is seen sharply, each alone hardly
    rng = np.random.default_rng(3)
    sharp, vague, noise = rng.standard_normal(400) * 3e3, rng.standard_normal(400) * 10.0, rng.standard_normal(400)
    span = np.array([np.log(10.0), 0.0])

    def residual(unit: Array) -> Array:
        mass, lever = 0.3 * np.exp(unit[0] * span[0]), 0.1 + unit[1]
        return sharp * (mass * lever - 0.3) + vague * (lever - 0.4) + noise

    search = LeastSquares(np.array([0.15, 0.95]), span, robust=np.inf, tolerance=0.05, worth=lambda r: 1.0)
    columns = 0
    while not search.done:
        candidates = search.ask()
        columns += search.jacobian is None
        search.tell(candidates, np.array([residual(c) for c in candidates]))
    assert 0.1 + search.point[1] == pytest.approx(0.4, abs=0.03)
    assert columns <= 15  # by descent alone it takes above forty


def test_a_trial_ends_where_slopes_promise_no_loss_as_low_as_is_wanted() -> None:
    # Rosenbrock's valley beside a residual that stays: no place has a loss below 2
    def residual(x: Array) -> Array:
        a, b = x / 0.6
        return np.array([10 * (b - a * a), 1 - a, 2.0])

    ended = {}
    for wanted in (np.inf, 2.5, 1.9):
        search = LeastSquares(np.array([0.1, 0.9]), np.zeros(2), robust=np.inf, tolerance=1e-10, reuse=0, wanted=wanted)
        solve(search, residual)
        ended[wanted] = search.iteration, search.best[1]
    assert ended[2.5] == ended[np.inf], "a trial that may win is not cut short"
    assert ended[1.9][0] < ended[np.inf][0]
    assert ended[1.9][1] > 2.0


def test_a_place_that_differs_by_rounding_when_seen_again_is_the_end_not_a_circle() -> None:
    # rows of a larger batch are summed in another order: seen again, the lowest place seems a last digit higher
    steps = np.linspace(1.0, 2.0, 40)

    def residual(unit: Array) -> Array:
        return 5.0 * steps + 40.0 * np.abs(unit[0] - 0.3141) + 30.0 * np.abs(unit[1] - 0.2718)

    search = LeastSquares(np.array([0.1, 0.5]), np.zeros(2), tolerance=1e-12)
    for _ in range(300):
        if search.done:
            break
        candidates = search.ask()
        again = 1e-12 if search.jacobian is None else 0.0
        search.tell(candidates, np.array([residual(c) for c in candidates]) + again)
    assert search.done
