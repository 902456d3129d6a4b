# SPDX-License-Identifier: Apache-2.0
"""Drives that let go are told from those that are slow, weak, or stopped by something in the way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.inspection.released import without_released
from trueup.recording import Channel, Recording

JOINTS = ("yaw", "shoulder", "elbow")
TIME: Array = 0.01 * np.arange(2000, dtype=np.float64)  # s
WEIGHT = np.array([0.0, -40.0, -20.0])  # rad/s2 by which it pulls at each joint


def _told(time: np.ndarray) -> np.ndarray:
    return np.array([0.8, 0.5, 0.6]) * np.sin(np.array([0.7, 1.1, 1.9]) * time[:, None])


def _run(
    told: np.ndarray, *, off: tuple[float, float] = (0.0, 0.0), wall: float = -np.inf, speed: float = np.inf
) -> Recording:
    """Joints on servos of 3 Hz that weight pulls down to -2 rad, or onto a wall below the shoulder."""
    there, rate, target, found = told[0].copy(), np.zeros(3), told[0].copy(), []
    lowest = np.array([-2.0, max(-2.0, wall), -2.0])
    for time, row in zip(TIME, told, strict=True):
        for _ in range(10):
            target = target + np.clip(row - target, -speed * 0.001, speed * 0.001)
            on = not off[0] <= time < off[1]
            rate = rate + 0.001 * (on * (400.0 * (target - there) - 30.0 * rate) + WEIGHT - 2.0 * rate)
            there = there + 0.001 * rate
            rate = np.where(there < lowest, 0.0, rate)
            there = np.maximum(there, lowest)
        found.append(there)
    channels = {"command": told, "position": np.array(found)}
    return Recording("run", {n: Channel(n, JOINTS, "rad", TIME, values) for n, values in channels.items()})


@pytest.mark.parametrize("told", [_told, lambda t: _told(np.where((t > 7.9) & (t < 13.0), 7.9, t))])
def test_a_stretch_in_which_the_drives_let_go_is_left_out_and_said(told: Callable[[np.ndarray], np.ndarray]) -> None:
    run = _run(told(TIME), off=(8.0, 12.0))
    parts, notes = without_released([run, _run(_told(TIME))])
    assert [p.name for p in parts] == ["run part 1", "run part 2", "run"]
    assert 7.0 < parts[0].stop <= 8.0
    assert 12.1 < parts[1].start < 13.5
    (note,) = notes
    assert "the drives had let go" in note
    assert "'run part 2'" in note


def _steps(time: np.ndarray) -> np.ndarray:
    return np.array([1.0, 0.8, -0.9]) * np.sign(np.sin(0.6 * time + 0.1))[:, None]


@pytest.mark.parametrize(
    "run",
    [_run(_told(TIME)), _run(_told(TIME), wall=-0.1), _run(_steps(TIME)), _run(_steps(TIME), speed=0.6)],
    ids=["follows", "stopped by a wall", "steps", "slow steps"],
)
def test_drives_that_follow_as_they_can_have_not_let_go(run: Recording) -> None:
    parts, notes = without_released([run])
    assert parts[0] is run
    assert not notes
