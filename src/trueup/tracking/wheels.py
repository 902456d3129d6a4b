# SPDX-License-Identifier: Apache-2.0
"""Two driven wheels as a speed and a turn rate: their mean, and their difference over the track."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.errors import ParameterError, RecordingError
from trueup.recording import Channel, Recording
from trueup.samples import COUNTS, unwound
from trueup.tracking.commands import held, refuse_beyond, signals
from trueup.units import AS_FAR

SIDES = ("left", "right")
DUTIES = ("left_duty", "right_duty")
"""Labels of commands that are shares of what motors can do (PWM, power, voltage), in whatever numbers: never a speed."""


@dataclass(frozen=True)
class Wheels:
    """What the maker says of two driven wheels. Raises ParameterError for impossible numbers."""

    track: float
    """Between the middles of both wheels, in m."""
    radius: float = 0.0
    """In m; 0: unknown."""
    counts_per_turn: float = 0.0
    """Of an encoder, for a turn of the wheel; 0: unknown."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        for name, value in (
            ("track", self.track),
            ("wheel_radius", self.radius),
            ("counts_per_turn", self.counts_per_turn),
        ):
            if not (0.0 < value < np.inf or (value == 0.0 and name != "track")):
                raise ParameterError(f"two driven wheels: {name} is {value}; it must be positive")

    def way(self, unit: str) -> float:
        """How far a wheel rolls for one of a unit, in m (of 'rad/s' and counts a second: in m/s); 0 where nothing says."""
        per_count = 2.0 * np.pi * self.radius / self.counts_per_turn if self.counts_per_turn else 0.0
        return {"m": 1.0, "rad": self.radius}.get(unit.removesuffix("/s"), per_count)


def as_driven(recording: Recording, wheels: Wheels) -> Recording:
    """The recording with the wheels' commands as speed and turn, and without a place with the speed and turn rate of wheels.

    Commands without a unit stay so: their mean is the speed, their difference the turn. Raises RecordingError where a radius
    or an encoder's counts are needed and unknown.
    """
    found = signals(recording)
    labels = DUTIES if told_duties(recording) else SIDES
    if set(labels) <= set(found) and not {"speed", "throttle"} & set(found):
        sides = [_side(recording, found, label) for label in labels]
        time = sides[0].time if sides[0].time is sides[1].time else np.unique(np.concatenate([s.time for s in sides]))
        units = {side.unit_of(side.labels[0]) for side in sides}
        sized = labels is SIDES and len(units) == 1 and units != {""}
        way = _known_way(wheels, units.pop(), recording, sides[0]) if sized else 0.0
        left, right = ((way or 1.0) * held(side, time) for side in sides)
        values = np.stack([0.5 * (left + right), (right - left) / (wheels.track if way else 1.0)], axis=1)
        recording = recording.with_channel(
            Channel("command", ("speed", "turn"), "", time, values, ("m/s", "rad/s") if way else ())
        )
    if recording.has("position") or (recording.has("speed") and recording.has("yaw_rate")):
        return recording
    rolled = _rolled(recording, wheels)
    for channel in (c for c in rolled if not recording.has(c.name)):
        recording = recording.with_channel(channel)
    return recording


def _side(recording: Recording, found: Mapping[str, Channel], label: str) -> Channel:
    """What all wheels of a side are told: the mean of what is labelled so and `rear_left`, `middle_left`, and the like.

    Raises RecordingError where these are told speeds of their own: such wheels drive sideways. (Shares of what motors can do
    are often those of a controller of each.)
    """
    side, further = found[label], [found[name] for name in found if name.endswith(f"_{label}")]
    values = [side.values[:, 0], *(held(wheel, side.time) for wheel in further)]
    for wheel, told in zip(further, values[1:], strict=True):
        apart = Channel(wheel.name, wheel.labels, side.unit, side.time, (told - values[0])[:, None], side.units)
        if label in SIDES:
            refuse_beyond(recording, "apart", apart, side)
    return side.replace(values=np.mean(values, axis=0)[:, None]) if further else side


def refuse_another_unit(recording: Recording, full: tuple[float, float] | None) -> None:
    """Raises RecordingError where wheels are told in another unit than those with which a robot was calibrated.

    `full` is what stands for one of each command in its file; None before a calibration. `recording` as `as_driven` gives it.
    """
    told = [c for label, c in signals(recording).items() if label in ("speed", "turn")]
    in_si, largest = (
        any(any(c.units) for c in told),
        max((float(np.nanmax(np.abs(c.values))) for c in told), default=0.0),
    )
    if full is None or not told or (in_si or largest <= AS_FAR if full == (1.0, 1.0) else not in_si):
        return
    said, known = (
        ("have none", "m/s or shares")
        if full == (1.0, 1.0)
        else ("have one", f"numbers without one (full = {list(full)})")
    )
    raise RecordingError(
        f"recording '{recording.name}': the robot's file was calibrated with commands of wheels in {known}, these {said}; "
        "say the unit in the mapping's [channels.command], or calibrate with such logs"
    )


def told_duties(recording: Recording) -> bool:
    """Whether its wheels are told shares of what motors can do, which are no speeds whatever numbers they are in."""
    return set(DUTIES) <= set(signals(recording))


def tells_way(recording: Recording) -> list[str]:
    """The channels of wheels that stand for a place where none was recorded."""
    return [name for name in ("wheel_speed", "wheel_angle") if recording.has(name)]


def _known_way(wheels: Wheels, unit: str, recording: Recording, channel: Channel) -> float:
    way = wheels.way(unit)
    if not way > 0.0:
        needed = (
            "wheel_radius (m)" if unit.startswith("rad") else "wheel_radius (m) and counts_per_turn (of its encoder)"
        )
        said = f"in {unit}" if unit else "without a unit"
        raise RecordingError(
            f"recording '{recording.name}': '{channel.name}' of left and right wheel is {said}; add {needed} to [vehicle] in "
            "the robot's file, or say the unit in the mapping"
        )
    return way


def _rolled(recording: Recording, wheels: Wheels) -> tuple[Channel, ...]:
    """Speed (m/s) and turn rate (rad/s) of measured wheels; nothing where none were."""
    if recording.has("wheel_speed") and (recording.channel("wheel_speed").unit or not recording.has("wheel_angle")):
        source = recording.channel("wheel_speed").select(SIDES)
        rates = source.values
    elif recording.has("wheel_angle"):
        source = recording.channel("wheel_angle").select(SIDES)
        angles = source.values if source.unit else np.stack([unwrapped(v) for v in source.values.T], axis=1)
        rates = np.gradient(angles, source.time, axis=0) if len(source.time) > 1 else np.zeros_like(angles)
    else:
        return ()
    left, right = (_known_way(wheels, source.unit, recording, source) * rates).T
    speed, turn = 0.5 * (left + right), (right - left) / wheels.track
    return (
        Channel("speed", ("speed",), "m/s", source.time, speed[:, None]),
        Channel("yaw_rate", ("yaw_rate",), "rad/s", source.time, turn[:, None]),
    )


def unwrapped(counts: Array) -> Array:
    """(T,) what a counter that begins anew when it is full has counted."""
    known = np.isfinite(counts)
    most = np.abs(np.diff(counts[known])).max(initial=0.0)
    wraps = next((w for w in COUNTS if 0.5 * w < most <= w and np.ptp(counts[known]) <= w), None)
    return counts if wraps is None else unwound(counts, wraps)
