# SPDX-License-Identifier: Apache-2.0
"""The log of a vehicle put together from its signals: command, position, heading, speed and turn rate in SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trueup.formats.mapping import TimeColumn
from trueup.formats.rules import joints, vehicles, wheels, wiring
from trueup.formats.rules.commanded import commanded
from trueup.formats.rules.names import listed
from trueup.formats.rules.rule import Column, Part
from trueup.formats.rules.sizes import are_rates, instants_of, rate_factor, speed_of, usable
from trueup.formats.rules.vehicles import Signal, best
from trueup.formats.table import listing
from trueup.inspection.relations import nearest
from trueup.recording import is_command
from trueup.samples import is_unit
from trueup.units import FULL_LOCK, are_pulses, canonical, hardly_radians, numbers_of, size_of, to_si

_QUATERNION = ("qx", "qy", "qz", "qw")
_XY, _ON_EARTH = ("x", "y"), ("latitude", "longitude")
_PLACES = {_XY: _XY, ("east", "north"): _XY, _ON_EARTH: _ON_EARTH}
"""Kinds of signals that make a place, the first choice first, and its labels."""
_POSE_TOGETHER = listed("odom odometry vicon mocap optitrack pf gps gnss slam amcl pose")
_ANGLES = listed("angle delta lenkwinkel")
_SPEEDS = ("m/s", "km/h", "mph", "cm/s", "mm/s")
_MANY_TURNS = 50.0
"""rad: a heading that grows on and on is beyond this after eight turns, one in degrees at once."""


def drive(columns: Sequence[Column], time: TimeColumn, *, vehicle: bool = False) -> list[Part]:
    """The channels of a vehicle (command, position, heading, speed, yaw_rate) in a log; none where it is of something else.

    A vehicle is what is commanded by throttle, or speed, and steering, or, where nothing else has a position, by speed and
    turn rate, or by the speeds of a left and a right wheel; or nothing but where something is on the plane and heads, as a
    tracker alone logs it. Units that nobody says are those of which numbers speak, else SI. What is known to be of a
    `vehicle` has joints of an arm on it at most.
    """
    paired = wheels.pairs(columns)
    of_wheels = {column for pair in paired for column in pair.every}
    others = [column for column in columns if column not in of_wheels]
    signals = [signal for column in others if (signal := vehicles.read(column)) is not None]
    place, heading, seen = list(_place(signals).values()), _heading(signals), wiring.measured(paired)
    command, said = commanded(signals, others, place, heading, time, paired, joints_ride=vehicle)
    if not command:
        told = wiring.commanded(paired, place, heading, time)
        if told is None and place:
            told = wiring.commanded(wheels.numbered(columns), place, heading, time)
        if told is None or (not place and any(joints.read(c.parts).is_position for c in others)):
            return _pose_alone(signals, columns, time)
        parts = [wiring.part("command", told.command, told.sign, told.notes)]
        rest = [s for s in signals if s.column not in told.command.every]
        seen = wiring.measured(paired, told.command).items()
        counted = [wiring.part(n, pair, wiring.turned_round(pair, told.command, told.sign, time)) for n, pair in seen]
        return parts + _measured(rest, parts, time) + counted
    if len({_source_file(s) for s in command.values()}) == 1:
        parts = [_part("command", command, time, ())]
    else:  # topics of their own: each keeps its time
        parts = [_part(f"command_{label}", {label: signal}, time, ()) for label, signal in command.items()]
    parts[0] = replace(parts[0], notes=(*parts[0].notes, *said))
    rest = [s for s in signals if s not in command.values()]
    return parts + _measured(rest, parts, time) + [wiring.part(n, pair) for n, pair in seen.items()]


def ridden(columns: Sequence[Column], time: TimeColumn) -> list[str]:
    """Says where a log of joints also holds what drives a base and where that went: a mapping has one of the two."""
    parts = drive(columns, time, vehicle=True)
    told = [column.name for part in parts if is_command(part.channel) for column in part.columns]
    if not told or not any(part.channel == "position" for part in parts):
        return []
    return [f"{listing(told, 4)}: these look like what drives a vehicle that the joints ride on; this mapping is of the "
            "joints, and with a vehicle's file (--model base.toml, [vehicle]) it is of the vehicle"]  # fmt: skip


def _measured(signals: list[Signal], parts: Sequence[Part], time: TimeColumn) -> list[Part]:
    """Position, heading, speed and turn rate among signals that drive nothing."""
    place = _place(signals)
    found = [_part("position", place, time, parts)] if place else []
    found += _direction(signals, next(iter(place.values())).source if place else frozenset(), time)
    across = {s.source: s.column for s in signals if s.kind == "sideways" and not s.commanded}
    along = [s.column for s in place.values()]  # vx and vy of a place, as PX4 logs them, are no speed along the vehicle
    other = [
        s for s in signals if place and s.source in across and are_rates((s.column, across[s.source]), along, time)
    ]
    for name in ("speed", "yaw_rate"):
        one = best([s for s in signals if s.kind == name and not s.commanded and s not in (*place.values(), *other)])
        found += [_part(name, {name: one}, time, [*parts, *found])] if one else []
    return found


def _pose_alone(signals: list[Signal], columns: Sequence[Column], time: TimeColumn) -> list[Part]:
    """Position and heading where a log holds nothing else: no joint, no command, and no height of a base."""
    place = _place(signals)
    turn = _direction(signals, next(iter(place.values())).source, time) if place else []
    used = {s.column for s in place.values()} | {column for part in turn for column in part.columns}
    left = [column for column in columns if column not in used]
    said = [joints.read(column.parts) for column in left]
    if not turn or any(r.command or (r.joint and r.kind) for r in said) or any("z" in c.parts.bare for c in left):
        return []
    return [_part("position", place, time, ()), *turn]


def _place(signals: list[Signal]) -> dict[str, Signal]:
    """X and y, east and north, or latitude and longitude, of one source, the most exact one."""
    options = [
        (first.rank, order, dict(zip(labels, (first, second), strict=True)))
        for order, ((one, other), labels) in enumerate(_PLACES.items())
        for first in signals
        if first.kind == one and not first.commanded
        for second in signals
        if second.kind == other and second.source == first.source and _source_file(second) == _source_file(first)
    ]
    return min(options, key=lambda option: option[:2])[2] if options else {}


def _direction(signals: list[Signal], beside: frozenset[str], time: TimeColumn) -> list[Part]:
    """The heading, or the quaternion, of the source of the position where it has one."""
    angles = [s for s in signals if s.kind == "heading" and not s.commanded]
    wholes = [w for s in signals if s.kind == "qz" and not s.commanded and (w := _turn_of(s, signals))]
    turns = [whole["qz"] for whole in wholes]
    same = [s for s in (*angles, *turns) if not (s.source ^ beside) & _POSE_TOGETHER]
    chosen = best(same) or best(angles) or best(turns)
    if chosen is None:
        return []
    if chosen.kind == "heading":
        return [_part("heading", {"heading": chosen}, time, ())]
    part = _part("orientation", wholes[turns.index(chosen)], time, ())
    note = f"orientation: {', '.join(c.name for c in part.columns)}; the heading is its turn about the vertical"
    return [replace(part, unit="", scale=(1.0,), notes=(note,))]


def _heading(signals: list[Signal]) -> list[Signal]:
    """What tells the direction: an angle, or z and w of a quaternion."""
    angle = best([s for s in signals if s.kind == "heading" and not s.commanded])
    whole = next((w for s in signals if s.kind == "qz" and not s.commanded and (w := _turn_of(s, signals))), None)
    return [angle] if angle else [whole["qz"], whole["qw"]] if whole else []


def _turn_of(signal: Signal, signals: list[Signal]) -> dict[str, Signal]:
    """The four parts of the quaternion that a signal is the third of; nothing where they are no quaternion.

    A robot on a floor often logs the last two alone: the others are zero.
    """
    parts = {
        kind: s
        for kind in _QUATERNION
        for s in signals
        if s.kind == kind and _source_file(s) == _source_file(signal) and s.source == signal.source
    }
    if set(parts) not in ({*_QUATERNION}, {*_QUATERNION[2:]}):
        return {}
    values = np.stack([s.column.values for s in parts.values()], axis=1)
    return parts if is_unit(values[np.isfinite(values).all(axis=1)]) else {}


def _source_file(signal: Signal) -> tuple[str, str]:
    return signal.column.file, signal.column.clock


def _part(channel: str, signals: Mapping[str, Signal], time: TimeColumn, parts: Sequence[Part]) -> Part:
    """The channel of signals by label, and what they were taken for."""
    own = next(iter(signals))
    usual = "" if channel.startswith("command") else vehicles.BY_KIND[own].unit
    columns = tuple(s.column for s in signals.values())
    degrees = [c.name for (label, s), c in zip(signals.items(), columns, strict=True) if _in_degrees(label, s, signals)]
    scale = tuple(math.radians(1.0) if s.column.name in degrees else _scale(s, usual) for s in signals.values())
    more = "; the way driven tells which way it grows, and from where" if channel == "heading" else ""
    more += f"; the numbers of {' and '.join(degrees)} are degrees" if degrees else ""
    if channel == "speed" and not _says(signals[own]) and (unit := _unit_of_speed(columns[0], parts, time)):
        scale, more = (size_of(unit),), f"; by the way its numbers are {unit}"
    if (
        channel == "position"
        and not any(map(_says, signals.values()))
        and (unit := _unit_of_place(columns, parts, time))
    ):
        scale, more = (size_of(unit),), f"; by the commanded speed its numbers are {unit}"
    if channel == "yaw_rate" and not _says(signals[own]) and _turns_in_degrees(columns[0], parts, time):
        scale, more = (math.radians(1.0),), "; by the heading its numbers are degrees per second"
    note = f"{channel}: {' and '.join(c.name for c in columns)} taken as {', '.join(signals)}"
    note += f" in {_units_for_note(signals, [usual] * len(signals))}{more}" if usual else more
    units = _commanded_in(signals, degrees) if channel.startswith("command") else ()
    note += f" in {_units_for_note(signals, [u or 'shares' for u in units])}" if any(units) else ""
    plain = channel == "command" and not degrees and [c.name for c in columns] == list(signals)
    notes = () if plain and not any(units) else (note,)
    each = units if any(units) else ()
    return Part(channel, columns, tuple(signals), usual, scale if len(set(scale)) > 1 else scale[:1], notes, each)


def _units_for_note(signals: Mapping[str, Signal], kept: Sequence[str]) -> str:
    """Units for a note: those that the file says, and those in which its numbers are kept, where these are others."""
    said = [_unit(signal, unit) for signal, unit in zip(signals.values(), kept, strict=True)]
    first, then = (units[0] if len(set(units)) == 1 else " and ".join(units) for units in (said, kept))
    return first if first == then else f"{first}, kept in {then}"


def _unit(signal: Signal, kept: str) -> str:
    """The unit that a log says for a signal, else that in which it is kept."""
    said = signal.column.declared or canonical(signal.column.parts.tail) or ""
    return said if said and kept != "shares" and to_si(said)[0] == to_si(kept)[0] else kept


def _commanded_in(signals: Mapping[str, Signal], degrees: Sequence[str]) -> tuple[str, ...]:
    """The unit of each command, '' where it is a share of the full one or nothing says: speeds of wheels are m/s, turn rates
    rad/s, steering is rad where its name says a unit or an angle (delta, as in the bicycle model), but for one that is
    called nothing else beside a throttle: both are shares then.
    """
    share_of_throttle = (
        "throttle" in signals and signals.get("steering") is not None and signals["steering"].kind == "angle"
    )

    def unit(label: str, s: Signal) -> str:
        said = (
            _says(s) or s.column.name in degrees or not (share_of_throttle or _ANGLES.isdisjoint(s.column.parts.words))
        )
        usual = {"speed": "m/s", "sideways": "m/s", "turn": "rad/s", "curvature": "1/m"}
        wanted = "rad" if said and label == "steering" else usual.get(label, "")
        pulses = s.column.parts.tail == "1" or (label == "steering" and are_pulses(s.column.known))  # steer_us
        share = pulses or s.factor == size_of("%") or s.kind == "erpm"
        return "" if share else wanted

    return tuple(unit(label, s) for label, s in signals.items())


def _says(signal: Signal) -> bool:
    """Whether the log itself says a unit."""
    return signal.factor is not None or bool(signal.column.declared)


def _in_degrees(label: str, signal: Signal, beside: Mapping[str, Signal]) -> bool:
    """Whether an angle that has no unit, by name or by declaration, has numbers that only degrees have."""
    known = signal.column.known
    if not len(known) or _says(signal):
        return False
    largest, jump = signal.column.largest, float(np.abs(np.diff(known)).max(initial=0.0))
    if label == "heading":  # a compass jumps by a whole turn where it passes its zero
        turns_by = nearest(jump, {"deg": math.degrees(math.tau), "rad": math.tau})
        return hardly_radians(largest, _MANY_TURNS) or (turns_by == "deg" and largest <= math.degrees(math.tau) + 1.0)
    inside = not hardly_radians(largest * math.radians(1.0), FULL_LOCK)
    return label == "steering" and "speed" in beside and hardly_radians(largest, FULL_LOCK) and inside


def _unit_of_speed(column: Column, parts: Sequence[Part], time: TimeColumn) -> str:
    """The unit in which a speed is that along x and y, if that is not m/s; '' where this is not to be told."""
    place = next((part for part in parts if part.channel == "position" and part.labels == ("x", "y")), None)
    if place is None or any(c.table is not column.table or c.clock != column.clock for c in place.columns):
        return ""
    (when, one), (other_when, other) = (speed_of(c, time) for c in place.columns)
    both = len(one) > 0 < len(other)
    along = np.hypot(one, np.interp(when, other_when, other)) * place.scale[0] if both else np.zeros(0)
    usual, shown = (float(np.median(np.abs(x))) if len(x) else 0.0 for x in (along, column.known))
    unit = nearest(shown / usual, {u: numbers_of(u) for u in _SPEEDS}) if usual > 0.0 else ""
    return unit if unit != "m/s" else ""


def _unit_of_place(place: Sequence[Column], parts: Sequence[Part], time: TimeColumn) -> str:
    """The unit of a place in which the way driven takes as long as at the commanded speed, if that is not m; '' where this is
    not to be told: lags, slip and rests make less than a factor of two. Places are a second apart, as noise adds up to a way.
    """
    told = [part.columns[part.labels.index("speed")] for part in parts
            if is_command(part.channel) and "speed" in part.labels and "m/s" in part.units]  # fmt: skip
    instants = instants_of(place[0], time)
    if not told or not len(instants) or any(c.table is not place[0].table or c.values.ndim > 1 for c in place):
        return ""
    if np.count_nonzero(good := usable(instants, *(c.values for c in place))) < 2:
        return ""
    seconds = np.arange(instants[good][0], instants[good][-1], 1.0)
    way = np.stack([np.interp(seconds, instants[good], c.values[good]) for c in place], axis=1)
    commanded = float(np.mean(np.abs(told[0].known))) * max(len(seconds) - 1, 0)
    driven = float(np.hypot(*np.diff(way, axis=0).T).sum())
    return next((u for u in ("cm", "mm") if 0.5 * commanded < size_of(u) * driven < 2.0 * commanded), "")


def _turns_in_degrees(column: Column, parts: Sequence[Part], time: TimeColumn) -> bool:
    """Whether a turn rate is that of the heading in degrees per second."""
    heading = next(
        (part for part in parts if part.channel == "heading" and part.columns[0].table is column.table), None
    )
    if heading is None:
        return False
    times = rate_factor(column, heading.columns[0], time)
    return (
        times is not None
        and nearest(abs(times) / heading.scale[0], {"deg": 1.0 / math.radians(1.0), "rad": 1.0}) == "deg"
    )


def _scale(signal: Signal, unit: str) -> float:
    """What one of the file's numbers is in the channel's unit: as the name says, else as the file declares it."""
    if unit == "deg":
        return 1.0
    if signal.factor is not None:
        return signal.factor
    name, factor, _ = to_si(signal.column.declared)
    return factor if name == unit or (not unit and name in ("rad", "m/s", "")) else 1.0
