# SPDX-License-Identifier: Apache-2.0
"""Bags are read without ROS: joints by name whatever their order, header time before time of reception."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trueup import formats
from trueup.errors import FormatError, MissingExtraError

JOINT_STATE = "sensor_msgs/msg/JointState"
TIME = np.arange(40) / 100.0


@pytest.mark.parametrize("mcap", [False, True])
def test_joints_keep_their_columns_when_messages_change_their_order(
    tmp_path: Path, small_files: Any, mcap: bool
) -> None:
    (recording,) = formats.read(small_files.write_joint_bag(tmp_path / "bag", mcap=mcap))
    position = recording.channel("position").select(["hip", "knee"])
    assert np.array_equal(position.values, small_files.recording().channel("position").values)
    assert position.unit == "rad"


@pytest.mark.parametrize("mcap", [False, True])
def test_the_file_inside_a_bag_reads_like_the_bag(tmp_path: Path, small_files: Any, mcap: bool) -> None:
    bag = small_files.write_joint_bag(tmp_path / "bag", mcap=mcap)
    (file,) = [path for path in bag.iterdir() if path.suffix in (".mcap", ".db3")]
    (a,), (b,) = formats.read(bag), formats.read(file)
    assert np.array_equal(a.channel("position").values, b.channel("position").values)


def test_the_time_of_the_header_counts_where_there_is_one(tmp_path: Path, small_files: Any) -> None:
    (recording,) = formats.read(small_files.write_joint_bag(tmp_path / "bag"))
    # Both topics are stamped alike; the states were received 2 ms later.
    assert recording.channel("position").time == pytest.approx(TIME, abs=1e-6)
    assert recording.channel("command").time == pytest.approx(TIME, abs=1e-6)
    assert float(recording.provenance["time_origin"].split()[0]) == pytest.approx(1.7e9)


def test_a_gripper_that_publishes_on_the_same_topic_does_not_tear_holes(tmp_path: Path, small_files: Any) -> None:
    messages = []
    for t in TIME + 1.0:
        messages.append(("/joint_states", JOINT_STATE, t, small_files.joint_state(t, ["hip", "knee"], [t, 2 * t])))
        messages.append(("/joint_states", JOINT_STATE, t, small_files.joint_state(t + 0.003, ["finger"], [0.1])))
    (recording,) = formats.read(small_files.write_bag(tmp_path / "bag", messages))
    assert recording.channel("position").labels == ("hip", "knee")
    assert not np.isnan(recording.channel("position").values).any()
    (other,) = [c for c in recording.channels.values() if "finger" in c.labels]
    assert len(other.time) == 40


def test_the_points_of_a_trajectory_are_commands_at_their_times(tmp_path: Path, small_files: Any) -> None:
    kind = "trajectory_msgs/msg/JointTrajectory"
    content = small_files.trajectory(2.0, ["hip"], [(0.1, [1.0]), (0.2, [2.0]), (1.5, [3.0])])
    state = [("/joint_states", JOINT_STATE, t, small_files.joint_state(t, ["hip"], [t])) for t in TIME + 2.0]
    bag = small_files.write_bag(tmp_path / "bag", [("/arm/joint_trajectory", kind, 2.0, content), *state])
    command = formats.read(bag)[0].channel("command")
    assert command.time == pytest.approx([2.1, 2.2, 3.5])
    assert command.values[:, 0].tolist() == [1.0, 2.0, 3.0]


def test_any_message_with_numbers_can_be_named_in_a_mapping(tmp_path: Path, small_files: Any) -> None:
    make = small_files.message
    messages = []
    for t in TIME + 5.0:
        vectors = [make("geometry_msgs/msg/Vector3", x=t, y=2.0, z=3.0) for _ in range(2)]
        wrench = make("geometry_msgs/msg/Wrench", force=vectors[0], torque=vectors[1])
        stamped = make("geometry_msgs/msg/WrenchStamped", header=small_files.header(t), wrench=wrench)
        messages.append(("/ft", "geometry_msgs/msg/WrenchStamped", t, stamped))
        messages.append(("/note", "std_msgs/msg/String", t, make("std_msgs/msg/String", data="hello")))
    bag = small_files.write_bag(tmp_path / "bag", messages)
    mapping = formats.ChannelMap.from_dict(
        {"time": {"column": "stamp"}, "channels": {"force": {"file": "/ft", "columns": "wrench.force.*", "unit": "N"}}}
    )
    force = formats.read(bag, mapping)[0].channel("force")
    assert force.values[0].tolist() == [5.0, 2.0, 3.0]


def test_an_unreadable_bag_is_named(tmp_path: Path, small_files: Any) -> None:
    bag = small_files.write_joint_bag(tmp_path / "bag")
    (file,) = bag.glob("*.db3")
    file.write_bytes(file.read_bytes()[:5000])
    with pytest.raises(FormatError, match=r"bag: cannot be read as a bag \(.*\)"):
        formats.read(bag)


def test_a_bag_without_numbers_is_named(tmp_path: Path, small_files: Any) -> None:
    note = small_files.message("std_msgs/msg/String", data="hello")
    bag = small_files.write_bag(tmp_path / "bag", [("/note", "std_msgs/msg/String", 1.0, note)])
    with pytest.raises(FormatError, match="no message with numbers"):
        formats.read(bag)


def test_without_rosbags_the_message_says_what_to_install(
    tmp_path: Path, small_files: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = small_files.write_joint_bag(tmp_path / "bag")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'trueup\[ros\]'"):
        formats.read(bag)
