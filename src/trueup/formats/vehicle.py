# SPDX-License-Identifier: Apache-2.0
"""Logs of vehicles: where throttle or speed and steering are commanded, a tracked pose is position and heading."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from trueup.formats.mapping import ChannelColumns
from trueup.formats.words import words

_DRIVES = {"throttle", "speed"}
_STEERS = {"steer", "steering", "delta"}
_SPEEDS = {"v", "vx", "vel", "velocity", "speed"}
_WHOSE = {  # words beside a signal's own that do not change what it is
    "pos", "position", "pose", "vicon", "mocap", "optitrack", "odom", "gps", "car", "vehicle", "robot", "world", "map",
    "base", "link", "center", "centre", "cg", "cog", "rear", "axle", "wheel", "encoder", "measured", "meas", "long",
    "longitudinal", "motor", "state", "pwm", "actuation", "control", "ctrl", "sent", "norm", "normalized",
    "cmd", "command", "commanded", "u", "input", "desired", "target", "ref", "reference", "setpoint", "goal",
    "angle", "ratio", "value",
}  # fmt: skip
_UNITS = {"m": ("m", 1.0), "mm": ("mm", 1.0), "cm": ("m", 0.01), "rad": ("rad", 1.0), "deg": ("deg", 1.0),
          "degrees": ("deg", 1.0), "mps": ("m/s", 1.0), "percent": ("", 0.01), "pct": ("", 0.01)}  # fmt: skip
_TO_SI = {"deg": math.pi / 180.0, "mm": 1e-3}
_THROTTLES = {"throttle", "gas", "accelerator", "esc", "drive"}
_COMMANDED = frozenset(
    {"cmd", "command", "commanded", "desired", "target", "ref", "reference", "setpoint", "u", "goal", "input"}
)
_HEADINGS = ("heading", "yaw", "theta", "psi", "orientation")
_QUATERNION = {"qx", "qy", "qz", "qw"}
_TURNS = {"w", "wz", "wimu", "yawrate", "yawvel", "yawspeed", "gyroz", "omegaz", "angularvelocityz", "turnrate"}
_NO_POSE = {"acc", "accel", "acceleration", "imu", "gyro", "mag", "velocity", "vel", "force", "torque", "command"}


def as_vehicle(channels: Mapping[str, ChannelColumns]) -> tuple[dict[str, ChannelColumns], list[str]]:
    """The channels with a vehicle's names (position x, y; heading; speed; yaw_rate), and notes; unchanged for others."""
    channels, notes = _gathered(channels)
    command = channels.get("command") or channels.get("command_sent")
    if command is None or "steering" not in command.labels or not _DRIVES & set(command.labels):
        return channels, notes
    found = channels
    for name in ("command", "command_sent"):
        if name in found and "throttle" in found[name].labels and found[name].unit == "rad":
            found[name] = replace(found[name], unit="")  # a share, not an angle, whatever its size
    for name, entry in list(found.items()):
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
            elif set(entry.labels) >= _QUATERNION:
                found["orientation"] = _part(entry, tuple(sorted(_QUATERNION)), tuple(sorted(_QUATERNION)), "")
                notes.append(f"orientation: {name} qx, qy, qz, qw; the heading is its turn about the vertical")
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


@dataclass(frozen=True)
class _Signal:
    """One column, and what its name says beside words that anything may have."""

    channel: str
    column: str
    core: str
    unit: str
    scale: float


def _gathered(channels: Mapping[str, ChannelColumns]) -> tuple[dict[str, ChannelColumns], list[str]]:
    """Throttle and steering as one command, x, y and heading as one pose, where a log scatters them over its columns."""
    found, notes = dict(channels), list[str]()
    steering = _find(found, _STEERS, _COMMANDED) or _find(found, _STEERS)
    drive = _find(found, _THROTTLES) or _find(found, _SPEEDS, _COMMANDED)
    if steering is None or drive is None:
        return found, notes
    kind = "throttle" if drive.core in _THROTTLES else "speed"
    if not any({"steering", kind} <= set(found[c].labels) for c in ("command", "command_sent") if c in found):
        notes += _together(found, "command", {kind: drive, "steering": steering}, "")
    x, y = _find(found, {"x"}), _find(found, {"y"})
    if x is not None and y is not None and (x.channel != y.channel or x.unit or "x" not in found[x.channel].labels):
        notes += _together(found, "position", {"x": x, "y": y}, "m")
    heading = _find(found, set(_HEADINGS))
    named = (
        heading is not None
        and set(found[heading.channel].labels) & set(_HEADINGS)
        and "x" in found[heading.channel].labels
    )
    if heading is not None and not named and "heading" not in found:
        notes += _together(found, "heading", {"heading": heading}, "rad")
    speed = _find(found, _SPEEDS, without=_COMMANDED)
    if speed is not None and "speed" not in found and speed.channel not in ("command", "command_sent"):
        notes += _together(found, "speed", {"speed": speed}, "m/s")
    return found, notes


def _find(
    channels: Mapping[str, ChannelColumns],
    cores: set[str],
    beside: frozenset[str] = frozenset(),
    without: frozenset[str] = frozenset(),
) -> _Signal | None:
    """The first column whose name says one of `cores`, one of `beside` if any, none of `without`, no more that matters."""
    for name, entry in channels.items():
        if len(entry.columns) != len(entry.labels) or entry.width > 1:
            continue
        for column in entry.columns:
            said = words(column)
            unit, scale = next((_UNITS[w] for w in reversed(said) if len(said) > 1 and w in _UNITS), ("", 1.0))
            core = [w for w in said if w not in _WHOSE and not (len(said) > 1 and w in _UNITS)]
            if (beside and not beside & set(said)) or without & set(said):
                continue
            if len(core) == 1 and core[0] in cores:
                return _Signal(name, column, core[0], unit, scale)
    return None


def _together(found: dict[str, ChannelColumns], name: str, signals: Mapping[str, _Signal], unit: str) -> list[str]:
    """Makes a channel of columns that share a file and a clock, nothing where they do not; says what it took them for."""
    entries = [found[s.channel] for s in signals.values()]
    if len({(e.file, e.time, e.time_unit, e.time_offset, e.rate) for e in entries}) > 1:
        return []
    given = {s.unit for s in signals.values() if s.unit}
    own = given.pop() if len(given) == 1 and name != "command" else unit
    scales = tuple(s.scale * (_TO_SI.get(s.unit, 1.0) if s.unit != own else 1.0) for s in signals.values())
    for signal in signals.values():
        entry = found.pop(signal.channel)
        rest = tuple(label for label, c in zip(entry.labels, entry.columns, strict=True) if c != signal.column)
        if rest:
            found[signal.channel] = _part(entry, rest, rest, "")
    found[name] = replace(
        entries[0], columns=tuple(s.column for s in signals.values()), labels=tuple(signals), unit=own,
        scale=scales if len(set(scales)) > 1 else scales[:1],
    )  # fmt: skip
    listed = " and ".join(s.column for s in signals.values())
    return [f"{name}: {listed} taken as {', '.join(signals)}" + (f" in {own}" if own else "")]
