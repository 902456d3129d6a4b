# SPDX-License-Identifier: Apache-2.0
"""The hints name the effect that was put in, and only then."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.calibration import Replay
from trueup.report.hints import Hint, hints, velocity, worst_moment
from trueup.report.numbers import Scale

MILLI = Scale("mrad", 1000.0)
TIME = np.arange(1500) / 50
MOTION = 0.4 * np.sin(2 * np.pi * 0.3 * TIME) + 0.2 * np.sin(2 * np.pi * 0.71 * TIME + 1)


def hint_of(error: NDArray[np.float64], *, noise: float = 0.0005, every: int = 1) -> Hint:
    jitter = noise * np.random.default_rng(1).standard_normal(TIME.size)
    measured = np.where(np.arange(TIME.size) % every == 0, MOTION + jitter, np.nan)[:, None]
    after = (MOTION + error)[:, None]
    (found,) = hints(
        [Replay("r", True, "position", ("elbow",), "rad", TIME, measured, after, after, None, np.array([noise]))], MILLI
    )
    return found


@pytest.mark.parametrize(("delay", "every"), [(0.012, 1), (-0.012, 1), (0.012, 3)])
def test_a_delay_is_named_with_its_size_and_side(delay: float, every: int) -> None:
    late = 0.4 * np.sin(2 * np.pi * 0.3 * (TIME - delay)) + 0.2 * np.sin(2 * np.pi * 0.71 * (TIME - delay) + 1)
    sentence = hint_of(late - MOTION, every=every).sentence  # every third: a camera beside encoders
    assert ("behind" in sentence) == (delay > 0)
    assert float(re.findall(r"([\d.]+)\sms", sentence)[0]) == pytest.approx(12.0, abs=0.6)


def test_an_offset_is_named_with_its_size() -> None:
    sentence = hint_of(np.full(TIME.size, -0.006)).sentence
    assert "below the recording" in sentence
    assert float(re.findall(r"([\d.]+)\smrad", sentence)[0]) == pytest.approx(6.0, rel=0.02)


def test_a_change_with_direction_is_told_from_a_delay() -> None:
    assert "direction of motion" in hint_of(0.005 * np.sign(np.gradient(MOTION))).sentence


def test_a_wrong_gain_is_named() -> None:
    sentence = hint_of(0.05 * MOTION).sentence
    assert "grows with position (5.0 %" in sentence


def test_an_error_at_the_noise_needs_no_explanation() -> None:
    assert hint_of(np.zeros(TIME.size)).sentence.startswith("at the measurement noise")


def test_an_unrelated_error_gets_no_story() -> None:
    assert "no simple pattern" in hint_of(0.01 * np.sin(2 * np.pi * 6.1 * TIME)).sentence


def test_the_worst_moment_is_where_the_error_was_put() -> None:
    error = 0.001 * np.ones(TIME.size)
    error[(TIME >= 17.0) & (TIME < 18.0)] = 0.02
    error[100:200] = np.nan
    start, stop, size = worst_moment(TIME, error)
    assert (start, stop) == pytest.approx((17.0, 18.0), abs=0.05)
    assert size == pytest.approx(0.02, rel=0.02)
    assert np.isnan(worst_moment(TIME, np.full(TIME.size, np.nan))).all()


def test_velocity_is_the_derivative() -> None:
    truth = np.gradient(MOTION, TIME)
    assert np.abs(velocity(TIME, MOTION) - truth)[5:-5].max() < 0.02 * np.abs(truth).max()
