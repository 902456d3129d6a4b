# SPDX-License-Identifier: Apache-2.0
"""Takes ROS messages apart into named numbers, whatever their type."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trueup.units import size_of

_NAME_FIELDS = ("name", "names", "joint_names", "joint_name")
_BESIDE = ("header", "time_from_start", "layout")
_REPEATED = ("error", "output")  # of a controller's state: the difference of the rest, and what it told the drives


@dataclass(frozen=True)
class Rows:
    """The samples in one message."""

    samples: tuple[tuple[float | None, Mapping[str, float]], ...]
    """Time in s (None where the message has no header) and the numbers by name."""
    joints: tuple[str, ...]
    """Names that the message gives to the entries of its arrays."""


def rows_of(message: Any, kind: str) -> Rows:
    """The sample in a message of type `kind`, if it has numbers."""
    joints = joints_of(message)
    stamp = stamp_of(message)
    if kind.endswith("/DynamicJointState"):
        values = dict(_interfaces(message, joints))
        return Rows(((stamp, values),) if values else (), joints)
    values = dict(_numbers(message, "", joints, 0, _REPEATED if kind.endswith("ControllerState") else ()))
    return Rows(((stamp, values),) if values else (), joints)


def joints_of(message: Any) -> tuple[str, ...]:
    """Names that a message gives to the entries of its arrays."""
    for name in _NAME_FIELDS:
        value = getattr(message, name, None)
        if isinstance(value, list) and value and all(isinstance(entry, str) for entry in value):
            return tuple(value)
    return ()


def stamp_of(message: Any) -> float | None:
    """The header's time in s; None for no header and for one that was left at zero."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return seconds_of(stamp) or None if hasattr(stamp, "sec") else None


def seconds_of(stamp: Any) -> float:
    """A ROS time or duration in s."""
    return float(stamp.sec) + size_of("ns") * float(stamp.nanosec)


def _interfaces(message: Any, joints: Sequence[str]) -> Iterator[tuple[str, float]]:
    """What each joint's interfaces hold, as a JointState would have it: "position/elbow"."""
    for joint, of_joint in zip(joints, message.interface_values, strict=False):
        for interface, value in zip(of_joint.interface_names, of_joint.values, strict=False):
            yield f"{interface}/{joint}", float(value)


def _numbers(
    value: Any, name: str, joints: Sequence[str], depth: int, without: Sequence[str] = ()
) -> Iterator[tuple[str, float]]:
    """Every number below `value`, with the path of field names that leads to it; not the fields `without`."""
    deepest = 6
    longest = 256  # arrays beyond this are images, scans or maps
    if isinstance(value, (bool, int, float, np.number)):
        yield name, float(value)
    elif isinstance(value, np.ndarray):
        if value.dtype.kind in "biuf" and 0 < value.size <= longest:
            yield from _entries(name, value.ravel().tolist(), joints)
    elif dataclasses.is_dataclass(value) and depth < deepest:
        for item in dataclasses.fields(value):
            constant = str(item.type).startswith("ClassVar")  # of the message's type, the same in every message
            if constant or item.name in (*_BESIDE, *without) or item.name.startswith("__"):
                continue
            path = f"{name}.{item.name}" if name else item.name
            yield from _numbers(getattr(value, item.name), path, joints, depth + 1)
    elif isinstance(value, list) and 0 < len(value) <= longest and depth < deepest:
        named = joints if len(joints) == len(value) else [str(i) for i in range(len(value))]
        for label, entry in zip(named, value, strict=True):
            yield from _numbers(entry, f"{name}/{label}", joints, depth + 1)


def _entries(name: str, values: Sequence[float], joints: Sequence[str]) -> Iterator[tuple[str, float]]:
    named = joints if len(joints) == len(values) else [str(i) for i in range(len(values))]
    for label, value in zip(named, values, strict=True):
        yield f"{name}/{label}", float(value)
