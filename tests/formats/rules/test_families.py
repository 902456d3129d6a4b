# SPDX-License-Identifier: Apache-2.0
"""No joint is lost for a word in its name that means something else elsewhere: a base, an axis, a speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup import formats
from trueup.formats import ChannelMap
from trueup.model_files.joint_names import joint_names

NAMES = (
    "base_yaw", "hip_roll", "ankle_pitch", "wrist_x", "base_x", "left_wheel", "gripper_speed", "neck_yaw", "torso_pitch",
)  # fmt: skip


def guess(folder: Path, columns: list[str], known: tuple[str, ...] = (), still: str = "nothing") -> ChannelMap:
    """What is guessed of a log with these columns; those whose name holds `still` are zero."""
    time = np.arange(200) / 100.0
    values = [np.sin(time + k) * (still not in name) for k, name in enumerate(columns)]
    head = ",".join(["time", *columns])
    np.savetxt(folder / "log.csv", np.column_stack([time, *values]), delimiter=",", header=head, comments="")
    return formats.guess_mapping(folder / "log.csv", known)


@pytest.mark.parametrize("known", [(), NAMES], ids=["no model", "model"])
@pytest.mark.parametrize(
    "families",
    [
        {"position": "q_{}", "velocity": "qd_{}", "torque": "tau_{}"},
        {"position": "q.{}", "velocity": "dq.{}", "torque": "tau.{}"},
        {"position": "{}_pos", "velocity": "{}_vel", "torque": "{}_torque"},
        {"position": "pos_{}", "command": "cmd_{}"},
        {"position": "{}_position", "command": "{}_command"},
        {"position": "q_{}", "command": "q_des_{}", "velocity": "q_dot_{}"},
        {"position": "motor_pos_{}", "current": "motor_current_{}"},
        {"position": "{}_joint_pos", "command": "{}_joint_cmd"},
    ],
)
def test_every_joint_of_a_family_is_found(tmp_path: Path, families: dict[str, str], known: tuple[str, ...]) -> None:
    columns = [pattern.format(name) for pattern in families.values() for name in NAMES]
    found = guess(tmp_path, columns, known).channels
    part = next((f"{word}_" for word in ("motor",) if word in families["position"]), "")
    more = "_joint" if "_joint" in families["position"] else ""
    names = NAMES if known else tuple(part + name + more for name in NAMES)
    assert {kind: found[kind].labels for kind in families} == dict.fromkeys(families, names)
    assert set(found) == set(families)


BASE = ("base_x", "base_y", "base_yaw")
ROVER = [f"{kind}_{name}" for kind in ("q", "qd", "tau") for name in (*BASE, "elbow")]


def test_a_base_of_several_numbers_is_joints_where_motors_drive_it_or_the_model_says_so(tmp_path: Path) -> None:
    assert guess(tmp_path, ROVER).channels["position"].labels == (*BASE, "elbow")
    free = guess(tmp_path, ROVER, still="tau_base")
    assert free.channels["position"].labels == ("elbow",)
    assert any("q_base_x" in note and "pose of a base" in note for note in free.notes), "what is put aside is named"
    assert guess(tmp_path, ROVER, BASE, still="tau_base").channels["position"].labels == (*BASE, "elbow")


def test_a_joint_of_the_model_that_is_called_a_motor_is_a_joint(tmp_path: Path) -> None:
    columns = ["cmd_knee", "cmd_ankle_motor", "pos_knee", "pos_ankle", "pos_ankle_motor"]
    channels = guess(tmp_path, columns, ("knee", "ankle", "ankle_motor")).channels
    assert channels["command"].labels == ("knee", "ankle_motor")
    assert channels["position"].labels == ("knee", "ankle", "ankle_motor")


def test_a_joint_of_the_model_that_is_called_act_is_no_actual_value(tmp_path: Path) -> None:
    columns = ["L_act_cmd_mm", "R_act_cmd_mm", "L_act_pos_mm", "R_act_pos_mm"]
    channels = guess(tmp_path, columns, ("L_act", "R_act", "ankle")).channels
    assert channels["command"].labels == channels["position"].labels == ("L_act", "R_act")
    assert guess(tmp_path, columns).channels["position"].labels == ("L", "R")


def test_the_joints_of_a_model_are_read_from_its_text(tmp_path: Path) -> None:
    (tmp_path / "part.xml").write_text('<mujocoinclude><joint name="elbow"/></mujocoinclude>')
    (tmp_path / "arm.xml").write_text(
        '<mujoco><worldbody><body><joint name="base_yaw"/><include file="part.xml"/></body></worldbody></mujoco>'
    )
    (tmp_path / "arm.urdf").write_text(
        '<robot name="a"><joint name="base_yaw" type="revolute"/><joint name="tool" type="fixed"/></robot>'
    )
    assert joint_names(tmp_path / "arm.xml") == ("base_yaw", "elbow")
    assert joint_names(tmp_path / "arm.urdf") == ("base_yaw",)
    assert joint_names(tmp_path / "car.toml") is None
    assert joint_names(tmp_path / "arm.json") == ()


def test_act_behind_the_name_of_a_joint_of_the_model_is_its_actual_value(tmp_path: Path) -> None:
    columns = ["rail_cmd_mm", "rail_act_mm", "elbow_cmd_deg", "elbow_act_deg"]
    channels = guess(tmp_path, columns, ("rail", "elbow")).channels
    assert list(channels["position"].columns) == columns[1::2]
    assert channels["command"].labels == channels["position"].labels == ("rail", "elbow")


def test_a_command_of_a_joint_called_base_is_not_said_to_be_the_pose_of_a_base(tmp_path: Path) -> None:
    columns = ["q_des_j1_base", "q_des_elbow", "q_j1_base", "q_elbow"]
    found = guess(tmp_path, columns, ("j1_base", "elbow"))
    assert found.channels["command"].labels == ("j1_base", "elbow")
    assert not any("pose of a base" in note for note in found.notes)


def test_what_a_base_below_a_models_joints_does_makes_no_vehicle_of_the_log(tmp_path: Path) -> None:
    """The place of a rover under a head became the position of pan and tilt, and their commands none."""
    columns = [f"{joint}_{kind}_deg" for kind in ("goal", "pos") for joint in ("pan", "tilt")]
    found = guess(tmp_path, [*columns, "odom_x", "odom_y", "odom_yaw"], ("base_x", "pan", "tilt"))
    assert found.channels["command"].columns == tuple(columns[:2])
    assert found.channels["position"].columns == tuple(columns[2:])


def test_a_joint_that_nothing_commands_does_not_hide_the_positions_of_those_that_are(tmp_path: Path) -> None:
    columns = ["trolley_x_cmd", "trolley_x", "hoist_z_cmd", "hoist_z", "sway_deg"]
    found = guess(tmp_path, columns, ("trolley_x", "hoist_z", "sway")).channels
    assert dict(zip(found["position"].labels, found["position"].columns, strict=True)) == {
        "trolley_x": "trolley_x", "hoist_z": "hoist_z", "sway": "sway_deg",
    }  # fmt: skip
