# SPDX-License-Identifier: Apache-2.0
"""Filters shift nothing and weigh frequencies as Butterworth's do; signals can be read between their samples."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.errors import IdentificationError
from trueup.identification.estimation.cutoff import natural_cutoff
from trueup.identification.estimation.filtering import Lowpass, grid, moved, stretches
from trueup.identification.estimation.motion import Log


@pytest.mark.parametrize("cutoff", [5.0, 20.0, 45.0])
def test_the_filter_weighs_each_frequency_as_butterworths_does_both_ways(cutoff: float) -> None:
    t, frequencies = np.arange(4000) / 100.0, np.array([1.0, 4.0, 5.0, 12.0, 20.0, 30.0])
    passed = Lowpass(100.0, cutoff)(np.sin(2 * np.pi * frequencies * t[:, None]))[1000:-1000]
    # S. Butterworth 1930, by the bilinear transform; 1 / 2 at the cut-off, where each way leaves the square root of that.
    ratio = np.tan(np.pi * frequencies / 100.0) / np.tan(np.pi * cutoff / 100.0)
    expected = np.sin(2 * np.pi * frequencies * t[1000:-1000, None]) / (1.0 + ratio**8)
    assert np.abs(passed - expected).max() < 1e-6


def test_a_slow_sine_passes_without_delay_and_a_fast_one_does_not() -> None:
    t = np.arange(2000) / 500.0
    slow, fast = np.sin(2 * np.pi * 1.0 * t), np.sin(2 * np.pi * 60.0 * t)
    passed = Lowpass(500.0, 20.0)(slow + fast)
    assert np.abs(passed - slow)[200:-200].max() < 2e-4


def test_columns_of_any_shape_are_filtered_along_the_axis_asked_for(rng: np.random.Generator) -> None:
    x = rng.normal(size=(2, 300, 3))
    assert np.allclose(Lowpass(100.0, 10.0)(x, axis=1)[1, :, 2], Lowpass(100.0, 10.0)(x[1, :, 2]))


@pytest.mark.parametrize("cutoff", [0.0, 50.0, -1.0])
def test_a_cutoff_that_cannot_be_had_is_refused_with_the_range(cutoff: float) -> None:
    with pytest.raises(IdentificationError, match="between 0 and 50 Hz"):
        Lowpass(100.0, cutoff)


def test_a_signal_is_read_between_its_samples() -> None:
    t = np.arange(100.0)
    for by in (-7.3, -2.0, 0.4, 3.75):
        assert np.abs(moved(np.sin(0.4 * t), by) - np.sin(0.4 * (t + by)))[15:-15].max() < 1e-4


def test_a_gap_ends_a_stretch_of_even_time() -> None:
    time = np.asarray(np.concatenate([np.arange(50.0), np.arange(80.0, 100.0)]) * 0.004, dtype=np.float64)
    assert stretches(time) == [slice(0, 50), slice(50, 70)]


def test_rates_are_round_numbers_where_stamps_are_printed_with_few_digits() -> None:
    time = np.round(np.arange(1000) / 125.0, 6)
    instants, rate = grid(time + 3.0)
    assert rate == 125.0
    assert instants[0] == 3.0
    assert len(instants) == 1000


def test_a_motion_of_a_few_samples_has_a_cutoff(rng: np.random.Generator) -> None:
    t = np.arange(22) / 100.0
    q = np.sin(9.0 * t)[:, None] + 1e-4 * rng.standard_normal((22, 2))
    log = Log("short", t, 100.0, q, None, np.zeros_like(q), "torque", ("N m", "N m"))
    assert 0.0 < natural_cutoff([log]) <= 16.0
