# SPDX-License-Identifier: Apache-2.0
"""A few scores of the robot correct the simulator's where they were measured, and say how far that reaches."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from trueup.loop.correction import Correction
from trueup.loop.gaussian_process import GaussianProcess

Array = NDArray[np.float64]


def test_it_agrees_with_an_independent_process_of_the_same_numbers() -> None:
    rng = np.random.default_rng(0)
    X, new = rng.random((15, 3)), rng.random((6, 3))
    y = np.sin(4.0 * X[:, 0]) + 0.05 * rng.standard_normal(15)
    own = GaussianProcess.of(X, y)
    kernel = ConstantKernel(own.amplitude**2, "fixed") * Matern(own.length, "fixed", nu=2.5)
    other = GaussianProcessRegressor(kernel, alpha=own.noise**2, optimizer=None)  # type: ignore[arg-type]
    other.fit(X, y)
    mean, deviation = other.predict(new, return_std=True)
    ours = own(new)
    assert ours[0] == pytest.approx(mean, abs=1e-6)
    assert ours[1] == pytest.approx(deviation, abs=1e-6)


def test_noise_and_length_are_found_and_intervals_hold() -> None:
    rng, held, number = np.random.default_rng(1), 0, 0
    lengths = []
    for _ in range(8):
        X = rng.random((60, 2))
        apart = np.sqrt(((X[:, None] - X[None]) ** 2).sum(2)) * np.sqrt(5.0) / 0.4
        K = 4.0 * (1.0 + apart + apart**2 / 3.0) * np.exp(-apart) + 1e-9 * np.eye(60)
        truth = np.linalg.cholesky(K) @ rng.standard_normal(60)
        found = GaussianProcess.of(X[:40], truth[:40] + 0.3 * rng.standard_normal(40))
        mean, deviation = found(X[40:])
        held, number = held + int(np.sum(np.abs(truth[40:] - mean) < 1.96 * deviation)), number + 20
        lengths.append(found.length)
        assert found.noise == pytest.approx(0.3, rel=0.6)
    assert np.median(lengths) == pytest.approx(0.4, rel=0.5)
    assert 0.88 < held / number < 0.99


def test_many_runs_of_one_setting_count_for_more_than_one() -> None:
    X, y = np.array([[0.2], [0.2], [0.8]]), np.array([1.0, 0.0, 0.5])
    few = GaussianProcess.of(X, y)
    many = GaussianProcess.of(X, y, np.array([30.0, 1.0, 1.0]))
    assert many(X[:1])[0][0] > few(X[:1])[0][0] + 0.1


def test_where_the_robot_is_worse_than_simulated_the_search_turns_elsewhere() -> None:
    places = np.linspace(0.0, 1.0, 101)[:, None]

    def simulated(x: Array) -> Array:
        return 2.0 - x[:, 0]  # the farther the better

    def robot(x: Array) -> Array:
        return simulated(x) + 8.0 * np.maximum(x[:, 0] - 0.6, 0.0)  # beyond 0.6 it gets worse

    tried = np.array([[0.1], [0.4], [0.55], [0.75], [1.0]])
    correction = Correction.between(tried, robot(tried), simulated(tried))
    means, _ = correction(places, simulated(places), np.zeros(101))
    assert places[np.argmin(simulated(places)), 0] == 1.0
    chosen = places[[np.argmin(means)]]
    assert 0.4 < chosen[0, 0] < 0.75  # between the neighbours of the best that was tried
    assert robot(chosen)[0] < robot(places[-1:])[0] - 2.0
    at_tried, _ = correction(tried, simulated(tried), np.zeros(5))
    assert np.abs(at_tried - robot(tried)).sum() < 0.2 * np.abs(simulated(tried) - robot(tried)).sum()
    assert correction.process(tried)[1].max() < correction.process(np.array([[3.0]]))[1][0]  # far away it is less sure


def test_scores_that_may_be_negative_are_corrected_by_differences() -> None:
    tried, simulated = np.array([[0.0], [1.0]]), np.array([-0.2, -0.1])
    correction = Correction.between(tried, simulated + 0.05, simulated, np.array([9.0, 9.0]))
    assert not correction.logs
    assert correction(tried, simulated, np.zeros(2))[0] == pytest.approx(simulated + 0.05, abs=0.01)
