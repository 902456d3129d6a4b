# SPDX-License-Identifier: Apache-2.0
"""MATLAB's and HDF5 files: arrays below nested names are signals, each by the clock beside it, each run by itself."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from trueup import formats
from trueup.errors import FormatError, MappingError, MissingExtraError
from trueup.formats.guarded import guarded
from trueup.recording import Recording

Nested = Mapping[str, Any]
T = np.arange(60) / 100.0
Q = np.stack([np.sin(T), np.cos(2.0 * T), 0.3 * np.sin(3.0 * T)], axis=1)
TOLD = np.roll(Q, -2, axis=0)


def write_mat(path: Path, data: Nested) -> Path:
    savemat(path.with_suffix(".mat"), dict(data))
    return path.with_suffix(".mat")


def write_h5(path: Path, data: Nested) -> Path:
    def fill(group: Any, part: Nested) -> None:
        for name, value in part.items():
            if isinstance(value, Mapping):
                fill(group.create_group(name), value)
            else:
                group[name] = value

    with h5py.File(path.with_suffix(".h5"), "w") as file:
        fill(file, data)
    return path.with_suffix(".h5")


BOTH = pytest.mark.parametrize("write", [write_mat, write_h5])
Write = Callable[[Path, Nested], Path]


def same(recording: Recording) -> None:
    position, command = recording.channel("position"), recording.channel("command")
    assert np.allclose(position.values, Q[: len(position.time)])
    assert np.allclose(command.at(position.time, hold=True), TOLD, atol=1e-12)


@BOTH
@pytest.mark.parametrize(
    "data",
    [
        {"t": T, "q": Q, "q_des": TOLD},
        {"t": T[None], "q": Q.T, "q_des": TOLD.T},
        {"log": {"time": T, "q_meas": Q, "q_ref": TOLD}},
        {"q_meas": {"time": T, "signals": {"values": Q}}, "q_ref": {"time": T, "signals": {"values": TOLD}}},
        {"arm": {"state": {"t": T, "position": Q}, "cmd": {"t": np.repeat(T, 1), "position": TOLD}}},
        {"data": {"timestamps": T, "obs": {"joint_pos": Q}, "actions": TOLD}},
    ],
)
def test_signals_are_found_wherever_they_stand(write: Write, data: Nested, tmp_path: Path) -> None:
    (recording,) = formats.read(write(tmp_path / "run", data))
    same(recording)


@BOTH
def test_groups_with_clocks_of_their_own_keep_them(write: Write, tmp_path: Path) -> None:
    data = {"state": {"time": T, "q": Q}, "cmd": {"time": T[::3] + 0.002, "q_des": TOLD[::3]}}
    (recording,) = formats.read(write(tmp_path / "run", data))
    assert np.allclose(recording.channel("position").time, T)
    command = recording.channel("command")
    assert np.allclose(command.time, T[::3] + 0.002)
    assert np.allclose(command.values, TOLD[::3])


@BOTH
def test_numbered_groups_that_hold_the_same_are_runs(write: Write, tmp_path: Path) -> None:
    one = {"t": T, "q": Q, "q_des": TOLD}
    found = formats.read(write(tmp_path / "log", {"kp": 12.0, "run1": one, "run2": one, "run3": one}))
    assert [r.name for r in found] == ["log_run1", "log_run2", "log_run3"]
    for recording in found:
        same(recording)
        assert recording.provenance["kp"] == "12.0"


def test_numbered_joints_beside_one_clock_are_no_runs(tmp_path: Path) -> None:
    joints = {f"joint{k + 1}": {"position": Q[:, k], "command": TOLD[:, k]} for k in range(3)}
    (recording,) = formats.read(write_mat(tmp_path / "run", {"t": T, **joints}))
    same(recording)


def test_a_list_of_structs_holds_runs_and_cells_of_text_name_joints(tmp_path: Path) -> None:
    names = np.array(["hip", "knee", "ankle"], dtype=object)
    one = {"t": T, "q": Q, "q_des": TOLD, "joints": names}
    first, second = formats.read(write_mat(tmp_path / "day", {"logs": [one, one]}))
    for recording in (first, second):
        same(recording)
        assert recording.channel("position").labels == ("hip", "knee", "ankle")


def test_units_and_names_that_hdf5_declares_are_kept_and_pictures_left_alone(tmp_path: Path) -> None:
    path = write_h5(tmp_path / "run", {"time": 1e3 * T, "q": np.degrees(Q), "q_des": np.degrees(TOLD)})
    with h5py.File(path, "a") as file:
        file["camera"] = np.zeros((60, 4, 5, 3), dtype=np.uint8)
        file["time"].attrs["units"] = "ms"
        for name in ("q", "q_des"):
            file[name].attrs["unit"] = "deg"
        file["q"].attrs["names"] = ["hip", "knee", "ankle"]
        file["elsewhere"] = h5py.ExternalLink("nothing.h5", "/q")
    (recording,) = formats.read(path)
    same(recording)
    assert recording.channel("command").labels == ("hip", "knee", "ankle")


def test_names_that_a_group_declares_are_those_of_its_joints(tmp_path: Path) -> None:
    path = write_h5(tmp_path / "log", {"robot": {"time": T, "joint_pos": Q, "joint_pos_target": TOLD}})
    with h5py.File(path, "a") as file:
        file["robot"].attrs["names"] = ["left", "right"]  # of cameras
        file["robot"].attrs["joint_names"] = ["hip", "knee", "ankle"]
    (recording,) = formats.read(path)
    assert recording.channel("position").labels == recording.channel("command").labels == ("hip", "knee", "ankle")


def test_rows_with_named_fields_and_data_frames_are_columns(tmp_path: Path) -> None:
    rows = np.zeros(60, dtype=[("t", "f8"), ("pos_hip", "f8"), ("cmd_hip", "f8")])
    rows["t"], rows["pos_hip"], rows["cmd_hip"] = T, Q[:, 0], TOLD[:, 0]
    frame = {"axis1": np.arange(60), "block0_items": np.array([b"t", b"pos_hip", b"cmd_hip"]),
             "block0_values": np.column_stack([T, Q[:, 0], TOLD[:, 0]])}  # fmt: skip
    for k, data in enumerate(({"log": rows}, {"frame": frame})):
        (recording,) = formats.read(write_h5(tmp_path / f"run{k}", data))
        assert np.allclose(recording.channel("position").values[:, 0], Q[:, 0])
        assert np.allclose(recording.channel("command").values[:, 0], TOLD[:, 0])


def test_a_matrix_alone_is_a_table_without_names(tmp_path: Path) -> None:
    columns = {"position": {"columns": ["column_2", "column_3", "column_4"], "unit": "rad"}}
    mapping = formats.ChannelMap.from_dict({"time": {"column": "column_1"}, "channels": columns})
    (recording,) = formats.read(write_mat(tmp_path / "run", {"log": np.column_stack([T, Q])}), mapping)
    assert np.array_equal(recording.channel("position").values, Q)


def newer(path: Path) -> Path:
    """As MATLAB 7.3 writes it: HDF5 behind 512 bytes of its own."""
    with h5py.File(path, "w", userblock_size=512) as file:
        log = file.create_group("log")
        log["t"], log["q"], log["q_des"] = T[None], Q.T, TOLD.T
        log["robot"] = np.array([[ord(c)] for c in "arm"], dtype=np.uint16)
        log["robot"].attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))
    return path


def test_files_of_matlab_7_3_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = newer(tmp_path / "run.mat")
    (recording,) = formats.read(path)
    same(recording)
    assert recording.provenance["robot"] == "arm"
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingExtraError, match=r"trueup\[hdf5\]"):
        formats.read(path)


@pytest.mark.parametrize(
    ("name", "value"), [("fps", 50), ("control_freq", 50.0), ("dt", 0.02), ("sample_period_ms", 20.0)]
)
def test_a_rate_that_the_file_says_stands_for_a_clock(name: str, value: float, tmp_path: Path) -> None:
    path = write_h5(tmp_path / "run", {"observations": {"qpos": Q}, "action": TOLD})
    with pytest.raises(MappingError, match="no time"):
        formats.read(path)
    with h5py.File(path, "a") as file:
        file.attrs[name] = value
        file.attrs["camera_fps"] = 30
    (recording,) = formats.read(path)
    assert np.allclose(recording.channel("position").time, np.arange(60) / 50.0)


def test_demonstrations_that_say_their_rate_in_json_hold_joints_apart_from_tool_and_gripper(tmp_path: Path) -> None:
    """The layout of robomimic: no clock, joints beside the tool's pose, its sines and cosines, and two fingers."""
    tool = np.stack([np.sin(T + k) for k in range(3)], axis=1)
    turn = np.tile([0.0, 0.0, 0.0, 1.0], (len(T), 1))
    joints = {"robot0_joint_pos": Q, "robot0_joint_pos_cos": np.cos(Q), "robot0_joint_pos_sin": np.sin(Q)}
    others = {"robot0_eef_pos": tool, "robot0_eef_quat": turn, "robot0_gripper_qpos": np.stack([T, -T], axis=1)}
    demo = {"obs": {**others, **joints}, "actions": TOLD}
    path = write_h5(tmp_path / "low_dim", {"data": {"demo_0": demo, "demo_1": demo}})
    with h5py.File(path, "a") as file:
        file["data"].attrs["env_args"] = '{"env_name": "Lift", "env_kwargs": {"control_freq": 50, "camera_fps": 30}}'
    for recording in formats.read(path):
        position = recording.channel("position")
        assert position.labels == ("gripper_1", "gripper_2", "joint_1", "joint_2", "joint_3")
        assert np.allclose(position.values[:, 2:], Q)
        assert np.allclose(position.time, T * 2.0)
        assert "base_position" not in recording.channels
        assert recording.channel("command").labels == ("joint_1", "joint_2", "joint_3")


def test_torques_told_in_several_ways_are_not_counted_on_and_stamps_of_all_kinds_are_one_clock(tmp_path: Path) -> None:
    """The layout of DROID: torques measured, computed and of the sample before; stamps in ms, and in s with nanoseconds."""
    ms = (1.69e12 + 1e3 * T).astype(np.int64)
    state = {
        "joint_positions": Q,
        "joint_velocities": Q,
        "cartesian_position": np.hstack([Q, Q]),
        "gripper_position": T,
    }
    told = {"joint_torques_computed": 2.0 * Q, "prev_joint_torques_computed": 3.0 * Q, "motor_torques_measured": Q}
    stamps = {"robot_timestamp_seconds": ms // 1000, "robot_timestamp_nanos": ms % 1000 * 1_000_000, "read_end": ms}
    stamps_of = {"robot_state": stamps, "cameras": {"123_read_end": ms}, "skip_action": np.zeros(len(T), bool)}
    observed = {"robot_state": {**state, **told}, "timestamp": stamps_of}
    asked = {"joint_position": TOLD, "cartesian_position": np.hstack([Q, Q]), "gripper_position": T}
    (recording,) = formats.read(write_h5(tmp_path / "trajectory", {"observation": observed, "action": asked}))
    same(recording)
    assert np.allclose(recording.channel("position").time - recording.channel("position").time[0], T, atol=1e-3)
    for name in ("position", "command", "velocity", "torque"):
        assert recording.channel(name).labels == ("joint_1", "joint_2", "joint_3")
    assert np.allclose(recording.channel("torque").values, Q)


def test_nanoseconds_beside_seconds_are_the_rest_of_these_in_nested_files_too(tmp_path: Path) -> None:
    ns = np.round(5e9 * T).astype(np.int64)
    data = {"state": {"stamp_secs": ns // 10**9, "stamp_nsecs": ns % 10**9, "q": Q, "q_des": TOLD}}
    (recording,) = formats.read(write_h5(tmp_path / "run", data))
    assert np.allclose(recording.channel("position").time, 5.0 * T)


def test_a_file_on_which_its_reader_crashes_costs_no_more_than_a_sentence(tmp_path: Path) -> None:
    """An array of a class that there is none of: scipy 1.17 ends the process that reads it, and that is not ours."""
    path = write_mat(tmp_path / "run", {"log": {"t": T, "q": Q, "q_des": TOLD}})
    damaged = bytearray(path.read_bytes())
    damaged[233] = 0xFF
    path.write_bytes(bytes(damaged))
    with contextlib.suppress(FormatError):
        formats.read(path)


def test_a_crash_of_a_reader_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "crashing.py").write_text(
        "import os, signal\ndef read(path):\n    os.kill(os.getpid(), signal.SIGSEGV)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "run.mat").write_bytes(b"")
    reader = SimpleNamespace(__module__="crashing", __name__="read")
    with pytest.raises(FormatError, match="its reader crashed, so it is damaged"):
        guarded(reader, tmp_path / "run.mat", "a MAT-file")  # type: ignore[arg-type]


def test_what_only_matlab_reads_is_said(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"variables are: note\. timetables"):
        formats.read(write_mat(tmp_path / "run", {"note": "a timetable was here"}))
    damaged: NDArray[np.uint8] = np.frombuffer(write_mat(tmp_path / "run", {"q": Q}).read_bytes(), np.uint8)
    (tmp_path / "cut.mat").write_bytes(damaged[:300].tobytes())
    with pytest.raises(FormatError, match="cannot be read as a MAT-file"):
        formats.read(tmp_path / "cut.mat")
