# SPDX-License-Identifier: Apache-2.0
"""Small sound files of every format, as robotics labs write them, made for the tests: the fixture `small_files`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from trueup import formats
from trueup.recording import Channel, Recording

JOINTS = ("hip", "knee")
RATE = 100.0
TYPES = get_typestore(Stores.LATEST)


@pytest.fixture(scope="session")
def small_files() -> SimpleNamespace:
    """The functions below, by name; test modules cannot import one another."""
    functions = (
        signals, recording, write_csv, write_lists, write_one_number_a_line, write_json, write_npz,
        write_mat, write_hdf5, write_foreign_parquet, write_own_parquet, joint_state, float_array, trajectory, message,
        header, write_bag, write_joint_bag,
    )  # fmt: skip
    return SimpleNamespace(**{function.__name__: function for function in functions})


def signals(samples: int = 40) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Time (T,) in s, commands and positions (T, 2) in rad."""
    time = np.arange(samples) / RATE
    command = np.stack([0.5 * np.sin(2 * np.pi * time), 0.3 * np.cos(2 * np.pi * time)], axis=1)
    return time, command, 0.9 * command + 0.01


def recording(samples: int = 40) -> Recording:
    """The signals as a recording."""
    time, command, position = signals(samples)
    channels = [Channel("command", JOINTS, "rad", time, command), Channel("position", JOINTS, "rad", time, position)]
    return Recording("small", {c.name: c for c in channels}, {"source": "a test"})


def write_csv(path: Path, separator: str = ",") -> Path:
    """Columns named cmd_<joint> and pos_<joint>."""
    time, command, position = signals()
    rows = np.column_stack([time, command, position])
    names = ["time", *(f"cmd_{j}" for j in JOINTS), *(f"pos_{j}" for j in JOINTS)]
    lines = [separator.join(names), *(separator.join(f"{x:.6f}" for x in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_lists(folder: Path) -> Path:
    """Commands and states in a file each, lists in quotes, microseconds, joints and events in files of their own."""
    folder.mkdir(parents=True, exist_ok=True)
    time, command, position = signals()
    for name, kind, values in (("control", "CONTROL", command), ("state_motor", "STATE", position)):
        lines = [f'{kind},{t * 1e6:.3f},"{list(map(float, v))}"' for t, v in zip(time, values, strict=True)]
        (folder / f"{name}.csv").write_text("\n".join(["type,timestamp,positions", *lines]) + "\n")
    (folder / "joint_list.txt").write_text("\n".join(JOINTS) + "\n")
    (folder / "event.csv").write_text("type,timestamp,event\nEVENT,0,START\nEVENT,390000,STOP\n")
    return folder


def write_one_number_a_line(folder: Path) -> Path:
    """Files with one number a line, two lines a sample, and the time in a file of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    time, _, position = signals()
    np.savetxt(folder / "run_positions.txt", position.ravel(), fmt="%.6f")
    np.savetxt(folder / "run_velocity.txt", np.gradient(position, time, axis=0).ravel(), fmt="%.6f")
    np.savetxt(folder / "run_time.txt", time, fmt="%.6f")
    return folder


def write_json(path: Path) -> Path:
    """A list of entries beside facts about the run; one object a line if the name ends in .jsonl."""
    time, command, position = signals()
    entries = [
        {"timestamp": float(t), "goal_position": float(c[0]), "position": float(p[0]), "torque_enable": True}
        for t, c, p in zip(time, command, position, strict=True)
    ]
    if path.suffix == ".jsonl":
        path.write_text("\n".join(json.dumps(entry) for entry in entries) + "\n")
    else:
        path.write_text(json.dumps({"mass": 0.49, "motor": "xl330", "entries": entries}))
    return path


def write_npz(path: Path) -> Path:
    """Arrays by name, with the joints' names."""
    time, command, position = signals()
    np.savez(path, time=time, q=position, q_des=command.T, joint_names=np.array(JOINTS))
    return path


def write_mat(path: Path) -> Path:
    """A struct with its signals beside their time, as MATLAB keeps it."""
    time, command, position = signals()
    savemat(
        path, {"log": {"t": time, "q": position, "q_des": command.T, "joint_names": np.array(JOINTS, dtype=object)}}
    )
    return path


def write_hdf5(path: Path) -> Path:
    """Groups with clocks of their own, as a recorder of demonstrations keeps them."""
    time, command, position = signals()
    with h5py.File(path, "w") as file:
        for name, values in (("state", position), ("command", command)):
            group = file.create_group(name)
            group["timestamp"] = time
            group["position"] = values
            group["position"].attrs["names"] = list(JOINTS)
    return path


def write_foreign_parquet(path: Path) -> Path:
    """A table as pandas or a data set writes it, with lists in its cells."""
    time, command, position = signals()
    columns = {"timestamp": time, "action": command.tolist(), "observation.state": position.tolist()}
    pq.write_table(pa.table(columns), path)
    return path


def write_own_parquet(path: Path) -> Path:
    """The recording in trueup's own format."""
    formats.write(recording(), path)
    return path


def message(kind: str, **fields: Any) -> Any:
    """A message of a type such as sensor_msgs/msg/JointState."""
    return TYPES.types[kind](**fields)


def header(time: float) -> Any:
    """A header with this stamp [s]."""
    nanoseconds = round(time * 1e9)
    stamp = message("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id="")


def joint_state(time: float, names: Sequence[str], position: Sequence[float]) -> Any:
    """A JointState with positions only, as many drivers send it."""
    empty = np.zeros(0)
    values = np.array(position, dtype=np.float64)
    return message(
        "sensor_msgs/msg/JointState",
        header=header(time), name=list(names), position=values, velocity=empty, effort=empty,
    )  # fmt: skip


def float_array(values: Sequence[float]) -> Any:
    """A Float64MultiArray, as ros2_control's forward controllers take it."""
    layout = message("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    return message("std_msgs/msg/Float64MultiArray", layout=layout, data=np.array(values, dtype=np.float64))


def trajectory(time: float, names: Sequence[str], points: Sequence[tuple[float, Sequence[float]]]) -> Any:
    """A JointTrajectory with (time from start [s], positions) as its points."""
    empty = np.zeros(0)
    made = [
        message(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=np.array(position, dtype=np.float64), velocities=empty, accelerations=empty, effort=empty,
            time_from_start=message("builtin_interfaces/msg/Duration", sec=int(later), nanosec=round(later % 1 * 1e9)),
        )
        for later, position in points
    ]  # fmt: skip
    return message("trajectory_msgs/msg/JointTrajectory", header=header(time), joint_names=list(names), points=made)


def write_bag(path: Path, messages: Sequence[tuple[str, str, float, Any]], *, mcap: bool = False) -> Path:
    """A bag of (topic, type, time of reception [s], message)."""
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, kind, received, content in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            writer.write(connections[topic], round(received * 1e9), TYPES.serialize_cdr(content, kind))
    return path


def write_joint_bag(path: Path, *, mcap: bool = False, start: float = 1.7e9) -> Path:
    """Commands on one topic; states on another, whose messages change the order of the joints."""
    time, command, position = signals()
    messages = []
    for i, t in enumerate(start + time):
        order = [0, 1] if i % 2 else [1, 0]
        state = joint_state(t, [JOINTS[k] for k in order], position[i, order].tolist())
        commands = float_array(command[i].tolist())
        messages.append(("/position_controller/commands", "std_msgs/msg/Float64MultiArray", t, commands))
        messages.append(("/joint_states", "sensor_msgs/msg/JointState", t + 0.002, state))
    return write_bag(path, messages, mcap=mcap)
