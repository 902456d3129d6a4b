# SPDX-License-Identifier: Apache-2.0
"""Logs of vehicles: where throttle or speed and steering are commanded, a tracked pose is position and heading."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from trueup.formats.mapping import ChannelColumns
from trueup.formats.table import Table
from trueup.formats.vehicle_words import Said, said

_QUATERNION = ("qx", "qy", "qz", "qw")
_UNIT = {
    "x": "m",
    "y": "m",
    "latitude": "deg",
    "longitude": "deg",
    "heading": "rad",
    "speed": "m/s",
    "yaw_rate": "rad/s",
}
_POSE_TOGETHER = frozenset(
    {"odom", "odometry", "vicon", "mocap", "optitrack", "pf", "gps", "gnss", "slam", "amcl", "pose"}
)

_DEGREE = math.pi / 180.0
_MANY_TURNS = 50.0  # rad: a heading beyond is in degrees
_FULL_LOCK = (1.6, 91.0)  # no wheel is steered beyond the first in rad, or beyond the second in degrees

Numbers = Mapping[tuple[str, str], NDArray[np.float64]]
"""(file or topic, column) -> its numbers."""


@dataclass(frozen=True)
class _Signal:
    """One column of one channel, and what its name says."""

    channel: str
    column: str
    entry: ChannelColumns
    said: Said


def as_vehicle(
    channels: Mapping[str, ChannelColumns], tables: Sequence[Table] = ()
) -> tuple[dict[str, ChannelColumns], list[str]]:
    """The channels with a vehicle's names (command, position, heading, speed, yaw_rate), and notes; unchanged for others.

    A vehicle is what is commanded by throttle, or speed, and steering, or, where nothing else has a position, by speed and
    turn rate. Angles whose unit nobody says are degrees where their numbers in `tables` can be nothing else.
    """
    signals = _signals(channels)
    command = _command(signals, channels)
    if not command:
        return dict(channels), []
    taken, notes = _Taken(dict(channels), _numbers(tables)), list[str]()
    if len({_clock(s.entry) for s in command.values()}) == 1:
        notes += taken.together("command", command)
    else:  # topics of their own: each keeps its time
        for label, signal in command.items():
            notes += taken.together(f"command_{label}", {label: signal})
    rest = [s for s in signals if s not in command.values()]
    place = _place(rest)
    notes += taken.together("position", place) if place else []
    beside = next(iter(place.values())).said.source if place else frozenset()
    notes += _direction(rest, beside, taken)
    for name in ("speed", "yaw_rate"):
        found = _best([s for s in rest if s.said.kind == name and not s.said.commanded and s not in place.values()])
        notes += taken.together(name, {name: found}) if found else []
    return taken.channels, notes


def _numbers(tables: Sequence[Table]) -> Numbers:
    return {(t.name if len(tables) > 1 else "", name): v for t in tables for name, v in t.columns.items()}


def _signals(channels: Mapping[str, ChannelColumns]) -> list[_Signal]:
    """Every column of one number whose name means something in a vehicle."""
    found: list[_Signal] = []
    for name, entry in channels.items():
        if len(entry.columns) != len(entry.labels) or entry.width > 1:
            continue
        told = [(column, said(column, entry.file)) for column in entry.columns]
        found += [_Signal(name, column, entry, meaning) for column, meaning in told if meaning is not None]
    return found


def _command(signals: list[_Signal], channels: Mapping[str, ChannelColumns]) -> dict[str, _Signal]:
    """What drives it, by label; nothing where this is no vehicle."""
    kinds = {kind: [s for s in signals if s.said.kind == kind] for kind in ("throttle", "brake", "steering", "erpm")}
    speeds = [s for s in signals if s.said.kind == "speed" and s.said.commanded]
    turns = [s for s in signals if s.said.kind == "yaw_rate" and s.said.commanded]
    steering, throttle = _best(kinds["steering"]), _best(kinds["throttle"])
    speed = _best(speeds) or _best([s for s in kinds["erpm"] if s.said.commanded])
    drive = {"throttle": throttle} if throttle else {"speed": speed} if speed else {}
    if steering and drive:
        brake = _best(kinds["brake"]) if throttle else None
        return {**drive, "steering": steering, **({"brake": brake} if brake else {})}
    whole = channels.get("position")
    joints = whole is not None and not all(said(c, whole.file) for c in whole.columns)
    if speeds and turns and not joints and _place(signals):
        return {"speed": speeds[0], "turn": turns[0]}
    return {}


def _place(signals: list[_Signal]) -> dict[str, _Signal]:
    """X and y, or latitude and longitude, of one source, the most exact one."""
    options: list[tuple[int, int, dict[str, _Signal]]] = []
    for order, (one, other) in enumerate((("x", "y"), ("latitude", "longitude"))):
        for first in (s for s in signals if s.said.kind == one and not s.said.commanded):
            second = next(
                (
                    s
                    for s in signals
                    if s.said.kind == other
                    and s.said.source == first.said.source
                    and _clock(s.entry) == _clock(first.entry)
                ),
                None,
            )
            if second is not None:
                options.append((first.said.rank, order, {one: first, other: second}))
    return min(options, key=lambda o: o[:2])[2] if options else {}


def _direction(signals: list[_Signal], beside: frozenset[str], taken: _Taken) -> list[str]:
    """Takes the heading, or the quaternion, of the source of the position where it has one."""
    angles = [s for s in signals if s.said.kind == "heading" and not s.said.commanded]
    turns = [s for s in signals if s.said.kind == "qz" and not s.said.commanded]
    same = [s for s in (*angles, *turns) if (s.said.source ^ beside) & _POSE_TOGETHER == frozenset()]
    found = _best(same) or _best(angles) or _best(turns)
    if found is None:
        return []
    if found.said.kind == "heading":
        return taken.together("heading", {"heading": found})
    parts = {
        k: s for k in _QUATERNION for s in signals
        if s.said.kind == k and s.channel == found.channel and s.said.source == found.said.source
    }  # fmt: skip
    if len(parts) < len(_QUATERNION):
        return []
    taken.together("orientation", parts)
    return [f"orientation: {found.channel} qx, qy, qz, qw; the heading is its turn about the vertical"]


def _best(signals: list[_Signal]) -> _Signal | None:
    """The most trusted, of these the first."""
    return min(signals, key=lambda s: s.said.rank, default=None)


def _clock(entry: ChannelColumns) -> tuple[object, ...]:
    return entry.file, entry.time, entry.time_unit, entry.time_offset, entry.rate


@dataclass(frozen=True)
class _Taken:
    """Channels from which columns are taken and put together anew."""

    channels: dict[str, ChannelColumns]
    numbers: Numbers = field(default_factory=dict)

    def together(self, name: str, signals: Mapping[str, _Signal]) -> list[str]:
        """Makes channel `name` of signals by label; says what they were taken for, unless they were that already."""
        before = self.channels.get(name)
        own = next(iter(signals))
        usual = "" if name.startswith("command") else _UNIT.get(own, "")
        degrees = [label for label, s in signals.items() if self._in_degrees(label, s, signals)]
        scale = tuple(_DEGREE if label in degrees else _scale(s, usual) for label, s in signals.items())
        for signal in signals.values():
            self._without(signal)
        kept = self.channels.pop(name, None)
        if kept is not None:  # what else stood under this name
            self.channels[f"other_{name}"] = kept
        made = replace(
            next(iter(signals.values())).entry, columns=tuple(s.column for s in signals.values()), labels=tuple(signals),
            unit=usual, scale=scale if len(set(scale)) > 1 else scale[:1],
        )  # fmt: skip
        self.channels[name] = made
        if before is not None and (before.columns, before.labels, before.unit) == (
            made.columns,
            made.labels,
            made.unit,
        ):
            return []
        listed = " and ".join(s.column for s in signals.values())
        more = ", growing to the left" if name == "heading" else ""
        more += (
            f"; the numbers of {' and '.join(signals[label].column for label in degrees)} are degrees"
            if degrees
            else ""
        )
        return [f"{name}: {listed} taken as {', '.join(signals)}" + (f" in {usual}{more}" if usual else more)]

    def _in_degrees(self, label: str, signal: _Signal, beside: Mapping[str, _Signal]) -> bool:
        """Whether an angle that has no unit, by name or by declaration, has numbers that only degrees have."""
        values = self.numbers.get((signal.entry.file, signal.column))
        told = signal.said.unit or signal.said.factor != 1.0 or signal.entry.unit
        if values is None or told or not np.isfinite(values).any():
            return False
        known = values[np.isfinite(values)]
        largest, jump = float(np.abs(known).max()), float(np.abs(np.diff(known)).max(initial=0.0))
        if label == "heading":
            return largest > _MANY_TURNS or (largest <= 361.0 and 300.0 < jump < 400.0)
        return label == "steering" and "speed" in beside and _FULL_LOCK[0] < largest < _FULL_LOCK[1]

    def _without(self, signal: _Signal) -> None:
        """Takes a column out of the channel that holds it now, which may have got another name meanwhile."""
        held = (n for n, e in self.channels.items() if signal.column in e.columns and e.file == signal.entry.file)
        channel = next(held, None)
        if channel is None:
            return
        entry = self.channels[channel]
        kept = [k for k, c in enumerate(entry.columns) if c != signal.column]
        del self.channels[channel]
        if kept:
            scale = tuple(entry.scale[k] for k in kept) if len(entry.scale) > 1 else entry.scale
            self.channels[channel] = replace(entry, columns=tuple(entry.columns[k] for k in kept),
                                             labels=tuple(entry.labels[k] for k in kept), scale=scale)  # fmt: skip


def _scale(signal: _Signal, unit: str) -> float:
    """What one of the file's numbers is in the channel's unit: as the name says, else as the file declares it."""
    if unit == "deg":
        return 1.0
    if signal.said.unit or signal.said.factor != 1.0:
        return signal.said.factor
    return _declared(signal.entry.unit, unit)


def _declared(given: str, unit: str) -> float:
    """The same from the unit that a file declares for its column, where it is of the kind that is wanted."""
    from trueup.units import canonical, to_si

    if canonical(given) is None:
        return 1.0
    name, factor, _ = to_si(given)
    return factor if name == unit or (not unit and name in ("rad", "m/s", "")) else 1.0
