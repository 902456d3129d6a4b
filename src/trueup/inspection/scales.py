# SPDX-License-Identifier: Apache-2.0
"""Positions whose unit nobody said: what they are, told from how far the joints of the model can move."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.inspection.zeros import FAR
from trueup.noise import estimate_grid
from trueup.recording import Channel, Recording
from trueup.trial import COMMANDS
from trueup.units import hardly_radians, numbers_of, size_of

_LINEAR = {"rad": "m", "rad/s": "m/s", "N m": "N"}
_HARDLY = 3.0
"""Numbers that a joint spans which moves in rad; in degrees it hardly moves."""
_STILL = 0.1
"""Numbers that a joint spans which stands still, in either unit."""
BESIDE = 0.1
"""Of its range (or of shares of it) that a slide may be measured beyond its ends."""
OTHER_UNIT = math.sqrt(numbers_of("deg"))
"""Times as large from which on numbers are rather degrees beside rad than both in one unit, by the logarithm: joints that
follow, and steps of a robot's encoders, differ by less, counts of a turn by more."""
_FREE = math.tau  # rad: as far as joints without a range are taken to turn


@dataclass(frozen=True)
class Way:
    """How a joint of a model moves, and between which positions, in rad or m; none where it has no range."""

    slides: bool
    range: tuple[float, float] | None
    of: tuple[str, ...] = ()
    """Of a drive that moves several joints: these, in whose unit it is commanded."""

    @property
    def ends(self) -> tuple[float, float]:
        """Its range, or as far as joints without one are taken to turn."""
        return self.range or (-_FREE, _FREE)


def with_units(joints: Mapping[str, Way], recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings whose positions and commands, where they have no unit, are in rad, and notes on what was assumed.

    Degrees, where all measured positions then lie in the ranges of the model's `joints`; else nothing is changed. Slides that
    only as mm lie in theirs are in m then.
    """
    without = [r for r in recordings if r.has("position") and not r.channel("position").unit]
    if not without:
        return list(recordings), []
    short, said = _in_millimetres(joints, without)
    short += [drive for drive, way in joints.items() if way.of and set(way.of) <= set(short)]
    # Beyond that only slides reach (openings, travels), and what turns on and on: wheels.
    if not _beyond_turns(joints, without) or _wheels_alone(joints, without):
        return [_in_rad(joints, r, 1.0, short) if r in without else r for r in recordings], said
    degree = size_of("deg")
    if not all(within(joints, r.channel("position"), degree) for r in without):
        return list(recordings), []
    names = ", ".join(r.name for r in without)
    note = (
        f"positions without a unit are taken as degrees, which fits the joints' ranges ({names}); if they are percent "
        'of a range (LeRobot\'s -100 ... 100), give unit = "rad" with scale and offset in the mapping'
        f"{_of_two_units(joints, without)}"
    )
    return [_in_rad(joints, r, degree, short) if r in without else r for r in recordings], [note, *said]


def _beyond_turns(joints: Mapping[str, Way], recordings: Sequence[Recording], *, limited: bool = False) -> bool:
    """Whether hinges go further than angles in rad do; of those alone that are `limited` by a range."""
    free = [j for j, way in joints.items() if way.range is None] if limited else []
    turned = [np.abs(_hinges(joints, r.channel("position"), free)).ravel() for r in recordings]
    return hardly_radians(float(np.nanmax(np.concatenate(turned), initial=0.0)))


def _wheels_alone(joints: Mapping[str, Way], recordings: Sequence[Recording]) -> bool:
    """Whether none but joints without a range go further, beside others that stay in theirs in rad."""
    ranges = {j: way for j, way in joints.items() if way.range is not None and not way.slides}
    beside = all(set(ranges) & set(r.channel("position").labels) for r in recordings)
    stay = all(within(ranges, r.channel("position"), 1.0) for r in recordings)
    return beside and stay and not _beyond_turns(joints, recordings, limited=True)


def _in_millimetres(joints: Mapping[str, Way], recordings: Sequence[Recording]) -> tuple[list[str], list[str]]:
    """Slides whose numbers lie in their ranges as mm and not as m, and a note. What might as well be shares of a range, as of
    a gripper, is in mm only beside a slide that cannot be.
    """
    slides = [j for j, way in joints.items() if way.slides and way.range is not None]
    short = [j for j in slides if len(v := unsaid(recordings, j)) and beyond(joints[j], v) and inside(joints[j], v)]
    if set(short) <= shares({j: joints[j] for j in slides}, recordings).keys():
        return [], []
    return short, [
        f"positions without a unit of {', '.join(short)} are taken as mm, which fits the range in the model; if they are "
        "anything else (percent of the way), say so in units, or in scale, one for each label, in the mapping"
    ]


def unsaid(recordings: Sequence[Recording], slide: str, channels: Sequence[str] = ("position",)) -> Array:
    """Positions of a slide of which nobody said that they are lengths."""
    every = [c.column(slide) for r in recordings for c in map(r.channels.get, channels)
             if c is not None and slide in c.labels and c.unit_of(slide) != "m"]  # fmt: skip
    values = np.concatenate(every) if every else np.zeros(0)
    return values[np.isfinite(values)]


def beyond(way: Way, metres: Array) -> bool:
    """Whether a slide was measured further beyond its range than that is long."""
    (low, high), whole = way.ends, way.ends[1] - way.ends[0]
    return bool(metres.min() < low - whole or metres.max() > high + whole)


def inside(way: Way, numbers: Array) -> bool:
    """Whether a slide stays in its range, the numbers taken as mm."""
    (low, high), metres = way.ends, numbers * size_of("mm")
    beside = BESIDE * (high - low)
    return bool(metres.min() >= low - beside and metres.max() <= high + beside)


def _of_two_units(joints: Mapping[str, Way], recordings: Sequence[Recording]) -> str:
    """What to mind of numbers that are degrees of some joints, and of others rather rad: as large as rad are, and on a grid
    that no encoder has in degrees beside the others.
    """
    labels = [j for j in recordings[0].channel("position").labels if j in joints and not joints[j].slides]
    every = {j: np.concatenate([r.channel("position").column(j) for r in recordings if j in r.channel("position").labels])
             for j in labels}  # fmt: skip
    grids = {j: estimate_grid(values) for j, values in every.items()}
    turned = [j for j, values in every.items() if hardly_radians(float(np.nanmax(np.abs(values))))]
    finest = min((g for j in turned if (g := grids[j]) is not None), default=None)
    small = [j for j, values in every.items() if j not in turned and _rad_sized(joints[j], values)]
    if finest is not None:  # encoders differ, but hardly by what degrees and rad do
        small = [j for j in small if (g := grids[j]) is None or not finest / OTHER_UNIT < g < finest * OTHER_UNIT]
    if not small:
        return ""
    units = ", ".join('"rad"' if j in small else '"deg"' for j in labels)
    return (
        f". {', '.join(small)} would then hardly move, by less than {_HARDLY:g} degrees: if these are rad, beside degrees of "
        f"{', '.join(turned)}, say units = [{units}] in place of unit for position, and for command"
    )


def _rad_sized(way: Way, values: Array) -> bool:
    """Whether a joint that moves stays within its range in rad, and would hardly move in degrees."""
    span = float(np.nanmax(values) - np.nanmin(values))
    in_range = way.ends[0] - FAR <= np.nanmin(values) and np.nanmax(values) <= way.ends[1] + FAR
    return bool(in_range and _STILL < span < _HARDLY)


def _hinges(joints: Mapping[str, Way], channel: Channel, but: Sequence[str] = ()) -> Array:
    """(T, k) the columns of hinges, and of whatever is not in the model, `but` some."""
    others = {*but, *(j for j, way in joints.items() if way.slides)}
    return channel.values[:, [i for i, label in enumerate(channel.labels) if label not in others]]


def of_slides(joints: Mapping[str, Way], recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings whose positions and commands of slides are said to be in m (N for forces), beside hinges in rad.

    Openings of grippers that are logged as shares (0 ... 1) or percent of the way become lengths; notes say which.
    """
    slides = [j for j, way in joints.items() if way.slides]
    taken = shares({label: joints[label] for label in slides}, recordings)
    result = []
    for recording in recordings:
        for channel in recording.channels.values():
            if channel.unit in _LINEAR and set(slides) & set(channel.labels):
                recording = recording.with_channel(_in_metres(joints, channel, slides, taken))
        result.append(recording)
    note = (
        f"taken as shares of their joints' ranges, since they reach far beyond them: {', '.join(taken)}; say so if they are "
        "anything else"
    )
    return result, [note] if taken else []


def shares(slides: Mapping[str, Way], recordings: Sequence[Recording]) -> dict[str, float]:
    """What the whole way of each slide is that was logged as shares of it; of drives that move several, by their commands."""
    found = {label: whole for label, way in slides.items() if (whole := _share(way, recordings, label))}
    for drive in [label for label in found if slides[label].of]:
        low, high = slides[drive].ends
        for joint in slides[drive].of:  # all of its way is all of theirs, whatever a unit of it moves
            if joint in slides and _far_beyond(slides[joint], unsaid(recordings, joint)):
                found[joint] = found[drive] * (slides[joint].ends[1] - slides[joint].ends[0]) / (high - low)
    return found


def _far_beyond(way: Way, values: Array) -> bool:
    """Whether positions of a slide are no lengths in m."""
    return bool(values.size) and float(values.max()) > 2.0 * max(abs(end) for end in way.ends)


def _share(way: Way, recordings: Sequence[Recording], slide: str) -> float:
    """What the whole way of a slide is in its positions, 1 or 100; 0 where these are lengths, in mm too, or neither."""
    values = unsaid(recordings, slide, COMMANDS[:2] if way.of else ("position",))
    if way.range is None or not _far_beyond(way, values):
        return 0.0
    largest = float(values.max())
    for whole in (1.0, 100.0):
        if whole == 100.0 and inside(way, values) and way.ends[1] - way.ends[0] < whole * size_of("mm"):
            return 0.0  # either fits; as mm it goes through more of its way, and people open and close grippers
        beside = BESIDE * whole
        if largest <= whole + beside and values.min() >= -beside and (whole == 1.0 or largest > 2.0):
            return whole
    return 0.0


def _in_metres(
    joints: Mapping[str, Way], channel: Channel, slides: Sequence[str], wholes: Mapping[str, float]
) -> Channel:
    values = np.array(channel.values)
    for column, label in enumerate(channel.labels):
        if label in wholes and channel.unit_of(label) == "rad":
            lower, upper = joints[label].ends
            values[:, column] = lower + (upper - lower) * values[:, column] / wholes[label]
    units = tuple(_LINEAR[channel.unit] if label in slides else channel.unit for label in channel.labels)
    if len(set(units)) == 1:
        return channel.replace(unit=units[0], values=values)
    return channel.replace(units=units, values=values)


def within(joints: Mapping[str, Way], channel: Channel, factor: float) -> bool:
    """Whether every joint that the model has stays in its range, where one of the numbers is `factor` rad."""
    hinges = [label for label in channel.labels if label in joints and not joints[label].slides]
    limited = [label for label in hinges if joints[label].range is not None]  # others may turn on and on
    ranges = {label: joints[label].ends for label in limited or hinges}
    for label, (lower, upper) in ranges.items():
        column = channel.column(label) * factor
        column = column[np.isfinite(column)]
        if len(column) and (column.min() < lower - FAR or column.max() > upper + FAR):
            return False
    return bool(ranges)


def _in_rad(joints: Mapping[str, Way], recording: Recording, factor: float, short: Sequence[str]) -> Recording:
    """Hinges times `factor`, slides that are `short` from mm to m; other slides as they are."""
    factors = {j: 1.0 for j, way in joints.items() if way.slides} | dict.fromkeys(short, size_of("mm"))
    speeds = ("velocity", *(name for name in COMMANDS if name.endswith("velocity")))
    for name, unit in (("position", "rad"), *((c, "rad") for c in COMMANDS[:2]), *((c, "rad/s") for c in speeds)):
        if recording.has(name) and not (channel := recording.channel(name)).unit:
            values = channel.values * np.array([factors.get(label, factor) for label in channel.labels])
            units = tuple(known or unit for known in channel.units)
            recording = recording.with_channel(channel.replace(unit=unit, units=units, values=values))
    return recording
