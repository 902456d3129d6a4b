# SPDX-License-Identifier: Apache-2.0
"""Recordings of real robots, each in its own format, are read as they are meant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup import formats
from trueup.formats import ChannelMap
from trueup.recording import Recording

JOINTS = ("Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll", "Jaw")

pytestmark = pytest.mark.realdata


def derivative_correlation(recording: Recording) -> float:
    """How well velocities agree with the derivative of positions; 1 if columns, units and time are right."""
    position, velocity = (
        recording.channel("position"),
        recording.channel("velocity").select(recording.channel("position").labels),
    )
    slope = np.gradient(position.values, position.time, axis=0)
    return float(np.median([np.corrcoef(a, b)[0, 1] for a, b in zip(slope.T, velocity.values.T, strict=True)]))


def test_a_servo_arm_with_quoted_lists(real_data: Path) -> None:
    recordings = formats.read(real_data / "so101" / "recordings")
    assert len(recordings) == 11
    for recording in recordings:
        assert recording.channel("position").labels == JOINTS
        assert recording.channel("command").labels == recording.channel("position").labels
        assert 1.0 / np.median(np.diff(recording.time)) == pytest.approx(49.85, abs=0.05)
        error = recording.channel("position").values - recording.channel("command").values
        assert np.sqrt(np.nanmean(error**2)) < 0.2


def test_an_arm_with_one_number_a_line(real_data: Path) -> None:
    (recording,) = formats.read(real_data / "panda")
    assert recording.channel("torque").values.shape == (20544, 7)
    assert derivative_correlation(recording) > 0.9


def test_an_arm_without_time(real_data: Path) -> None:
    data = {
        "time": {"rate": 5000.0},
        "channels": {
            "position": {"file": "pos_read_data.csv", "columns": "Joint_*", "unit": "rad"},
            "current": {"file": "curr_data.csv", "columns": "Joint_*", "unit": "A"},
        },
    }
    (recording,) = formats.read(real_data / "tx40", ChannelMap.from_dict(data))
    assert recording.channel("position").values.shape == recording.channel("current").values.shape
    assert recording.duration == pytest.approx(9.0, abs=0.001)


@pytest.mark.parametrize("name", ["bag_sqlite3", "bag_mcap"])
def test_an_arm_in_a_bag(real_data: Path, name: str) -> None:
    (recording,) = formats.read(real_data / "ur10" / name)
    assert recording.channel("position").labels[0] == "shoulder_pan_joint"
    assert [recording.channel(c).unit for c in ("position", "velocity", "torque")] == ["rad", "rad/s", "N m"]
    assert recording.duration == pytest.approx(27.52)
    assert derivative_correlation(recording) > 0.95


def test_a_pendulum_with_its_facts(real_data: Path) -> None:
    recordings = formats.read(real_data / "xl330_pendulum")
    assert {recording.provenance["kp"] for recording in recordings} == {"100", "200", "400"}
    for recording in recordings:
        assert {"command", "position", "velocity", "load"} <= set(recording.channels)
        assert recording.duration == pytest.approx(6.0, abs=0.05)


def test_a_car_with_two_clocks(real_data: Path) -> None:
    """Yaw rate by the gyroscope against yaw by the cameras: they agree only if both clocks are one."""
    path = sorted((real_data / "jetracer" / "91_free_driving_16_sept_2024_slow").glob("*.csv"))[0]
    (recording,) = formats.read(path)
    pose, gyroscope = recording.channel("heading"), recording.channel("yaw_rate")
    assert 1.0 / np.median(np.diff(pose.time)) == pytest.approx(100.0, rel=0.01)
    assert 1.0 / np.median(np.diff(gyroscope.time)) == pytest.approx(10.0, rel=0.01)
    times = np.arange(2.0, recording.stop - 2.0, 0.02)
    yaw = np.unwrap(pose.column("heading"))
    rate = (np.interp(times + 0.05, pose.time, yaw) - np.interp(times - 0.05, pose.time, yaw)) / 0.1
    lags = np.arange(-0.5, 0.5, 0.02)
    agreement = [np.corrcoef(rate, gyroscope.at(times + lag)[:, 0])[0, 1] for lag in lags]
    assert max(agreement) > 0.99
    assert abs(lags[int(np.argmax(agreement))]) < 0.08  # one sample of the slow clock


def test_a_walking_robot_in_many_short_runs(real_data: Path) -> None:
    recordings = formats.read(real_data / "aliengo")
    assert len(recordings) == 26
    for recording in recordings:
        assert recording.channel("command").labels == recording.channel("position").labels
        assert recording.channel("velocity").unit == "rad/s"
