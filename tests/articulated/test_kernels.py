# SPDX-License-Identifier: Apache-2.0
"""The compiled kernels do what their definitions say, checked against numerical integration."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trueup.articulated.kernels import ONSET, delayed_commands, firmware_command, own_delayed_commands
from trueup.samples import held_integral


def held(times: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    return values[np.clip(np.searchsorted(times, at, side="right") - 1, 0, None)]


@given(st.integers(0, 10_000), st.floats(0.0, 0.1), st.sampled_from([0.001, 0.002, 0.005, 0.03]))
def test_a_delayed_command_is_the_mean_over_each_step(seed: int, delay: float, step: float) -> None:
    rng = np.random.default_rng(seed)
    times = np.concatenate([[-10.0], np.cumsum(rng.uniform(0.005, 0.02, 30))])
    values, first = rng.standard_normal((31, 1)), round(0.02 / step)
    out = np.empty((1, 12, 1))
    delayed_commands(times, values, held_integral(times, values), np.array([[delay]]), first, step, out)
    fine = (np.arange(4000) + 0.5) / 4000
    for s in range(12):
        mean = held(times, values[:, 0], (first + s + fine) * step - delay).mean()
        assert abs(out[0, s, 0] - mean) < 0.01


def test_commands_are_the_same_however_many_steps_are_asked_for_at_once() -> None:
    rng = np.random.default_rng(1)
    times = np.concatenate([[-10.0], np.cumsum(rng.uniform(0.005, 0.02, 30))])
    values, delay = rng.standard_normal((31, 2)), np.array([[0.013, 0.0], [0.013, 0.02], [0.031, 0.0]])
    at_once, in_parts = np.empty((3, 90, 2)), np.empty((3, 90, 2))
    delayed_commands(times, values, held_integral(times, values), delay, 3, 0.002, at_once)
    for s in range(0, 90, 32):
        part = np.empty((3, min(32, 90 - s), 2))
        delayed_commands(times, values, held_integral(times, values), delay, 3 + s, 0.002, part)
        in_parts[:, s : s + 32] = part
    assert np.array_equal(at_once, in_parts)


def test_commands_issued_on_the_way_are_delayed_alike() -> None:
    rng = np.random.default_rng(0)
    times, values = np.arange(20, dtype=np.float64) * 0.01, rng.standard_normal((20, 1))
    step, delay = 0.002, 0.0137
    early = np.concatenate([[-10.0], times])
    first = np.concatenate([values[:1], values])
    expected = np.empty((1, 90, 1))
    delayed_commands(early, first, held_integral(early, first), np.array([[delay]]), 0, step, expected)
    out = np.empty((1, 1, 1))
    for s in range(90):
        issued = int(np.floor(s * step / 0.01 + 1e-9)) + 1  # a command is issued at the start of the step
        own_delayed_commands(times[:issued], values[:, None], issued, np.array([[delay]]), s, step, out)
        assert abs(out[0, 0, 0] - expected[0, s, 0]) < 1e-9


def test_a_dead_band_passes_nothing_inside_and_the_rest_outside() -> None:
    command, position = np.array([[0.01, 0.5, -0.5]]), np.zeros((1, 3))
    out = np.empty((1, 3))
    firmware_command(command, position, np.full((1, 3), 0.02), np.zeros((1, 3)), out)
    assert np.allclose(out, [[0.0, 0.48, -0.48]])


def test_a_punch_is_whole_from_the_onset_on_and_grows_evenly_within_it() -> None:
    command, position = np.array([[0.25 * ONSET, 0.5, -0.5, 0.0]]) + 1.0, np.ones((1, 4))
    out = np.empty((1, 4))
    firmware_command(command, position, np.zeros((1, 4)), np.full((1, 4), 0.03), out)
    assert np.allclose(out - 1.0, [[0.25 * ONSET + 0.0075, 0.53, -0.53, 0.0]])
