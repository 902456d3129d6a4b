# SPDX-License-Identifier: Apache-2.0
"""Vehicles whose antenna or marker is not in the middle: in curves it drives another way, at another speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.engines.vehicle import Vehicle, VehicleSimulator
from trueup.engines.vehicle.prediction import prediction_errors
from trueup.engines.vehicle.vehicle import TURNED
from trueup.loop.calibrate import Options
from trueup.loop.fit import DESCENT
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording
from trueup.samples import wrapped

ASIDE, AHEAD, LAG, STEP = 0.2, -0.1, 0.15, 0.01  # m, m, s, s
EXACT = {
    "speed_delay": 0.0, "speed_lag": 0.0, "speed_scale": 1.0, "speed_gain": 1.0 / LAG, "acceleration_limit": 50.0,
    "braking_limit": 50.0, "turn_delay": 0.0, "turn_lag": LAG, "turn_change_limit": 50.0, "turn_left": 1.0,
    "turn_right": 1.0, "turn_offset": 0.0, "pose_ahead": AHEAD, "push_lasts": 0.0, "trim_lasts": 0.0,
}  # fmt: skip


def _drive(name: str, seconds: float, seed: int) -> Recording:
    """A robot that takes up steps of speed and turn rate with a lag; a point of it is tracked with 3 mm of noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, STEP)
    told = np.repeat(rng.uniform((0.2, -1.2), (0.8, 1.2), (len(time) // 150 + 1, 2)), 150, axis=0)[: len(time)]
    told[:100] = 0.0
    went, share = np.zeros_like(told), 1.0 - np.exp(-STEP / LAG)
    for k in range(1, len(time)):
        went[k] = went[k - 1] + share * (told[k - 1] - went[k - 1])
    yaw = np.cumsum(STEP * went[:, 1])
    middle = np.cumsum(STEP * went[:, :1] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1), axis=0)
    point = (
        middle + AHEAD * np.stack([np.cos(yaw), np.sin(yaw)], axis=1) + ASIDE * np.stack([-np.sin(yaw), np.cos(yaw)], 1)
    )
    seen = slice(None, None, 3)
    channels = (
        Channel("command", ("speed", "turn"), "", time, told, units=("m/s", "rad/s")),
        Channel("position", ("x", "y"), "m", time[seen], point[seen] + rng.normal(0.0, 3e-3, point[seen].shape)),
        Channel(
            "heading",
            ("heading",),
            "rad",
            time[seen],
            wrapped(yaw[seen] + rng.normal(0.0, 3e-3, len(yaw[seen])))[:, None],
        ),
    )
    return Recording(name, {c.name: c for c in channels})


def test_a_prediction_begins_and_ends_where_a_point_aside_was_tracked() -> None:
    """Also its speed: on the inside of a curve of 1 rad/s it is 0.2 m/s slower than the robot."""
    drive = _drive("drive", 30.0, 0)
    off = {}
    for left in (ASIDE, 0.0):
        robot = VehicleSimulator(
            Vehicle("robot", 0.3, drive=TURNED, full=(1.0, 1.0), values={**EXACT, "pose_left": left})
        )
        off[left] = float(np.mean(prediction_errors(robot, np.zeros(0), robot.prepared(drive), (1.0,))))
    assert off[ASIDE] < 0.02
    assert off[0.0] > 3.0 * off[ASIDE]


def test_a_calibration_finds_how_far_aside_the_tracked_point_is(tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text('[vehicle]\ntrack = 0.3\ndrive = "turn"\n')
    drives = [_drive(f"drive {k}", 20.0, k) for k in range(2)]
    found = prepare(tmp_path / "robot.toml", drives, []).calibrate(
        Options(stages=DESCENT, cross_validate=False, lacking=False)
    )
    values = {e.name: e.value for e in found.estimates}
    assert values["pose_left"] == pytest.approx(ASIDE, abs=0.02)
    assert values["pose_ahead"] == pytest.approx(AHEAD, abs=0.02)
    assert values["turn_left"] == pytest.approx(1.0, abs=0.03)
