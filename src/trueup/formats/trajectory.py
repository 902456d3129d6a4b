# SPDX-License-Identifier: Apache-2.0
"""Planned joint trajectories to files that robots take: CSV, JSON, and a ROS JointTrajectory message in a bag."""

from __future__ import annotations

import csv
import json
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trueup.errors import MissingExtraError, OutputError
from trueup.formats.aside import write_aside, written_aside
from trueup.formats.planned import RATE
from trueup.recording import Recording
from trueup.units import size_of

TOPIC = "/joint_trajectory"
_PARTS = (("pos", "position"), ("vel", "velocity"), ("acc", "acceleration"))


def write_csv(trajectory: Recording, path: Path) -> None:
    """Columns time, pos_JOINT, vel_JOINT, acc_JOINT in SI units. Raises OutputError; what was there is untouched."""
    joints = trajectory.channel("position").labels
    columns = [trajectory.channel(name).values for _, name in _PARTS]
    time = trajectory.channel("position").time
    with written_aside(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", *(f"{short}_{joint}" for short, _ in _PARTS for joint in joints)])
        for row in np.column_stack([time, *columns]):
            writer.writerow([f"{value:.9g}" for value in row])


def write_json(trajectory: Recording, path: Path, about: Mapping[str, Any]) -> None:
    """`about` (plain numbers and texts), then joints, and points with time, position, velocity, acceleration.

    Raises OutputError; what was there is untouched.
    """
    kept = _samples(trajectory)
    position = trajectory.channel("position")
    points = {name: trajectory.channel(name).values[kept].round(9).tolist() for _, name in _PARTS}
    content = {**about, "joints": list(position.labels), "time": position.time[kept].round(9).tolist(), **points}
    write_aside(json.dumps(content, allow_nan=False) + "\n", path)


def write_bag(trajectory: Recording, folder: Path) -> None:
    """A rosbag2 folder (sqlite3) with one trajectory_msgs/JointTrajectory on /joint_trajectory, at most 100 points a second.

    An older bag there is replaced when the new one is complete. Raises MissingExtraError without the package rosbags,
    OutputError where the disk does not take it.
    """
    try:
        from rosbags.rosbag2 import Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingExtraError("writing ROS bags", "rosbags", "ros") from None
    store = get_typestore(Stores.LATEST)
    aside: Path | None = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        with Writer(aside / folder.name, version=9) as writer:
            kind = "trajectory_msgs/msg/JointTrajectory"
            connection = writer.add_connection(TOPIC, kind, typestore=store)
            writer.write(connection, 0, store.serialize_cdr(_message(trajectory, store.types), kind))
        if folder.exists():
            shutil.rmtree(folder)
        (aside / folder.name).rename(folder)
    except OSError as error:
        raise OutputError(f"cannot write the bag '{folder}': {error.strerror or error}") from error
    finally:
        if aside is not None:
            shutil.rmtree(aside, ignore_errors=True)


def _message(trajectory: Recording, types: Mapping[str, Any]) -> Any:
    position = trajectory.channel("position")
    point, duration = types["trajectory_msgs/msg/JointTrajectoryPoint"], types["builtin_interfaces/msg/Duration"]
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "")
    values = [trajectory.channel(name).values for _, name in _PARTS]
    points = []
    for k in _samples(trajectory):
        seconds = float(position.time[k] - position.time[0])
        whole = int(seconds)
        after = duration(whole, round((seconds - whole) / size_of("ns")))
        points.append(point(*(np.ascontiguousarray(v[k]) for v in values), np.zeros(0), after))
    return types["trajectory_msgs/msg/JointTrajectory"](header, list(position.labels), points)


def _samples(trajectory: Recording) -> list[int]:
    """Samples for a message: evenly at 100 Hz at most, the last one included."""
    time = trajectory.channel("position").time
    rate = (len(time) - 1) / (time[-1] - time[0])
    step = max(1, round(rate / RATE))
    return sorted({*range(0, len(time), step), len(time) - 1})
