# SPDX-License-Identifier: Apache-2.0
"""What a log's columns are is guessed from the names that robotics labs give them, and doubts are said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trueup import formats
from trueup.errors import MappingError
from trueup.formats import ChannelMap

TWO = ("joint_1", "joint_2")


def guess(folder: Path, names: str, scale: float = 1.0, rate: float = 100.0) -> ChannelMap:
    """The mapping guessed for a file with these columns, filled with smooth signals."""
    columns = names.split(",")
    time = np.arange(200) / rate
    parts = [time if any(w in name.lower() for w in ("time", "stamp")) or name == "t" else None for name in columns]
    filled = [scale * np.sin(time + i) if part is None else part for i, part in enumerate(parts)]
    text = names + "\n" + "\n".join(",".join(f"{x:.9f}" for x in row) for row in np.column_stack(filled)) + "\n"
    (folder / "log.csv").write_text(text)
    return formats.guess_mapping(folder / "log.csv")


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ("t,q1,q2,q_ref1,q_ref2", {"position": TWO, "command": TWO}),
        ("time,cmd_hip,cmd_knee,pos_hip,pos_knee,cur_hip,cur_knee",
         {"command": ("hip", "knee"), "position": ("hip", "knee"), "current": ("hip", "knee")}),
        ("timestamp,target_q_0,actual_q_0,actual_qd_0,actual_current_0,target_moment_0",
         {"command": ("joint_0",), "position": ("joint_0",), "velocity": ("joint_0",), "current": ("joint_0",),
          "command_torque": ("joint_0",)}),
        ("time,q[0],q[1],q_d[0],q_d[1],dq[0],dq[1],tau_J[0],tau_J[1]",
         {"position": ("joint_0", "joint_1"), "command": ("joint_0", "joint_1"), "velocity": ("joint_0", "joint_1"),
          "torque": ("joint_0", "joint_1")}),
        ("t,target/FL_hip_joint,position/FL_hip_joint,velocity/FL_hip_joint",
         {"command": ("FL_hip_joint",), "position": ("FL_hip_joint",), "velocity": ("FL_hip_joint",)}),
        ("timestamp,goal_position,present_position,present_speed,present_load",
         {"command": ("joint_1",), "position": ("joint_1",), "velocity": ("joint_1",), "load": ("joint_1",)}),
        ("timestamp,shoulder_pan.pos,elbow.pos,action.shoulder_pan,action.elbow",
         {"position": ("shoulder_pan", "elbow"), "command": ("shoulder_pan", "elbow")}),
        ("Time,qDes1,qDes2,qMeas1,qMeas2", {"command": TWO, "position": TWO}),
        ("time,wrist_1_pos,wrist_2_pos,elbow_pos", {"position": ("wrist_1", "wrist_2", "elbow")}),
        ("time,motor_1_pos,motor_2_pos,joint_1_pos,joint_2_pos",
         {"position": ("motor_1", "motor_2"), "position_motor": TWO}),
        ("time,cmd_sent_1,cmd_1,q1", {"command_sent": ("joint_1",), "command": ("joint_1",), "position": ("joint_1",)}),
        ("time,throttle,steering,vel", {"command": ("throttle", "steering"), "speed": ("speed",)}),
        ("time,throttle,steering,encoder speed,mocap x,mocap y,mocap yaw,gyro z",
         {"command": ("throttle", "steering"), "position": ("x", "y"), "heading": ("heading",), "speed": ("speed",),
          "yaw_rate": ("yaw_rate",)}),
        ("time,tcp_pose_x,tcp_pose_y,robot_mode,q1",
         {"position": ("joint_1",), "tcp_pose": ("x", "y"), "robot_mode": ("robot_mode",)}),
    ],
)  # fmt: skip
def test_names_tell_roles_and_joints(tmp_path: Path, names: str, expected: dict[str, tuple[str, ...]]) -> None:
    found = {name: channel.labels for name, channel in guess(tmp_path, names).channels.items()}
    if "position_motor" in expected:  # which of the two is the plain one does not matter; they are kept apart
        assert {frozenset(labels) for labels in found.values()} == {frozenset(v) for v in expected.values()}
    else:
        assert found == expected


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        ("t,pos_hip [deg]", "deg"),
        ("t,pos_hip_deg", "deg"),
        ("t,pos_deg_1", "deg"),
        ("t,hip position (rad)", "rad"),
        ("t,position_hip_m", "m"),
    ],
)
def test_a_unit_in_a_name_is_believed(tmp_path: Path, names: str, unit: str) -> None:
    assert guess(tmp_path, names).channels["position"].unit == unit


def test_angles_too_large_for_radians_are_not_called_radians(tmp_path: Path) -> None:
    mapping = guess(tmp_path, "t,q1,q2", scale=90.0)
    assert mapping.channels["position"].unit == ""
    assert any("degrees are suspected" in note for note in mapping.notes)


def test_a_current_without_unit_is_asked_about(tmp_path: Path) -> None:
    assert "current: unit unknown: say A or mA" in guess(tmp_path, "t,q1,current_1").notes


def test_columns_that_say_nothing_are_listed(tmp_path: Path) -> None:
    mapping = guess(tmp_path, "t,foo,bar")
    assert any("columns are: " in note and "foo" in note for note in mapping.notes)
    assert set(mapping.channels) == {"foo", "bar"}


def test_a_file_with_nothing_but_time_says_what_was_found(tmp_path: Path) -> None:
    with pytest.raises(MappingError, match=r"no column but time holds numbers.*log.csv: time"):
        guess(tmp_path, "time")


def test_without_a_time_the_mapping_asks_for_a_rate(tmp_path: Path) -> None:
    mapping = guess(tmp_path, "q1,q2")
    assert "# rate = 1000.0" in mapping.to_toml()
    with pytest.raises(MappingError, match="or give rate = samples per second"):
        formats.read(tmp_path / "log.csv")


def test_numbers_without_names_are_still_told_from_time(tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text("\n".join(f"{i / 100} {i * i} {-i}" for i in range(50)))
    mapping = formats.guess_mapping(tmp_path / "log.txt")
    assert mapping.time.column == "column_1"
    assert [channel.columns for channel in mapping.channels.values()] == [("column_2", "column_3")]


def test_what_was_guessed_reads_like_no_mapping_at_all(tmp_path: Path, small_files: Any) -> None:
    folder = small_files.write_lists(tmp_path / "run")
    formats.guess_mapping(folder).save(tmp_path / "mapping.toml")
    (plain,), (mapped,) = formats.read(folder), formats.read(folder, tmp_path / "mapping.toml")
    assert plain.channels.keys() == mapped.channels.keys() == {"command", "position"}
    for name, channel in plain.channels.items():
        assert np.array_equal(channel.values, mapped.channel(name).values)
        assert channel.labels == ("hip", "knee")
    assert "position: taken as rad" in plain.provenance["guesses"]
    assert "guesses" not in mapped.provenance


def test_a_unit_at_the_end_of_a_name_says_what_it_is_of(tmp_path: Path) -> None:
    path = tmp_path / "arm.csv"
    rows = "\n".join(f"{10 * i},{i},{2 * i},{i + 1},{2 * i + 1},{0.1 * i},{i}" for i in range(20))
    head = "timestamp_ms,goal_elbow_deg,goal_gripper_mm,present_elbow_deg,present_gripper_mm,elbow_Nm,elbow_dps"
    path.write_text(f"{head}\n{rows}\n")
    (found,) = formats.read([path])
    assert found.channel("command").labels == found.channel("position").labels == ("elbow", "gripper")
    assert np.allclose(found.channel("position").values[-1], [np.radians(20.0), 0.039]), "degrees and millimetres"
    assert found.channel("torque").labels == ("elbow",)
    assert found.channel("velocity").values[-1] == pytest.approx(np.radians(19.0))


def test_act_is_actual_beside_a_word_for_commands_and_an_action_beside_none(tmp_path: Path) -> None:
    found = guess(tmp_path, "t_ms,x_cmd_mm,c_cmd_deg,x_act_mm,c_act_deg", scale=50.0).channels
    assert found["command"].labels == found["position"].labels == ("x", "c")
    assert found["position"].columns == ("x_act_mm", "c_act_deg")
    assert found["position"].units == ("mm", "deg")
    alone = guess(tmp_path, "time,act_1,act_2,pos_1,pos_2").channels
    assert alone["command"].columns == ("act_1", "act_2")
    arm = guess(tmp_path, "Zeitstempel_ns,axis1_act_deg,axis2_act_deg,axis1_current_A,axis2_current_A", scale=50.0)
    assert arm.time.column == "Zeitstempel_ns"
    assert arm.channels["position"].columns == ("axis1_act_deg", "axis2_act_deg"), "an action has no unit"


def test_actions_and_observed_states_one_number_a_column_are_commands_and_positions(tmp_path: Path) -> None:
    found = guess(tmp_path, "time,action.0,action.1,observation.state.0,observation.state.1").channels
    assert found["command"].labels == found["position"].labels == ("joint_0", "joint_1")


def test_raw_and_filtered_signals_of_one_file_are_channels_each(tmp_path: Path) -> None:
    found = guess(tmp_path, "time,q_1,q_2,q_raw_1,q_raw_2").channels
    assert found["position"].columns == ("q_1", "q_2")
    assert found["position_raw"].columns == ("q_raw_1", "q_raw_2")


@pytest.mark.parametrize("speed", ["q_dot_{}", "qdot{}", "q{}_dot", "jv{}"])
def test_a_dot_makes_a_speed_of_a_position(tmp_path: Path, speed: str) -> None:
    names = [f"q{k}" for k in (1, 2)] + [speed.format(k) for k in (1, 2)]
    found = guess(tmp_path, ",".join(["time", *names])).channels
    assert found["position"].columns == ("q1", "q2")
    assert found["velocity"].columns == tuple(names[2:])


def swing(folder: Path, names: str, *factors: float) -> ChannelMap:
    """The mapping guessed for a joint that swings: position, then its speed, then a command, each times a factor."""
    time = np.arange(400) / 100.0
    signals = (np.sin(3.0 * time), 3.0 * np.cos(3.0 * time), np.sin(3.0 * time + 0.05))
    table = [time, *(factor * signal for factor, signal in zip(factors, signals, strict=False))]
    np.savetxt(folder / "log.csv", np.column_stack(table), delimiter=",", header=names, comments="", fmt="%.9g")
    return formats.guess_mapping(folder / "log.csv")


@pytest.mark.parametrize(
    ("names", "factors", "units"),
    [
        # Small motions in degrees look like radians; what goes with them tells.
        ("t,q_hip,dq_hip_rad_s", (9.0, 9.0 * np.pi / 180), {"position": "deg", "velocity": "rad/s"}),
        ("t,q_hip,dq_hip", (0.2, 0.2 * 180 / np.pi), {"position": "rad", "velocity": "deg/s"}),
        ("t,q_hip,dq_hip,q_des_hip", (0.2, 0.2, 0.2 * 180 / np.pi), {"position": "rad", "command": "deg"}),
        ("t,q_hip_deg,dq_hip,q_des_hip", (9.0, 9.0, 9.0), {"velocity": "deg/s", "command": "deg"}),
        ("t,q_hip,dq_hip", (0.2, 0.2 * 60 / (2 * np.pi)), {"velocity": "rpm"}),
        ("t,q_hip,dq_hip", (0.2, 0.16), {"velocity": "rad/s"}),  # filtered
        ("t,q_hip,dq_hip", (0.2, 40.0), {"velocity": ""}),  # no unit makes this of it: it is asked about
    ],
)
def test_units_that_nobody_says_are_told_by_what_goes_with_what(
    tmp_path: Path, names: str, factors: tuple[float, ...], units: dict[str, str]
) -> None:
    mapping = swing(tmp_path, names, *factors)
    assert {name: mapping.channels[name].unit for name in units} == units
    assert ("velocity: unit unknown (it is 200 times" in " ".join(mapping.notes)) == ("" in units.values())


def test_a_column_named_as_its_command_is_its_position_unless_it_alone_moves_against_it(tmp_path: Path) -> None:
    alone = "".join(f"{0.01 * k},{k},{-k - 1}\n" for k in range(20))
    (tmp_path / "alone.csv").write_text("t,goal_tilt,tilt\n" + alone)
    assert set(formats.guess_mapping(tmp_path / "alone.csv").channels) == {"command", "tilt"}
    beside = "".join(f"{0.01 * k},{k},{-k},{k + 1},{k}\n" for k in range(20))
    (tmp_path / "log.csv").write_text("t,goal_pan,goal_tilt,pan,tilt\n" + beside)
    channels = formats.guess_mapping(tmp_path / "log.csv").channels
    assert channels["position"].labels == ("pan", "tilt")


def test_a_sensors_axes_are_no_joints(tmp_path: Path) -> None:
    found = guess(tmp_path, "time,q1,q2,accel_x,accel_y,accel_z,gyro_x,torque_z").channels
    assert set(found) == {"position", "accel", "gyro", "torque"}
    assert found["torque"].labels == ("z",)
    assert found["torque"].unit == ""


def test_whole_numbers_of_an_unknown_encoder_are_asked_about(tmp_path: Path) -> None:
    rows = "".join(f"{0.01 * k},{8000 + 30 * k},{8000 + 30 * k}\n" for k in range(50))
    (tmp_path / "log.csv").write_text("t,hip_goal,hip_counts\n" + rows)
    mapping = formats.guess_mapping(tmp_path / "log.csv")
    assert mapping.channels["position"].unit == ""
    assert any("scale = 6.2832 / counts of a turn" in note for note in mapping.notes)


def test_labels_that_differ_by_words_of_any_drive_are_those_of_the_positions(tmp_path: Path) -> None:
    names = "t,robot0_joint_pos_0,robot0_joint_pos_1,action_0,action_1"
    mapping = guess(tmp_path, names)
    assert mapping.channels["command"].labels == mapping.channels["position"].labels
    assert any("joint_0, joint_1 taken as robot0_joint_0, robot0_joint_1" in note for note in mapping.notes)


def test_what_is_taken_for_the_positions_labels_alike_is_said_once(tmp_path: Path) -> None:
    """A quadruped's twelve drives log six channels each."""
    kinds = ("motor_state[{}].q", "motor_cmd[{}].q", "motor_cmd[{}].dq", "motor_cmd[{}].tau")
    mapping = guess(tmp_path, "t," + ",".join(kind.format(i) for kind in kinds for i in range(2)))
    said = [note for note in mapping.notes if "tells them apart" in note]
    assert said == [
        "command, command_torque, command_velocity: motor_0, motor_1 taken as joint_0, joint_1, by what tells them apart"
    ]


def test_the_left_leg_is_not_taken_for_the_right_one(tmp_path: Path) -> None:
    found = guess(tmp_path, "t,left_hip_pos,left_knee_pos,right_hip_torque,right_knee_torque").channels
    assert found["torque"].labels == ("right_hip", "right_knee")


def test_degrees_beside_revolutions_a_minute_are_told_by_one_another(tmp_path: Path) -> None:
    channels = swing(tmp_path, "t,motor_angle,motor_speed", 40.0, 40.0 / 6.0).channels
    assert (channels["position"].unit, channels["velocity"].unit) == ("deg", "rpm")


@pytest.mark.parametrize("ranges", [(1.92, 1.75, 1.69, 1.66, 2.8), (1.75,)])
def test_commands_in_percent_of_ranges_near_a_hundred_degrees_are_no_degrees(
    ranges: tuple[float, ...], tmp_path: Path
) -> None:
    t = np.arange(0.0, 10.0, 0.02)
    told = np.clip(110.0 * np.sin(np.outer(t, 1.0 + 0.1 * np.arange(len(ranges)))), -100.0, 100.0)
    names = ",".join(["t", *(f"j{k}_pos" for k in range(len(ranges))), *(f"j{k}_cmd" for k in range(len(ranges)))])
    table = np.column_stack([t, told * np.array(ranges) / 100.0, told])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=names, comments="")
    found = formats.guess_mapping(tmp_path / "log.csv")
    assert (found.channels["position"].unit, found.channels["command"].unit) == ("rad", "")
    assert any("percent of a range" in note for note in found.notes)


def test_one_joint_in_degrees_does_not_hide_that_the_others_are_in_radians_as_their_commands(tmp_path: Path) -> None:
    t = np.arange(0.0, 4.0, 0.02)
    swings = [0.8 * np.sin(t), 0.7 * np.sin(0.6 * t), 0.5 * np.cos(t)]
    table = np.column_stack([t, *swings[:2], np.degrees(swings[2]), *swings])
    names = "t,a_pos,b_pos,c_pos,a_cmd,b_cmd,c_cmd"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=names, comments="")
    channels = formats.guess_mapping(tmp_path / "log.csv").channels
    assert (channels["position"].unit, channels["command"].unit) == ("rad", "rad")


def test_efforts_that_are_whole_numbers_are_not_taken_for_newton_metres(tmp_path: Path) -> None:
    t = np.arange(0.0, 4.0, 0.02)
    for effort, unit in ((np.round(90.0 * np.cos(t)), ""), (90.0 * np.cos(t), "N m")):
        table = np.column_stack([t, np.sin(t), effort])
        np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,hip_position,hip_effort", comments="")
        assert formats.guess_mapping(tmp_path / "log.csv").channels["torque"].unit == unit


@pytest.mark.parametrize("name", ["idx", "n", "frame", "Row", "seq"])
def test_a_column_that_numbers_the_rows_is_no_channel(tmp_path: Path, name: str) -> None:
    rows = np.arange(200.0)
    for counted, channels in ((rows, {"position"}), (rows // 2, {"position", name.lower()})):
        table = np.column_stack([counted, 0.01 * rows, np.sin(0.01 * rows)])
        np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=f"{name},t,q1", comments="")
        found = {key.lower() for key in formats.guess_mapping(tmp_path / "log.csv").channels}
        assert found == channels - {"seq"}, "seq is a counter by its name"


def test_a_controllers_name_before_a_joint_of_the_model_is_no_part_of_it(tmp_path: Path) -> None:
    told = "/hand_controller/commands/thumb_abd,/arm_controller/commands/lift"
    head = f"t,{told},/joint_states/thumb_abd/position,/joint_states/lift/position"
    rows = [f"{0.01 * k},{0.1 * k},{0.2 * k},{0.1 * k},{0.2 * k}" for k in range(5)]
    (tmp_path / "log.csv").write_text("\n".join([head, *rows]))
    channels = formats.guess_mapping(tmp_path / "log.csv", joints=("lift", "thumb_abd")).channels
    assert {name: set(channel.labels) for name, channel in channels.items()} == {
        "command": {"thumb_abd", "lift"}, "position": {"thumb_abd", "lift"}
    }  # fmt: skip
