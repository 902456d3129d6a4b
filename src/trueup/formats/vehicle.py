# SPDX-License-Identifier: Apache-2.0
"""Logs of vehicles: where throttle or speed and steering are commanded, a tracked pose is position and heading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from trueup.formats.mapping import ChannelColumns
from trueup.formats.words import words

_DRIVES = {"throttle", "speed"}
_HEADINGS = ("heading", "yaw", "theta", "psi", "orientation")
_TURNS = {"w", "wz", "wimu", "yawrate", "yawvel", "yawspeed", "gyroz", "omegaz", "angularvelocityz", "turnrate"}
_NO_POSE = {"acc", "accel", "acceleration", "imu", "gyro", "mag", "velocity", "vel", "force", "torque", "command"}


def as_vehicle(channels: Mapping[str, ChannelColumns]) -> tuple[dict[str, ChannelColumns], list[str]]:
    """The channels with a vehicle's names (position x, y; heading; speed; yaw_rate), and notes; unchanged for others."""
    command = channels.get("command") or channels.get("command_sent")
    if command is None or "steering" not in command.labels or not _DRIVES & set(command.labels):
        return dict(channels), []
    found = dict(channels)
    notes = []
    for name, entry in channels.items():
        if _NO_POSE & set(words(name)) or len(entry.columns) != len(entry.labels):
            continue
        if {"x", "y"} <= set(entry.labels):
            found.pop(name)
            found["position"] = _part(entry, ("x", "y"), ("x", "y"), "m")
            notes.append(f"position: {name} x and y taken as m")
            angle = next((label for label in _HEADINGS if label in entry.labels), None)
            if angle is not None:
                found["heading"] = _part(entry, (angle,), ("heading",), "rad")
                notes.append(f"heading: {name} {angle} taken as rad, growing to the left")
            break
    for name in ("velocity", "speed"):
        if name in found and "speed" not in found and len(found[name].columns) == len(found[name].labels) == 1:
            _rename(found, name, found[name].columns[0], "speed", "m/s", notes)
    for name, entry in list(found.items()):
        for column in entry.columns if len(entry.columns) == len(entry.labels) else ():
            if "".join(words(column)) in _TURNS and "yaw_rate" not in found:
                _rename(found, name, column, "yaw_rate", "rad/s", notes)
    return found, notes


def _rename(found: dict[str, ChannelColumns], name: str, column: str, to: str, unit: str, notes: list[str]) -> None:
    """One column of a channel gets a channel of its own, with a vehicle's name for it."""
    entry = found.pop(name)
    rest = tuple(label for label, other in zip(entry.labels, entry.columns, strict=True) if other != column)
    if rest:
        found[name] = _part(entry, rest, rest, "")
    found[to] = _part(entry, (entry.labels[entry.columns.index(column)],), (to,), unit)
    if not entry.unit:
        notes.append(f"{to}: column {column} taken as {unit}")


def _part(entry: ChannelColumns, labels: tuple[str, ...], new: tuple[str, ...], unit: str) -> ChannelColumns:
    columns = tuple(entry.columns[entry.labels.index(label)] for label in labels)
    usual = entry.unit or unit
    return replace(entry, columns=columns, labels=new, unit=usual)
