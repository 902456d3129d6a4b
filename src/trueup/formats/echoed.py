# SPDX-License-Identifier: Apache-2.0
"""What `ros2 topic echo --csv` prints: no names of columns; of joint states the joints' own names in each row."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from trueup.formats.table import Table
from trueup.samples import is_unit
from trueup.units import size_of

_PARTS = ("position", "velocity", "effort")
"""Of sensor_msgs/JointState, in its order; the last ones may be empty."""


_POSE = (*(f"pose.position.{c}" for c in "xyz"), *(f"pose.orientation.{c}" for c in "xyzw"))
_TWIST = (*(f"twist.linear.{c}" for c in "xyz"), *(f"twist.angular.{c}" for c in "xyz"))
_COVARIANCE, _OF_THREE = ("",) * 36, ("",) * 9
_MESSAGES = {
    ("header.frame_id", "child_frame_id"): {"odom": (*_POSE, *_COVARIANCE, *_TWIST, *_COVARIANCE)},
    ("header.frame_id",): {
        "pose": _POSE,
        "pose_with_covariance": (*_POSE, *_COVARIANCE),
        "stamped": _TWIST,
        "imu": (*(f"orientation.{c}" for c in "xyzw"), *_OF_THREE, *(f"angular_velocity.{c}" for c in "xyz"), *_OF_THREE,
                *(f"linear_acceleration.{c}" for c in "xyz"), *_OF_THREE),
        "drive": ("steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk"),
    },
}  # fmt: skip
"""Numbers of a message behind its stamp, by the frames that it names and by what they are called here; '' for others:
nav_msgs/Odometry, geometry_msgs/PoseStamped, PoseWithCovarianceStamped and TwistStamped, sensor_msgs/Imu,
ackermann_msgs/AckermannDriveStamped: no two of them are of one length.
"""


def with_names(table: Table) -> Table:
    """The table with names, where it has none and is seconds, nanoseconds, a frame and the numbers of a message; of joint
    states k names and k, 2 k or 3 k numbers.
    """
    places = {name: match for name in (*table.columns, *table.text) if (match := re.fullmatch(r"column_(\d+)", name))}
    if len(places) < len(table.columns) + len(table.text):
        return table
    order = sorted(places, key=lambda name: int(places[name][1]))
    numbers = [name for name in order if name in table.columns and table.columns[name].ndim == 1]
    words = [name for name in order if name in table.text]
    if len(numbers) < 3 or numbers[:2] != order[:2] or not _is_stamp(table, numbers[:2]):
        return table
    if (message := _of_message(table, numbers, words)) is not None:
        return message
    rest, frame = numbers[2:], 3
    names = [name for name in words if int(places[name][1]) > frame]
    joints = [table.text[name][0].strip() for name in names]
    fixed = all(len(set(table.text[name])) == 1 for name in names)
    follows = [int(places[name][1]) for name in (*names, *rest)] == list(
        range(frame + 1, frame + 1 + len(names) + len(rest))
    )
    if (
        not fixed
        or not follows
        or len(set(joints)) != len(joints)
        or len(rest) not in (len(joints) * k for k in (1, 2, 3))
    ):
        return table
    called = [f"{part}/{joint}" for part in _PARTS for joint in joints]
    named = dict(zip(numbers, ["stamp.sec", "stamp.nanosec", *called], strict=False))
    return replace(table, columns={named[name]: table.columns[name] for name in numbers}, text={})


def _of_message(table: Table, numbers: list[str], words: list[str]) -> Table | None:
    """The table of a message that is known by its length, frames and quaternion; None where it is none."""
    known = (message for frames, each in _MESSAGES.items() if len(frames) == len(words) for message in each.items())
    for whose, parts in known:
        if len(parts) != len(numbers) - 2 or numbers[2] != f"column_{3 + len(words)}":
            continue
        named = {name: f"{whose}.{part}" for name, part in zip(numbers[2:], parts, strict=True) if part}
        turn = [table.columns[name] for name, called in named.items() if ".orientation." in called]
        if turn and not is_unit(np.stack(turn, axis=1)):
            continue
        named = dict(zip(numbers[:2], ("stamp.sec", "stamp.nanosec"), strict=True)) | named
        return replace(table, columns={called: table.columns[name] for name, called in named.items()}, text={})
    return None


def _is_stamp(table: Table, names: list[str]) -> bool:
    """Whether two columns are seconds and the nanoseconds beside them."""
    seconds, rest = (table.columns[name] for name in names)
    whole = all(np.all(values == np.round(values)) for values in (seconds, rest))
    return whole and bool(np.all(np.diff(seconds) >= 0.0) and rest.min() >= 0.0 and rest.max() * size_of("ns") < 1.0)
