# SPDX-License-Identifier: Apache-2.0
"""Bags are read without ROS: joints by name whatever their order, header time before time of reception."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trueup import formats
from trueup.errors import FormatError, MissingExtraError
from trueup.formats.messages import rows_of
from trueup.formats.planned import Plan, followed

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


@pytest.mark.parametrize(
    ("ahead", "moved"), [(0.0, False), (0.7, True), (1.69e9, True)], ids=["alike", "apart", "simulated"]
)
def test_headers_on_another_clock_are_set_to_that_of_commands_without_headers(
    tmp_path: Path, small_files: Any, ahead: float, moved: bool
) -> None:
    make, messages = small_files.message, []
    for i, t in enumerate(TIME + 1.7e9):
        state = small_files.joint_state(t - ahead, ["hip"], [float(i)])
        layout = make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
        told = make("std_msgs/msg/Float64MultiArray", layout=layout, data=np.array([float(i)]))
        messages.append(("/joint_states", JOINT_STATE, t + 0.002, state))
        messages.append(("/commands", "std_msgs/msg/Float64MultiArray", t + 0.002, told))
    (recording,) = formats.read(small_files.write_bag(tmp_path / "bag", messages))
    position, command = recording.channel("position"), recording.channel("command")
    assert position.time - command.time == pytest.approx(np.full(len(TIME), 0.0 if moved else -0.002), abs=1e-5)
    assert ("headers count from another instant" in recording.provenance.get("warnings", "")) == moved


def test_messages_that_overtook_others_stand_in_the_order_of_their_headers(tmp_path: Path, small_files: Any) -> None:
    late = np.random.default_rng(0).uniform(0.0, 0.03, len(TIME))
    messages = [
        ("/joint_states", JOINT_STATE, t + 1.0 + delay, small_files.joint_state(t + 1.0, ["hip"], [t]))
        for t, delay in zip(TIME, late, strict=True)
    ]
    (recording,) = formats.read(small_files.write_bag(tmp_path / "bag", messages))
    assert recording.channel("position").values[:, 0] == pytest.approx(TIME)


def test_interfaces_of_joints_are_read_as_their_states() -> None:
    """What every ros2_control broadcaster sends beside joint_states; as many joints as interfaces mixed up their names."""
    interfaces = SimpleNamespace(interface_names=["velocity", "position"], values=[2.0, 1.0])
    message = SimpleNamespace(joint_names=["hip", "knee"], interface_values=[interfaces, interfaces])
    ((_, values),) = rows_of(message, "control_msgs/msg/DynamicJointState").samples
    assert values == {"velocity/hip": 2.0, "position/hip": 1.0, "velocity/knee": 2.0, "position/knee": 1.0}


_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"


def _states(small_files: Any) -> list[tuple[str, str, float, Any]]:
    """A hip that rests at 0.5 rad for 4 s."""
    times = 2.0 + np.arange(400) / 100.0
    return [("/joint_states", JOINT_STATE, t, small_files.joint_state(t, ["hip"], [0.5])) for t in times]


def _command(folder: Path, small_files: Any, plans: list[tuple[float, float, list[tuple[float, list[float]]]]]) -> Any:
    """The command in a bag with plans: when each was received, its header's time, its points."""
    sent = [
        ("/arm/joint_trajectory", _TRAJECTORY, at, small_files.trajectory(stamp, ["hip"], points))
        for at, stamp, points in plans
    ]
    return formats.read(small_files.write_bag(folder / "bag", [*sent, *_states(small_files)]))[0].channel("command")


@pytest.mark.parametrize("stamp", [3.0, 0.0], ids=["at a time", "from now on"])
def test_a_trajectory_is_followed_from_where_the_joint_was_to_each_point_at_its_time(
    tmp_path: Path, small_files: Any, stamp: float
) -> None:
    command = _command(tmp_path, small_files, [(3.0, stamp, [(1.0, [1.5]), (2.0, [1.0])])])
    at = command.at([3.0, 3.5, 4.0, 4.5, 5.0])[:, 0]
    assert at == pytest.approx([0.5, 1.0, 1.5, 1.25, 1.0], abs=1e-6)


def test_a_new_trajectory_takes_over_from_where_the_old_one_has_come_to(tmp_path: Path, small_files: Any) -> None:
    command = _command(tmp_path, small_files, [(2.0, 2.0, [(2.0, [2.5])]), (3.0, 3.0, [(1.0, [1.5])])])
    assert command.at([2.5, 3.0, 3.5, 4.0])[:, 0] == pytest.approx([1.0, 1.5, 1.5, 1.5], abs=1e-6)


def test_a_stream_of_points_for_now_is_a_command_each(tmp_path: Path, small_files: Any) -> None:
    command = _command(tmp_path, small_files, [(t, t, [(0.0, [t])]) for t in (2.0, 2.5, 3.0)])
    assert command.time == pytest.approx([2.0, 2.5, 3.0])
    assert command.values[:, 0].tolist() == [2.0, 2.5, 3.0]


def test_points_with_velocities_are_passed_on_a_cubic() -> None:
    """X = t^2 (3 - 2 t), whose speed is 6 t (1 - t): its own cubic, from two knots."""
    plan = Plan(0.0, ("hip",), np.array([1.0]), np.array([[1.0]]), np.array([[0.0]]))
    time, values = followed([plan], lambda _: np.array([0.0]))
    assert values[:, 0] == pytest.approx(time**2 * (3.0 - 2.0 * time))


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


def test_constants_of_a_messages_type_are_no_channels(tmp_path: Path, small_files: Any) -> None:
    make, messages = small_files.message, []
    for t in TIME + 5.0:
        status = make("sensor_msgs/msg/NavSatStatus", status=0, service=1)
        place = {"latitude": 48.0, "longitude": 11.0 + t, "altitude": 400.0}
        unsure = {"position_covariance": np.zeros(9), "position_covariance_type": 0}
        fix = make("sensor_msgs/msg/NavSatFix", header=small_files.header(t), status=status, **place, **unsure)
        messages.append(("/fix", "sensor_msgs/msg/NavSatFix", t, fix))
    (recording,) = formats.read(small_files.write_bag(tmp_path / "bag", messages))
    names = " ".join(f"{n} {' '.join(c.labels)}" for n, c in recording.channels.items())
    assert "altitude" in names
    assert "sbas" not in names


def _transform(
    small_files: Any, t: float, link: str, at: tuple[float, float], yaw: float
) -> tuple[str, str, float, Any]:
    """A message of one transform, "parent child", received when it was stamped."""
    make, (parent, child) = small_files.message, link.split()
    move = make("geometry_msgs/msg/Vector3", x=at[0], y=at[1], z=0.0)
    turn = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=np.sin(yaw / 2.0), w=np.cos(yaw / 2.0))
    whole = make("geometry_msgs/msg/Transform", translation=move, rotation=turn)
    head = make("std_msgs/msg/Header", stamp=small_files.header(t).stamp, frame_id=parent)
    one = make("geometry_msgs/msg/TransformStamped", header=head, child_frame_id=child, transform=whole)
    return ("/tf", "tf2_msgs/msg/TFMessage", t, make("tf2_msgs/msg/TFMessage", transforms=[one]))


def _twist(small_files: Any, t: float) -> tuple[str, str, float, Any]:
    vector = lambda **v: small_files.message("geometry_msgs/msg/Vector3", **{"x": 0.0, "y": 0.0, "z": 0.0, **v})  # noqa: E731
    twist = small_files.message(
        "geometry_msgs/msg/Twist", linear=vector(x=0.5 + np.sin(t)), angular=vector(z=np.cos(t))
    )
    return ("/cmd_vel", "geometry_msgs/msg/Twist", t, twist)


def test_of_all_frames_on_one_topic_the_base_in_the_outermost_is_where_the_robot_is(
    tmp_path: Path, small_files: Any
) -> None:
    """A localisation, odometry and a wheel share /tf: one after the other they are no way of anything."""
    messages, yaw = [], 0.3
    for t in TIME + 100.0:
        messages += [
            _twist(small_files, t),
            _transform(small_files, t, "map odom", (2.0, 1.0), yaw),
            _transform(small_files, t, "odom base_link", (t - 100.0, 0.0), 0.1),
            _transform(small_files, t, "base_link left_wheel", (0.0, 0.2), 7.0 * t),
        ]
    (recording,) = formats.read(small_files.write_bag(tmp_path / "bag", messages))
    position, turn = recording.channel("position"), recording.channel("orientation")
    wanted = np.array([2.0, 1.0]) + TIME[:, None] * [np.cos(yaw), np.sin(yaw)]
    assert position.values == pytest.approx(wanted, abs=1e-6)
    assert 2.0 * np.arctan2(turn.column("qz"), turn.column("qw")) == pytest.approx(np.full(len(TIME), 0.4))
    assert "map > odom > base_link, of 3 links" in recording.provenance["warnings"]


def test_topics_that_another_computer_stamps_are_set_to_the_recorders_clock(tmp_path: Path, small_files: Any) -> None:
    """Twist has no header, and counts when it was received; poses were stamped 37 s ahead, and came 10 ms later."""
    messages = []
    for t in TIME + 100.0:
        topic, kind, _, pose = _transform(small_files, t + 37.0, "odom base_link", (t, 0.0), 0.0)
        messages += [_twist(small_files, t), (topic, kind, t + 0.01, pose)]
    (recording,) = formats.read(small_files.write_bag(tmp_path / "bag", messages))
    assert recording.channel("position").time == pytest.approx(recording.channel("command").time + 0.01, abs=1e-6)
    assert "/tf by -36.99 s" in recording.provenance["warnings"]


def test_an_unreadable_bag_is_named(tmp_path: Path, small_files: Any) -> None:
    bag = small_files.write_joint_bag(tmp_path / "bag")
    (file,) = bag.glob("*.db3")
    file.write_bytes(file.read_bytes()[:5000])
    with pytest.raises(FormatError, match=r"bag: cannot be read as a bag \(.*\)"):
        formats.read(bag)


def test_a_bag_that_its_recorder_did_not_finish_says_how_it_is_mended(tmp_path: Path, small_files: Any) -> None:
    (file,) = small_files.write_joint_bag(tmp_path / "bag", mcap=True).glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(FormatError, match=rf"{file.name} ends early.*mcap recover"):
        formats.read(file)


def test_efforts_that_are_no_numbers_are_named(tmp_path: Path, small_files: Any) -> None:
    state = small_files.joint_state
    messages = [("/joint_states", JOINT_STATE, t + 1.0, state(t + 1.0, ["hip"], [t])) for t in TIME]
    for _, _, _, message in messages:
        message.effort = np.array([np.nan])
    (recording,) = formats.read(small_files.write_bag(tmp_path / "bag", messages))
    assert "no number in any message of /joint_states: effort/hip" in recording.provenance["warnings"]


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
