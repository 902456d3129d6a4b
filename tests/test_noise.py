# SPDX-License-Identifier: Apache-2.0
"""Noise and encoder grids are found again in simulated signals whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.noise import estimate_grid, estimate_noise

STEP = 2.0 * np.pi / 4096


def motion(time: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """What a robot's joint does: sines up to 2 Hz."""
    rng = np.random.default_rng(seed)
    parts = [rng.uniform(0.1, 0.5) * np.sin(2 * np.pi * f * time + rng.uniform(0, 6)) for f in (0.1, 0.3, 0.9, 2.0)]
    return np.sum(parts, axis=0)


@pytest.mark.parametrize("rate", [50, 100, 250, 1000])
@pytest.mark.parametrize("sigma", [1e-4, 1e-3, 5e-3])
def test_white_noise_on_a_smooth_motion_is_found_within_15_percent(rate: int, sigma: float) -> None:
    time = np.arange(20 * rate) / rate
    for seed in range(4):
        noise = np.random.default_rng(100 + seed).normal(0.0, sigma, len(time))
        assert estimate_noise(motion(time, seed) + noise, time) == pytest.approx(sigma, rel=0.15)


def test_uneven_instants_do_not_pass_for_noise() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(4000) / 200 + rng.uniform(-0.0015, 0.0015, 4000)
    noise = rng.normal(0.0, 2e-4, 4000)
    assert estimate_noise(motion(time, 0) + noise, time) == pytest.approx(2e-4, rel=0.15)


@pytest.mark.parametrize("sigma", [0.0, 0.1, 0.5, 1.0, 2.0])
def test_an_encoder_grid_adds_its_quantisation_error(sigma: float) -> None:
    time = np.arange(6000) / 200
    noisy = motion(time, 1) + np.random.default_rng(2).normal(0.0, 1.0, 6000) * sigma * STEP
    expected = STEP * np.sqrt(sigma**2 + 1.0 / 12.0)
    assert estimate_noise(np.round(noisy / STEP) * STEP, time) == pytest.approx(expected, rel=0.15)


def test_steps_and_impacts_do_not_pass_for_noise() -> None:
    time = np.arange(5000) / 250
    jumps = np.where((time % 2.0) < 1.0, 0.0, 1.0)
    noise = np.random.default_rng(3).normal(0.0, 1e-3, 5000)
    assert estimate_noise(motion(time, 2) + jumps + noise, time) == pytest.approx(1e-3, rel=0.15)


def test_missing_samples_are_passed_over() -> None:
    time = np.arange(5000) / 250
    values = motion(time, 3) + np.random.default_rng(4).normal(0.0, 1e-3, 5000)
    values[::13] = np.nan
    assert estimate_noise(values, time) == pytest.approx(1e-3, rel=0.15)


def test_each_column_has_its_own_noise_and_too_few_samples_have_none() -> None:
    time = np.arange(4000) / 200
    rng = np.random.default_rng(5)
    both = np.stack([motion(time, 4) + rng.normal(0, s, 4000) for s in (1e-4, 1e-2)], axis=1)
    assert estimate_noise(both, time) == pytest.approx([1e-4, 1e-2], rel=0.15)
    assert np.isnan(estimate_noise(both[:5], time[:5])).all()


@pytest.mark.parametrize("offset", [0.0, 0.5, 0.3])
@pytest.mark.parametrize("samples", [400, 6000])
def test_an_encoder_grid_is_found_wherever_its_zero_is(offset: float, samples: int) -> None:
    time = np.arange(samples) / 100
    values = (np.round(motion(time, 5) / STEP) + offset) * STEP
    assert estimate_grid(values) == pytest.approx(STEP, rel=1e-3)


def test_a_grid_is_found_in_single_precision_too() -> None:
    values = (np.round(motion(np.arange(4000) / 100, 6) / STEP) * STEP).astype(np.float32)
    assert estimate_grid(values) == pytest.approx(STEP, rel=1e-3)


def test_half_steps_among_whole_ones_halve_the_grid() -> None:
    values = np.round(motion(np.arange(6000) / 100, 7) / (STEP / 2)) * (STEP / 2)
    assert estimate_grid(values) == pytest.approx(7.67e-4, rel=1e-3)


def test_continuous_values_and_printed_decimals_are_no_grid() -> None:
    smooth = motion(np.arange(6000) / 100, 8)
    assert estimate_grid(smooth) is None
    assert estimate_grid(smooth + np.random.default_rng(0).normal(0, 1e-3, 6000)) is None
    assert estimate_grid(np.round(smooth, 6)) is None
    assert estimate_grid(np.ones(100)) is None
