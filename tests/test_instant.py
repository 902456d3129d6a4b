# SPDX-License-Identifier: Apache-2.0
"""Where something was and how fast, from noisy samples: right within the standard deviations that are claimed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.instant import at_instant, usual_step
from trueup.recording import Channel

Array = NDArray[np.float64]
TIME = np.arange(0.0, 2.0, 0.005)
SIGMA = np.array([3e-4, 1e-2])  # rad, rad/s


def jerked(t: Array) -> tuple[Array, Array]:
    """A stiff drive that is off its goal by 0.15 rad at 0: it is at full speed after three samples."""
    decay = np.exp(-80.0 * np.maximum(t, 0.0))
    return 0.15 * (1.0 - decay * (1.0 + 80.0 * np.maximum(t, 0.0))), 0.15 * 6400.0 * np.maximum(t, 0.0) * decay


def swung(t: Array) -> tuple[Array, Array]:
    """A slow swing."""
    return 0.4 * np.sin(3.0 * t), 1.2 * np.cos(3.0 * t)


def resting(t: Array) -> tuple[Array, Array]:
    """Nothing."""
    return 0.0 * t, 0.0 * t


@pytest.mark.parametrize("motion", [jerked, swung, resting])
@pytest.mark.parametrize("speeds", [True, False])
def test_a_state_is_within_its_standard_deviations(
    motion: Callable[[Array], tuple[Array, Array]], speeds: bool
) -> None:
    off = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        values = np.stack(motion(TIME), axis=1) + SIGMA * rng.standard_normal((len(TIME), 2))
        channels = [
            Channel(n, ("j",), u, TIME, values[:, k]) for k, (n, u) in enumerate((("p", "rad"), ("v", "rad/s")))
        ]
        for at in (0.0, 0.1, 0.7) if motion is swung else (0.0,):
            found = at_instant(channels[0], channels[1] if speeds else None, at)
            place, pace = (float(m) for m in motion(np.array(at)))
            off.append([(found.value[0] - place) / found.value_sd[0], (found.speed[0] - pace) / found.speed_sd[0]])
    if motion is jerked and not speeds:
        return  # positions alone cannot tell what happens between two of them
    assert np.all(np.sqrt(np.mean(np.square(off), axis=0)) < 1.7)


def test_a_swing_is_known_far_better_than_by_a_single_sample() -> None:
    rng = np.random.default_rng(0)
    place, _ = swung(TIME)
    channel = Channel("position", ("j",), "rad", TIME, place + SIGMA[0] * rng.standard_normal(len(TIME)))
    inside, edge = at_instant(channel, None, 1.0), at_instant(channel, None, 0.0)
    assert inside.value_sd[0] < 0.4 * SIGMA[0]
    assert inside.speed_sd[0] < 0.25 * edge.speed_sd[0]  # samples on both sides


@pytest.mark.parametrize(("motion", "at", "most"), [(swung, 1.0, 0.004), (jerked, 0.01, 0.08), (jerked, 0.2, 0.004)])
def test_speeds_inside_a_log_are_as_right_as_they_are_said_to_be(
    motion: Callable[[Array], tuple[Array, Array]], at: float, most: float
) -> None:
    place, off = motion(TIME)[0], []
    for seed in range(60):
        noisy = place + SIGMA[0] * np.random.default_rng(seed).standard_normal(len(TIME))
        found = at_instant(Channel("position", ("j",), "rad", TIME, noisy), None, at)
        error = found.speed[0] - float(motion(np.array(at))[1])
        off.append([error, error / found.speed_sd[0]])
    error, errors_in_deviations = np.sqrt(np.mean(np.square(off), axis=0))
    assert error < most
    assert errors_in_deviations < 1.5


@pytest.mark.parametrize("measured", [False, True])
def test_steps_that_move_by_the_speed_at_their_end_begin_half_a_step_earlier(measured: bool) -> None:
    """A joint that swings in semi-implicit steps of 10 ms: its positions pass faster than its speeds say."""
    step, place, pace = 0.01, [0.0], [0.0]
    for k in range(200):
        pace.append(pace[-1] + step * 40.0 * np.cos(4.0 * k * step))
        place.append(place[-1] + step * pace[-1])
    time: Array = np.linspace(0.0, 200 * step, 201)
    rng = np.random.default_rng(0)
    positions, speeds = (np.array(x)[:, None] + 1e-5 * rng.standard_normal((201, 1)) for x in (place, pace))
    rates = Channel("v", ("j",), "rad/s", time, speeds) if measured else None
    found = at_instant(Channel("p", ("j",), "rad", time, positions), rates, 0.8)
    assert found.speed_of_steps(step)[0] == pytest.approx(pace[80], abs=0.02)
    if not measured:
        assert abs(found.speed[0] - pace[80]) > 0.1


def test_missing_samples_and_labels_are_no_state() -> None:
    values = np.stack([np.sin(TIME), np.full(len(TIME), np.nan)], axis=1)
    values[:3, 0] = np.nan
    found = at_instant(Channel("position", ("a", "b"), "rad", TIME, values), None, 0.0)
    assert found.value[0] == pytest.approx(0.0, abs=1e-4)
    assert np.isnan(found.value[1])


def test_logs_of_few_samples_a_second_have_speeds_too() -> None:
    slow = np.arange(0.0, 4.0, 0.2)
    place, _ = swung(slow)
    found = at_instant(Channel("p", ("j",), "rad", slow, place), None, 2.05)
    assert found.speed[0] == pytest.approx(float(swung(np.array(2.05))[1]), abs=0.2)
    assert np.isfinite(found.speed_sd[0])


@pytest.mark.parametrize("rate", [60.0, 90.0, 125.0, 240.0])
def test_stamps_in_whole_milliseconds_have_the_rate_at_which_they_were_taken(rate: float) -> None:
    time = np.round(np.arange(0.0, 20.0, 1.0 / rate), 3)
    paused = np.concatenate([time, time + 25.0])
    for stamps in (time, paused):
        assert 1.0 / usual_step(stamps) == pytest.approx(rate, rel=1e-3)


def test_samples_that_were_lost_do_not_change_the_usual_step() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 20.0, 0.01)[rng.uniform(size=2000) > 0.2]
    assert usual_step(time) == pytest.approx(0.01)
