# SPDX-License-Identifier: Apache-2.0
"""The pose of a base is found under the names that people give it, and nothing else is taken for one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.formats import guess_mapping, read

_JOINTS = "time,q_hip,q_knee,q_des_hip,q_des_knee"


def _csv(path: Path, names: str) -> Path:
    header = f"{_JOINTS},{names}".split(",")
    rng = np.random.default_rng(0)
    rows = rng.normal(0.0, 0.1, (50, len(header)))
    rows[:, 0] = np.arange(50) * 0.01
    for i, name in enumerate(header):
        rows[:, i] += 0.99 if name.endswith("w") else 0.0
    path.write_text(",".join(header) + "\n" + "".join(",".join(f"{v:.6f}" for v in row) + "\n" for row in rows))
    return path


@pytest.mark.parametrize(
    "names",
    [
        "base_x,base_y,base_z,base_qw,base_qx,base_qy,base_qz",
        "base_pos_x,base_pos_y,base_pos_z,base_quat_w,base_quat_x,base_quat_y,base_quat_z",
        "mocap.position.x,mocap.position.y,mocap.position.z,mocap.orientation.x,mocap.orientation.y,mocap.orientation.z,"
        "mocap.orientation.w",
        "trunk_x,trunk_y,trunk_z,trunk_roll,trunk_pitch,trunk_yaw",
        "x,y,z,qw,qx,qy,qz",
        "base_pos_0,base_pos_1,base_pos_2,base_rpy_0,base_rpy_1,base_rpy_2",
        "mocap_px,mocap_py,mocap_pz,mocap_qw,mocap_qx,mocap_qy,mocap_qz",
        "vicon_tx,vicon_ty,vicon_tz,vicon_qx,vicon_qy,vicon_qz,vicon_qw",
        "base_pos_x,base_pos_y,base_pos_z,base_ori_w,base_ori_x,base_ori_y,base_ori_z",
        "pos_base_x,pos_base_y,pos_base_z,q_base_w,q_base_x,q_base_y,q_base_z",
        "opti_x,opti_y,opti_z,opti_qw,opti_qx,opti_qy,opti_qz",
        "base_pos_x,base_pos_y,base_pos_z,base_rpy_r,base_rpy_p,base_rpy_y",
    ],
)
def test_a_pose_is_found_by_any_usual_names(tmp_path: Path, names: str) -> None:
    path = _csv(tmp_path / "log.csv", names)
    (recording,) = read(path)
    assert set(recording.channels) == {"command", "position", "base_position", "base_orientation"}
    assert recording.channel("base_position").labels == ("x", "y", "z")
    assert recording.channel("base_position").unit == "m"
    orientation = recording.channel("base_orientation")
    if orientation.labels == ("w", "x", "y", "z"):
        assert orientation.column("w").mean() > 0.9
    else:
        assert (orientation.labels, orientation.unit) == (("roll", "pitch", "yaw"), "rad")


def test_a_place_without_an_orientation_is_named_as_no_pose(tmp_path: Path) -> None:
    (recording,) = read(
        _csv(tmp_path / "log.csv", "mocap_x,mocap_y,mocap_z,imu_quat_w,imu_quat_x,imu_quat_y,imu_quat_z")
    )
    assert "base_position" not in recording.channels
    proposed = guess_mapping(tmp_path / "log.csv")
    assert any("mocap: x, y and z, but no orientation" in note for note in proposed.notes)


def test_lists_tell_by_their_numbers_whether_the_real_part_stands_last(tmp_path: Path) -> None:
    time = np.arange(0.0, 1.0, 0.01)[:, None]
    arrays = {"q": 0.1 * time * [1, 2], "q_des": 0.1 * time * [1, 2], "base_pos": time * [1.0, 0.0, 0.1]}
    last = np.hstack([0.1 * time, 0.0 * time, 0.0 * time, np.sqrt(1.0 - 0.01 * time**2)])
    for name, quaternion in (("last", last), ("first", np.roll(last, 1, axis=1))):
        np.savez(tmp_path / f"{name}.npz", t=time[:, 0], base_quat=quaternion, q=arrays["q"], q_des=arrays["q_des"],
                 base_pos=arrays["base_pos"])  # fmt: skip
        (recording,) = read(tmp_path / f"{name}.npz")
        np.testing.assert_allclose(recording.channel("base_orientation").column("x"), 0.1 * time[:, 0])


@pytest.mark.parametrize(
    "names", ["imu_qw,imu_qx,imu_qy,imu_qz", "ee_x,ee_y,ee_z,ee_qw,ee_qx,ee_qy,ee_qz", "base_x,base_y"]
)
def test_what_is_no_whole_pose_of_the_base_stays_what_it_was(tmp_path: Path, names: str) -> None:
    (recording,) = read(_csv(tmp_path / "log.csv", names))
    assert not recording.has("base_position")


def test_motion_capture_is_believed_before_odometry(tmp_path: Path) -> None:
    both = ",".join(
        f"{who}_{part}" for who in ("odom_pose", "mocap_pose") for part in ("x", "y", "z", "qw", "qx", "qy", "qz")
    )
    path = _csv(tmp_path / "log.csv", both)
    (recording,) = read(path)
    captured = np.loadtxt(path, delimiter=",", skiprows=1)[:, both.split(",").index("mocap_pose_x") + 5]
    np.testing.assert_allclose(recording.channel("base_position").column("x"), captured)


def test_a_file_of_joint_commands_commands(tmp_path: Path) -> None:
    for name, value in (("joint_states", 0.1), ("joint_commands", 0.2)):
        rows = "".join(f"{0.01 * k:g},{value},{value}\n" for k in range(20))
        (tmp_path / f"{name}.csv").write_text("time,position_hip,position_knee\n" + rows)
    (recording,) = read(tmp_path)
    assert recording.channel("command").column("hip")[0] == 0.2
    assert recording.channel("position").column("hip")[0] == 0.1


def test_lists_of_an_inertial_unit_have_the_labels_of_its_axes(tmp_path: Path) -> None:
    time = np.arange(0.0, 1.0, 0.01)[:, None]
    quaternion = np.hstack([0.1 * time, 0.0 * time, 0.0 * time, np.sqrt(1.0 - 0.01 * time**2)])
    np.savez(tmp_path / "log.npz", t=time[:, 0], q=0.1 * time * [1, 2, 3], q_des=0.1 * time * [1, 2, 3],
             imu_gyro=0.1 * time * [1, 0, 2], imu_quat=quaternion)  # fmt: skip
    (recording,) = read(tmp_path / "log.npz")
    assert recording.channel("imu_gyro").labels == ("x", "y", "z")
    assert recording.channel("imu_quat").labels == ("x", "y", "z", "w")


def test_lists_of_a_base_beside_lists_of_joints_are_its_pose_and_its_speeds(tmp_path: Path) -> None:
    rng, time = np.random.default_rng(0), 0.01 * np.arange(50)
    lists = {"joint_pos": 8, "joint_vel": 8, "joint_targets": 8, "root_quat": 4, "root_ang_vel": 3, "root_pos": 3}
    values = {name: rng.normal(0.0, 0.1, (50, width)) for name, width in lists.items()}
    values["root_quat"] = np.tile([1.0, 0.0, 0.0, 0.0], (50, 1))
    np.savez(tmp_path / "log.npz", allow_pickle=False, time=time, **values)
    (recording,) = read(tmp_path / "log.npz")
    widths = {name: len(c.labels) for name, c in recording.channels.items()}
    assert (widths["command"], widths["position"], widths["velocity"]) == (8, 8, 8)
    np.testing.assert_array_equal(recording.channel("base_position").values, values["root_pos"])
    assert recording.channel("root_ang_vel").labels == ("x", "y", "z")
