# SPDX-License-Identifier: Apache-2.0
"""While brakes hold an arm its drives give nothing: that stands at the ends of a log, and is no motion however noisy."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.identification.estimation.motion import Motion


def test_noise_of_an_arm_on_its_brakes_is_no_motion() -> None:
    time: Array = 0.02 * np.arange(1500, dtype=np.float64)
    moving = np.clip(time - 8.0, 0.0, 14.0)  # brakes for 8 s before and behind
    noise = np.random.default_rng(0).normal(0.0, 2e-4, (1500, 2))
    q = np.stack([0.5 * np.sin(1.4 * moving), 0.4 * np.sin(2.1 * moving) + 1.0], axis=1) + noise
    v, a = (np.asarray(np.gradient(x, 0.02, axis=0), dtype=np.float64) for x in (q, np.zeros_like(q)))
    motion = Motion("log", time, 50.0, q, v, a, np.zeros_like(q))
    assert motion.span() == pytest.approx((8.0, 22.0), abs=0.15)


def test_a_slow_start_is_motion_from_its_beginning() -> None:
    time: Array = 0.02 * np.arange(500, dtype=np.float64)
    speed = np.where((time > 3.0) & (time < 6.0), np.sin(2.0 * np.pi * (time - 3.0) / 3.0), 0.0) + 0.015
    v = np.stack([speed, np.zeros_like(speed)], axis=1)
    q = 0.02 * np.cumsum(v, axis=0)
    motion = Motion("log", time, 50.0, q, v, np.zeros_like(q), np.zeros_like(q))
    assert motion.span() == pytest.approx((0.0, time[-1]), abs=0.05)
