# SPDX-License-Identifier: Apache-2.0
"""Trajectories written for robots are what was planned when read back by others: as CSV, JSON and a ROS message."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from trueup.errors import OutputError
from trueup.formats import read
from trueup.formats.trajectory import TOPIC, write_bag, write_csv, write_json
from trueup.recording import Channel, Recording

JOINTS = ("shoulder", "elbow")


@pytest.fixture
def planned() -> Recording:
    time = np.linspace(0.0, 2.0, 1001)
    q = np.stack([np.sin(time), 0.5 * np.cos(2 * time)], axis=1)
    qd = np.stack([np.cos(time), -np.sin(2 * time)], axis=1)
    qdd = np.stack([-np.sin(time), -2 * np.cos(2 * time)], axis=1)
    parts = {"position": ("rad", q), "velocity": ("rad/s", qd), "acceleration": ("rad/s^2", qdd)}
    return Recording("run", {k: Channel(k, JOINTS, unit, time, x) for k, (unit, x) in parts.items()})


def test_the_csv_is_read_as_the_same_positions_and_velocities(planned: Recording, tmp_path: Path) -> None:
    write_csv(planned, tmp_path / "run.csv")
    (back,) = read(tmp_path / "run.csv")
    for name in ("position", "velocity"):
        found = back.channel(name)
        assert set(found.labels) == set(JOINTS)
        assert np.allclose(found.select(JOINTS).values, planned.channel(name).values, atol=1e-7)
    assert np.allclose(back.channel("position").time, planned.channel("position").time)


def test_the_json_holds_points_and_what_is_said_about_them(planned: Recording, tmp_path: Path) -> None:
    write_json(planned, tmp_path / "run.json", {"seed": 3})
    found = json.loads((tmp_path / "run.json").read_text())
    assert found["seed"] == 3
    assert found["joints"] == list(JOINTS)
    assert np.allclose(np.interp(found["time"], planned.channel("position").time, np.sin(planned.channel("position").time)),
                       np.array(found["position"])[:, 0])  # fmt: skip
    assert found["time"][-1] == 2.0


def test_the_bag_holds_one_trajectory_message(planned: Recording, tmp_path: Path) -> None:
    reader = pytest.importorskip("rosbags.highlevel").AnyReader
    for _ in range(2):  # a second one takes the place of the first
        write_bag(planned, tmp_path / "bag")
    with reader([tmp_path / "bag"]) as bag:
        ((connection, _, raw),) = list(bag.messages())
        message = bag.deserialize(raw, connection.msgtype)
    assert connection.topic == TOPIC
    assert connection.msgtype == "trajectory_msgs/msg/JointTrajectory"
    assert tuple(message.joint_names) == JOINTS
    time = np.array([p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points])
    assert np.diff(time).min() > 0.0
    assert len(time) <= 202
    assert abs(time[-1] - 2.0) < 1e-6
    assert np.allclose([p.positions[0] for p in message.points], np.sin(time), atol=1e-6)
    assert np.allclose([p.velocities[1] for p in message.points], -np.sin(2 * time), atol=1e-6)


def test_what_cannot_be_written_is_said(planned: Recording, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        write_csv(planned, tmp_path / "file" / "run.csv")
    with pytest.raises(OutputError):
        write_bag(planned, tmp_path / "file" / "bag")
