# SPDX-License-Identifier: Apache-2.0
"""Units that nobody says, told from numbers: by how signals go with one another, else by their size, else asked for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from trueup.arrays import Array, Mask
from trueup.formats.clock import guess_unit, seconds
from trueup.formats.mapping import ChannelColumns, TimeColumn
from trueup.formats.rules import joints
from trueup.formats.rules.joints import BY_KIND
from trueup.formats.rules.rule import Column
from trueup.inspection.relations import factor, nearest, rate
from trueup.units import AS_FAR, hardly_radians, numbers_of, size_of, to_si

_TURN = 4096
"""Counts of a turn, of the magnetic encoders in Feetech STS and Dynamixel X servos."""
_SPEED_COUNTS = {"rpm": 0.229, "rad/s": math.tau / _TURN}
"""One count of the speed that Dynamixel X servos say, and the speed of one count a second, as Feetech STS say it."""
_TICKS = frozenset(["counts", "ticks"])
_POSITIONS = ("position", "command", "command_sent")
_ANGLES = ("rad", "deg", "rev")
_SPEEDS = ("rad/s", "deg/s", "rpm", "rev/s")
COUNTS_NOTE = (
    "taken as counts of servos, 4096 a turn and 2048 at zero; say so for joints that are zero elsewhere (offset) or turn "
    "the other way (sign)"
)
_FEWER_NOTE = (
    'unit unknown; whole numbers up to {largest:.4g} are counts of servos: give unit = "deg", and scale = 0.29326, '
    "offset = -150.15 for 1023 in 300 degrees around 512 (Dynamixel AX and XL-320), scale = 0.24, offset = -120 for 1000 in "
    "240 degrees around 500 (LewanSoul LX), scale = 0.087891, offset = -180 for 4096 a turn around 2048 (Dynamixel X, "
    "Feetech STS)"
)


@dataclass
class Sizes:
    """Channels that get their units, one after the other; `notes` says what was taken for what, and what is open."""

    channels: dict[str, ChannelColumns]
    groups: Mapping[str, Sequence[Column]]
    time: TimeColumn
    notes: list[str] = field(default_factory=list)

    def settle(self) -> None:
        """Gives units where numbers tell one; else says that it is unknown."""
        counts = self._open("position") and _are_counts(self.groups["position"])
        # What is rad by its size tells the unit of what goes with it, and not the other way round.
        for name in sorted(_POSITIONS, key=lambda name: self._open(name) and hardly_radians(self._largest(name))):
            if self._open(name):
                self._position(name, counts)
        for name in ("velocity", "torque", "command_velocity", "command_torque"):
            if self._open(name):
                self._of_joints(name, BY_KIND[name.removeprefix("command_")].unit)
        if self._open("current"):
            self.notes.append("current: unit unknown: say A or mA")

    def _open(self, name: str) -> bool:
        return name in self.channels and not self.channels[name].unit

    def _largest(self, name: str) -> float:
        return max(column.largest for column in self.groups[name])

    def _position(self, name: str, counts: bool) -> None:
        largest = self._largest(name)
        ticks = any(_TICKS & set(column.parts.words) for column in self.groups[name])
        if name != "position" and all(_is_share(column) for column in self.groups[name]):
            self.notes.append(
                f"{name}: percent, by its name, of what the log does not say: `trueup calibrate` looks at how joints follow; "
                'or give unit = "rad" and scale = rad for one percent'
            )
            return
        related = self._beside_speed(name) or self._beside_positions(name) or self._with_speed(name, largest)
        if related:
            self._take(name, *related)
        elif (
            counts and max(map(self._largest, {"position", name})) < _TURN // 4
        ):  # 10 bits, or a quarter beside its zero
            self.notes.append(f"{name}: {_FEWER_NOTE.format(largest=largest)}")
        elif counts:
            scale, offset = (2.0 * math.pi / _TURN,), (-math.pi,)
            self.channels[name] = replace(self.channels[name], scale=scale, offset=offset, unit="rad")
            self.notes.append(f"{name}: {COUNTS_NOTE}")
        elif name == "command" and "position" not in self.channels:
            self.notes.append("command: unit unknown (there is no position to compare with)")
        elif name == "position" and all(_of_odrive(column) for column in self.groups[name]):
            self._take(name, "rev", "an ODrive estimates turns")
        elif not hardly_radians(largest) and not ticks:
            self._take(name, "rad", f"largest value {largest:.3g}")
        elif ticks or all(column.whole for column in self.groups[name]):
            self.notes.append(
                f"{name}: unit unknown; whole numbers (up to {largest:.4g}): counts of an encoder or degrees are "
                'suspected; for counts give unit = "rad" and scale = 6.2832 / counts of a turn (slides: "m", metres of one)'
            )
        else:
            self.notes.append(
                f"{name}: unit unknown (values reach {largest:.4g}): degrees are suspected, "
                + ("or percent of a range" if name != "position" else "or motors before their gears")
            )

    def _take(self, name: str, unit: str, why: str) -> None:
        self.channels[name] = replace(self.channels[name], unit=unit)
        self.notes.append(f"{name}: taken as {unit} ({why}); say so if it is m or anything else")

    def _beside_speed(self, name: str) -> tuple[str, str] | None:
        """The unit of positions of which a measured speed, whose unit is known, is the rate."""
        speed = self.channels.get("velocity")
        if name != "position" or speed is None or to_si(speed.unit)[0] != "rad/s":
            return None
        times = self._common("velocity", name, derive=True)
        unit = nearest(times * size_of(speed.unit), {u: size_of(u) for u in _ANGLES}) if times else ""
        return (unit, f"the speeds in {speed.unit} are its rate") if unit else None

    def _with_speed(self, name: str, largest: float) -> tuple[str, str] | None:
        """Degrees, where angles are no radians and speeds of an unknown unit are their rate in rad/s or rpm."""
        if name != "position" or not self._open("velocity") or not hardly_radians(largest):
            return None
        times = self._common("velocity", name, derive=True)
        unit = nearest(times, {u: size_of("deg") / size_of(u) for u in ("rad/s", "rpm")}) if times else ""
        return ("deg", f"the speeds are their rate in {unit}") if unit else None

    def _beside_positions(self, name: str) -> tuple[str, str] | None:
        """The unit of positions or commands that go with others, whose unit is known."""
        for other in _POSITIONS:
            known = self.channels.get(other)
            if other != name and known is not None and known.unit in _ANGLES and known.scale == (1.0,):
                sizes, si = {u: size_of(u) for u in _ANGLES}, size_of(known.unit)
                times = self._common(name, other, derive=False)
                unit = nearest(si / times, sizes) if times else ""
                # Shares of ranges are near a unit in some joints alone.
                all_near = all(nearest(si / each, sizes) for each in self._factors(name, other))
                if unit and all_near and not self._in_percent(name, unit):
                    return unit, f"it is {times:.3g} times {other} in {known.unit}"
        return None

    def _in_percent(self, name: str, unit: str) -> bool:
        """Whether commands that would be degrees end where shares of a range do: of +-1.75 rad these are 57 for each."""
        return unit == "deg" and name != "position" and self._largest(name) == numbers_of("%")

    def _of_joints(self, name: str, usual: str) -> None:
        """Speeds and torques of joints whose positions are in rad are in SI, unless the positions' rate says otherwise."""
        channel, position = self.channels[name], self.channels.get("position")
        angles = position is not None and to_si(position.unit)[0] == "rad" and len(position.scale) == 1
        times = self._common(name, "position", derive=True) if angles and name == "velocity" else None
        counted = name == "command_torque" and all(joints.COUNTED.fullmatch(label) for label in channel.labels)
        of_known = any(counted or channel.labels == self.channels[p].labels for p in _POSITIONS if p in self.channels
                       and self.channels[p].unit in ("rad", "deg"))  # fmt: skip
        if times is not None and position is not None:
            per_si = times / (size_of(position.unit) * position.scale[0])
            unit = nearest(per_si, {u: numbers_of(u) for u in _SPEEDS})
            why = "" if unit else f"{per_si:.3g} times "
            unit = unit or (usual if 1.0 / AS_FAR < per_si < AS_FAR else "")
            if unit:
                self.channels[name] = replace(channel, unit=unit)
                self.notes.append(
                    f"{name}: taken as {unit}, {why}the rate of the positions; say so if it is anything else"
                )
            elif not self._counted_speed(name, per_si):
                self.notes.append(f"{name}: unit unknown (it is {per_si:.3g} times the rate of the positions in rad/s)")
        elif name == "torque" and all(_counted(column) for column in self.groups[name]):
            largest = max(column.largest for column in self.groups[name])
            self.notes.append(
                f"torque: unit unknown; whole numbers that reach {largest:.4g} are no N m, but a servo's load in percent "
                "or its current in mA: call the channel load, or current, in the mapping"
            )
        elif of_known and position is not None and position.unit == "rad":
            self.channels[name] = replace(channel, unit=usual)
            self.notes.append(f"{name}: taken as {usual}; say so if it is anything else")
        else:
            self.notes.append(f"{name}: unit unknown")

    def _counted_speed(self, name: str, per_si: float) -> bool:
        """Whether speeds are whole numbers that go with the rate of positions as those of a known servo do; takes them so."""
        counts = {unit: numbers_of(unit) / size for unit, size in _SPEED_COUNTS.items()}
        unit = nearest(per_si, counts) if all(_counted(column) for column in self.groups[name]) else ""
        if unit:
            self.channels[name] = replace(self.channels[name], unit=unit, scale=(_SPEED_COUNTS[unit],))
            self.notes.append(
                f"{name}: taken as counts of servos, of {_SPEED_COUNTS[unit]:.4g} {unit} each ({per_si:.3g} times the rate "
                "of the positions in rad/s); say so if it is anything else"
            )
        return bool(unit)

    def _common(self, name: str, other: str, *, derive: bool) -> float | None:
        """How many times the other channel (or its rate) one is: the median over their joints; None where few agree."""
        factors = self._factors(name, other, derive=derive)
        pairs = len(list(self._pairs(name, other)))
        return float(np.median(factors)) if factors and 2 * len(factors) > pairs else None

    def _factors(self, name: str, other: str, *, derive: bool = False) -> list[float]:
        """How many times the other channel (or its rate) one is, of each joint of which that is to be told."""
        return [f for pair in self._pairs(name, other) if (f := _factor(*pair, self.time, derive=derive)) is not None]

    def _pairs(self, name: str, other: str) -> Iterator[tuple[Column, Column]]:
        """Columns of one number that are of one joint, in one table and on its main clock."""
        columns = dict(zip(self.channels[other].labels, self.groups[other], strict=False))
        for label, column in zip(self.channels[name].labels, self.groups[name], strict=False):
            beside = columns.get(label)
            if beside is not None and beside.table is column.table and column.width == beside.width == 1:
                yield column, beside


def _are_counts(measured: Sequence[Column]) -> bool:
    """Whether positions are whole numbers within one turn of counts, and beyond two turns of degrees."""
    if not all(column.whole for column in measured):
        return False
    lowest = min(float(column.known.min()) for column in measured)
    return lowest >= 0.0 and 2.0 * math.degrees(math.tau) < max(column.largest for column in measured) < _TURN


def _is_share(column: Column) -> bool:
    """Whether a command is said to be a share of something."""
    return (joints.read(column.parts).unit or column.declared) in joints.SHARES.values()


def _of_odrive(column: Column) -> bool:
    """Whether a column is called as that firmware calls its position: axis0.encoder.pos_estimate."""
    plain = set(column.parts.words)
    return {"pos", "estimate"} <= plain and bool({"axis", "odrive"} & plain)


def _counted(column: Column) -> bool:
    """Whether a signal only has whole numbers, of more than a few kinds."""
    several = 10  # a signal with fewer distinct values is a switch, or an example
    return column.whole and len(np.unique(column.known)) > several


def speed_of(column: Column, time: TimeColumn) -> tuple[Array, Array]:
    """(m,) instants and rate of change of a column on its table's main clock, in its unit a second; (0,) if unknown."""
    instants = instants_of(column, time)
    if not len(instants):
        return np.zeros(0), np.zeros(0)
    good = usable(instants, column.values)
    return rate(column.values[good], instants[good]) if np.count_nonzero(good) > 2 else (np.zeros(0), np.zeros(0))


def instants_of(column: Column, time: TimeColumn) -> Array:
    """(T,) the instants of a column of single numbers on its table's main clock, in s; (0,) where it has none there."""
    clock = column.table.columns.get(time.column)
    if clock is None or column.clock or column.values.ndim > 1:
        return np.zeros(0)
    fraction = column.table.columns.get(time.nanoseconds)
    instants = seconds(clock, time.unit or guess_unit(time.column, clock))
    return instants if fraction is None else instants + seconds(fraction, "ns")


def usable(instants: Array, *signals: Array) -> Mask:
    """(T,) where all are known and time goes forward."""
    good = np.isfinite(instants) & np.logical_and.reduce([np.isfinite(s) for s in signals])
    good[1:] &= np.diff(np.fmax.accumulate(np.where(np.isfinite(instants), instants, -np.inf))) > 0.0
    return good


def _factor(column: Column, beside: Column, time: TimeColumn, *, derive: bool) -> float | None:
    """How many times the values of another column of its table, or their rate, one is; None in tables of their own."""
    if column.table is not beside.table:
        return None
    values, reference = column.values, beside.values
    if not derive:
        return factor(values, reference)
    instants = instants_of(beside, time)
    if len(instants) < 3 or column.clock:
        return None
    good = usable(instants, reference, values)
    if np.count_nonzero(good) < 3:
        return None
    at, slope = rate(reference[good], instants[good])
    return factor(np.asarray(np.interp(at, instants[good], values[good]), dtype=np.float64), slope)


def rate_factor(column: Column, beside: Column, time: TimeColumn) -> float | None:
    """How many times the rate of change of another column of its table one is; None where that is not to be told."""
    return _factor(column, beside, time, derive=True)


def are_rates(columns: Sequence[Column], of: Sequence[Column], time: TimeColumn) -> bool:
    """Whether each column is the rate of change of the other one beside it, in whatever unit."""
    return all((rate_factor(column, beside, time) or 0.0) > 0.0 for column, beside in zip(columns, of, strict=True))
