# SPDX-License-Identifier: Apache-2.0
"""The pose of a robot's free base among the channels of a log, whoever named it: position and orientation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.formats.mapping import ChannelColumns
from trueup.formats.words import words
from trueup.units import to_si

Array = NDArray[np.float64]

POSITION, ORIENTATION = "base_position", "base_orientation"
_SOURCES = (
    "mocap vicon optitrack qualisys vrpn motive motion capture",
    "ground truth",
    "base trunk torso body root pelvis floating pose robot world",
    "odom odometry",
)
"""Words for whose pose it is or who measured it, the better sources first."""
_OTHERS = (
    "imu command commanded cmd desired des target goal ref reference foot feet hand ee tcp camera velocity vel twist "
    "linear angular lin acc accel acceleration speed gyro omega"
)
_PLACES = ("x", "y", "z")
_QUATERNION = ("w", "x", "y", "z")
_ANGLES = ("roll", "pitch", "yaw")
_TURNS = frozenset(["quat", "quaternion", "orientation", "rotation", "rot", "attitude"])
_EULER = frozenset(["rpy", "euler"])
_FAR = 30.0  # m: rooms with motion capture are smaller, so larger numbers are millimetres


@dataclass(frozen=True)
class _Part:
    """One number of a pose: which channel and column of it, and whether a column of its own."""

    channel: str
    at: int
    component: str


def as_pose(
    channels: Mapping[str, ChannelColumns], cells: Mapping[str, Mapping[str, Array]]
) -> tuple[dict[str, ChannelColumns], list[str]]:
    """`channels` with a base's pose under the names of a pose, and notes. `cells`: the numbers in each channel's columns.

    Taken are x, y, z, quaternions and roll, pitch, yaw of a base, trunk or motion capture, in columns or lists; nothing
    is changed where they are not there, or stand there twice.
    """
    every = [p for name, entry in channels.items() if _may_be(name) for p in _parts(name, entry, cells[name])]
    wholes = [_pose([p for p in every if _source(p.channel) == k]) for k in range(len(_SOURCES) + 1)]
    places, turn, angles = next((w for w in [*wholes, _pose(every)] if w is not None), (None, None, None))
    if places is None:
        return dict(channels), []
    made = {POSITION: _made(channels, places, _PLACES, cells)}
    made[ORIENTATION] = _made(channels, turn or angles or [], _QUATERNION if turn else _ANGLES, cells)
    used = {p.channel for p in (*places, *(turn or angles or []))}
    kept = {name: entry for name, entry in channels.items() if name not in used}
    unit = made[POSITION].unit
    note = f"{POSITION}: taken as {unit}; say so if it is anything else" if not channels[places[0].channel].unit else ""
    return {**kept, **made}, [note] if note else []


_Parts = list[_Part] | None


def _pose(parts: Sequence[_Part]) -> tuple[list[_Part], _Parts, _Parts] | None:
    """Position, and quaternion or angles, if these parts are a whole pose."""
    places = _whole(parts, _PLACES)
    turn = _whole([p for p in parts if p.component.startswith("q")], tuple(f"q{c}" for c in _QUATERNION))
    angles = _whole(parts, _ANGLES)
    return (places, turn, angles) if places is not None and (turn is not None or angles is not None) else None


def _source(name: str) -> int:
    """How good the source of a channel is, by its name: 0 the best, the last for none."""
    plain = set(words(name))
    found = [k for k, said in enumerate(_SOURCES) if plain & set(said.split())]
    # An odometry's pose of the base drifts, whatever else its name says.
    return max(found) if len(_SOURCES) - 1 in found else min(found, default=len(_SOURCES))


def _may_be(name: str) -> bool:
    plain = set(words(name))
    bare = name in (*_PLACES, *_ANGLES, *(f"q{c}" for c in _QUATERNION))
    return bare or (_source(name) < len(_SOURCES) and not plain & set(_OTHERS.split()))


def _parts(name: str, entry: ChannelColumns, cells: Mapping[str, Array]) -> list[_Part]:
    """The numbers of a channel as parts of a pose; none where one of them is no part."""
    plain, count = set(words(name)), len(entry.labels)
    ends = [words(label)[-1] if words(label) else "" for label in entry.labels]
    bare = all(end.isdigit() for end in ends)
    if bare and count == 3:
        ends = list(_ANGLES if plain & _EULER else _PLACES)
    elif bare and count == 4:
        ends = list(_order(entry, cells))
    elif bare and count == 7:
        ends = [*_PLACES, *(f"q{c}" for c in _QUATERNION)]
    if plain & _TURNS and set(ends) == set(_QUATERNION):
        ends = [f"q{end}" for end in ends]
    known = {*_PLACES, *_ANGLES, *(f"q{c}" for c in _QUATERNION)}
    return [_Part(name, i, end) for i, end in enumerate(ends)] if all(end in known for end in ends) else []


def _order(entry: ChannelColumns, cells: Mapping[str, Array]) -> Sequence[str]:
    """Whether the real part of four numbers stands first or last: robots mostly stand upright, so it is the larger."""
    sizes = np.concatenate([np.atleast_2d(cells[c].T) for c in entry.columns if c in cells])
    first, last = np.nanmedian(np.abs(sizes[0])), np.nanmedian(np.abs(sizes[-1]))
    return ("qw", "qx", "qy", "qz") if first >= last else ("qx", "qy", "qz", "qw")


def _whole(parts: Sequence[_Part], wanted: Sequence[str]) -> list[_Part] | None:
    """One part for each component, all of one clock's channels; None where one is missing or there twice."""
    found = [[p for p in parts if p.component == component] for component in wanted]
    return [p for (p,) in found] if all(len(each) == 1 for each in found) else None


def _made(
    channels: Mapping[str, ChannelColumns], parts: Sequence[_Part], labels: Sequence[str],
    cells: Mapping[str, Mapping[str, Array]],
) -> ChannelColumns:  # fmt: skip
    """The channel of these parts: single columns in the order of `labels`, or one list-valued column with labels."""
    entry = channels[parts[0].channel]
    if len(entry.columns) == len(entry.labels):
        columns = tuple(channels[p.channel].columns[p.at] for p in parts)
        entry = replace(entry, columns=columns, labels=tuple(labels), scale=(1.0,))
    else:
        bare = {p.at: label for p, label in zip(parts, labels, strict=True)}
        entry = replace(entry, labels=tuple(bare[i] for i in range(len(entry.labels))))
    numbers = {c: values for p in parts for c, values in cells[p.channel].items() if c in entry.columns}
    return replace(entry, unit=_unit(entry, tuple(labels), numbers))


def _unit(entry: ChannelColumns, labels: tuple[str, ...], cells: Mapping[str, Array]) -> str:
    largest = max(float(np.nanmax(np.abs(cells[c]), initial=0.0)) for c in entry.columns)
    if labels == _QUATERNION:
        return ""
    if entry.unit and to_si(entry.unit)[0] == ("m" if labels == _PLACES else "rad"):
        return entry.unit
    if labels == _PLACES:
        return "mm" if largest > _FAR else "m"
    return "deg" if largest > 4.0 * np.pi else "rad"
