# SPDX-License-Identifier: Apache-2.0
"""Units and signs that cannot be right, told from the size of numbers and from how channels fit together."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from trueup.arrays import Mask
from trueup.inspection.relations import factor, nearest, rate
from trueup.inspection.spikes import lone_spikes
from trueup.inspection.turns import turning_on
from trueup.recording import Channel, Recording
from trueup.units import FURTHEST_TURN, hardly_radians, numbers_of, size_of

_LIMITS = {
    "position": ("rad", FURTHEST_TURN, "degrees", "deg"),
    "command": ("rad", FURTHEST_TURN, "degrees", "deg"),
    "command_sent": ("rad", FURTHEST_TURN, "degrees", "deg"),
    "velocity": ("rad/s", 60.0, "degrees per second (or rpm)", "deg/s"),
    "current": ("A", 60.0, "milliamperes", "mA"),
    "torque": ("N m", 5e3, "thousandths of a newton metre", "mN m"),
}
"""Channel to a unit, the largest that joints reach in it, and what is suspected beyond, in words and as a unit."""
_TURNED = "{a} has the other sign than {b}"
_A_DEGREES, _B_DEGREES = "{a} is in degrees and {b} in radians", "{a} is in radians and {b} in degrees"
_RATIOS = {
    _A_DEGREES: numbers_of("deg"),
    _B_DEGREES: size_of("deg"),
    "{a} is in revolutions per minute and {b} in radians": numbers_of("rpm"),
    "{a} is in revolutions and {b} in radians": numbers_of("rev"),
    "{a} is in radians and {b} in revolutions": size_of("rev"),
    "{a} is in thousandths of the unit of {b}": numbers_of("permille"),
    "{b} is in thousandths of the unit of {a}": size_of("permille"),
    _TURNED: -1.0,
}
_VEHICLES = frozenset(
    {"throttle", "speed", "steering", "turn", "x", "latitude", "left", "right", "left_duty", "right_duty"}
)  # commands and places are no angles


def suspicions(recording: Recording) -> Iterator[str]:
    """Sentences about units and signs that cannot be right, and what to write into the mapping."""
    yield from _too_large(recording)
    yield from _unsigned(recording)
    yield from _whole(recording)
    yield from _sign_bits(recording)
    yield from _ratios(recording)
    plain, spikes = lone_spikes(recording) if _of_joints(recording) else (recording, "")
    if spikes:
        yield spikes
    yield from _wraps(plain)


def _of_joints(recording: Recording) -> bool:
    """Whether positions are those of joints: what has a vehicle's labels is commanded to positions in the same unit, then."""
    position, command = (recording.channels.get(name) for name in ("position", "command"))
    if position is None or not _VEHICLES & set(position.labels):
        return position is not None
    return command is not None and command.labels == position.labels and command.unit == position.unit != ""


def _too_large(recording: Recording) -> Iterator[str]:
    for name, (unit, limit, suspected, written) in _LIMITS.items():
        channel = recording.channels.get(name)
        if channel is None or channel.unit not in (unit, "") or _VEHICLES & set(channel.labels):
            continue
        sizes = np.where(np.isnan(channel.values), 0.0, np.abs(channel.values)).max(axis=0)
        if unit == "rad":  # wheels turn on and on; that these are rad is said then
            sizes[[channel.unit_of(label) == unit and "wheel" in label.casefold() for label in channel.labels]] = 0.0
        if sizes.max() <= limit:
            continue
        worst = int(np.argmax(sizes))
        reached = f"{sizes[worst]:.4g} {channel.unit}".rstrip()
        if name.startswith("command") and not channel.unit:
            suspected = "percent of a range, pulses or degrees"
        geared = ", or the angle of a motor before its gear" if unit == "rad" else ""
        counted = ""
        if unit == "rad" and not channel.unit and not np.any(np.nan_to_num(channel.values) % 1.0):
            suspected, counted = f"counts of an encoder, {suspected}", ", with scale and offset for counts"
        yield (
            f"{name}: {channel.labels[worst]} reaches {reached}: {suspected} suspected{geared}. "
            f'If so, set unit = "{written}" in the mapping{counted}'
        )


def _unsigned(recording: Recording) -> Iterator[str]:
    """A torque or current without sign, though the joint moves both ways."""
    velocity = recording.channels.get("velocity")
    for name in ("torque", "current", "load"):
        channel = recording.channels.get(name)
        if channel is None or velocity is None:
            continue
        lowest, highest = np.fmin.reduce(channel.values, axis=None), np.fmax.reduce(channel.values, axis=None)
        moving = [label for label in channel.labels if label in velocity.labels and _both_ways(velocity, label)]
        # One joint that carries a load may well need torque of one sign only; several hardly do.
        if len(channel.labels) > 1 and moving and lowest >= 0.0 and highest > 0.0:
            yield (
                f"{name}: no value is ever negative though joints move both ways ({', '.join(moving)}), so this seems "
                "to be a size without a sign. Do not fit it as it stands"
            )


def _whole(recording: Recording) -> Iterator[str]:
    """Torques that are whole numbers: ROS drivers of servos give their load, or a current, as an effort."""
    several = 10  # a signal with fewer distinct values is a switch, or an example
    torque = recording.channels.get("torque")
    if torque is None or torque.unit != "N m":
        return
    known = np.unique(torque.values[np.isfinite(torque.values)])
    if len(known) > several and bool(np.all(known == np.round(known))):
        yield (
            f"torque: nothing but whole numbers, which reach {np.abs(known).max():g}: hardly N m, but the load of servos in "
            "percent, or a current in mA? Call the channel load, or current, in the mapping"
        )


def _sign_bits(recording: Recording) -> Iterator[str]:
    """Whole numbers of which a bit is the direction: they jump by about that bit from where they are small."""
    for name, bit in ((name, bit) for name in ("load", "torque", "current", "velocity") for bit in (1024.0, 32768.0)):
        channel = recording.channels.get(name)
        if channel is None or channel.unit or np.any(channel.values != np.round(channel.values), where=_known(channel)):
            continue
        low, high = (f(channel.values[:-1], channel.values[1:]) for f in (np.minimum, np.maximum))
        crossing = (low >= 0.0) & (low < bit) & (high >= bit) & (high < 2.0 * bit)
        lowest = np.fmin.reduce(channel.values, axis=None)
        if lowest >= 0.0 and crossing.any() and np.median((low + high - bit)[crossing]) < 0.5 * bit:
            yield (
                f"{name}: whole numbers that jump between 0 and {bit:g}, as of servos that say by a bit which way "
                f"({bit:g} + 5 is -5). Take it out before: x if x < {bit:g} else {bit:g} - x"
            )


def _known(channel: Channel) -> Mask:
    return np.isfinite(channel.values)


def _both_ways(velocity: Channel, label: str) -> bool:
    speed = velocity.column(label)
    return bool(np.mean(speed > 0.0) > 0.1 and np.mean(speed < 0.0) > 0.1)


def at_odds(recordings: Sequence[Recording]) -> list[str]:
    """Notes on joints whose commands, in the unit of the positions, are these times a factor that tells a mistake; what is
    alike in several recordings once.
    """
    found: dict[str, list[str]] = {}
    for recording in recordings:
        position = recording.channels.get("position")
        for name in ("command", "command_sent"):
            channel = recording.channels.get(name)
            if position is not None and channel is not None and channel.unit == position.unit:
                for said in _compare(channel, position, name, "position", False):
                    found.setdefault(said, []).append(recording.name)
    return [f"{said} ({', '.join(names)})" for said, names in found.items()]


def in_another_unit(command: Channel, position: Channel) -> str:
    """What is wrong with positions that go along with their commands, in another unit; '' for none that do.

    Only sizes: where a drive is geared the other way round, its joint turns against its command.
    """
    return next(
        (said for said, kind, _ in _multiples(command, position, "command", "position", False) if kind != _TURNED), ""
    )


def _ratios(recording: Recording) -> Iterator[str]:
    position = recording.channels.get("position")
    if position is None:
        return
    for name in ("command", "command_sent"):
        if name in recording.channels:
            yield from _compare(recording.channels[name], position, recording.channels[name].name, "position", False)
    if "velocity" in recording.channels:
        yield from _compare(recording.channels["velocity"], position, "velocity", "the derivative of position", True)


def _compare(channel: Channel, position: Channel, a: str, b: str, derive: bool) -> Iterator[str]:
    """What to correct where one channel is a known multiple of the other."""
    for said, kind, labels in _multiples(channel, position, a, b, derive):
        yield f"{said}? Correct unit or sign in the mapping{_edit(kind, channel, position, labels)}"


def _multiples(
    channel: Channel, position: Channel, a: str, b: str, derive: bool
) -> Iterator[tuple[str, str, Sequence[str]]]:
    """Whether one channel is a known multiple of the other, joint by joint: in words, which multiple, and of which joints."""
    found = dict[str, list[str]]()
    for label in channel.labels:
        stated = (
            not derive and not channel.unit_of(label) and bool(position.unit_of(label))
        )  # numbers of who knows what
        ratio = _ratio(channel, position, label, derive) if label in position.labels and not stated else None
        sentence = nearest(ratio, _RATIOS) if ratio is not None else ""
        if sentence:
            found.setdefault(sentence, []).append(label)
    for sentence, labels in found.items():
        of = f"{a} of {', '.join(labels)} is about {_RATIOS[sentence]:.3g} times {b}: {sentence.format(a=a, b=b)}"
        yield of, sentence, labels


def _edit(sentence: str, channel: Channel, position: Channel, labels: Sequence[str]) -> str:
    """What to write into the mapping where some joints of a channel differ from its others; nothing where all do."""
    if len(labels) == len(channel.labels):
        return ""
    if sentence == _TURNED:
        signs = ", ".join("-1" if label in labels else "1" for label in channel.labels)
        return f": sign = [{signs}] for one of the two"
    of = {_A_DEGREES: channel, _B_DEGREES: position}.get(sentence)
    if of is None:
        return ""
    units = ", ".join('"deg"' if label in labels else f'"{of.unit_of(label) or "rad"}"' for label in of.labels)
    return f": units = [{units}] for {of.name}, in place of unit"


def _ratio(channel: Channel, position: Channel, label: str, derive: bool) -> float | None:
    """How many times the position (or its derivative) `channel` is; None where they do not go together."""
    reference, time = position.column(label), position.time
    if derive:
        if len(time) < 3:
            return None
        time, reference = rate(reference, time)
    return factor(channel.select([label]).at(time, hold=not derive)[:, 0], reference)


def _wraps(recording: Recording) -> Iterator[str]:
    """Angles that begin anew after a whole turn, in rad, or in degrees where nobody said the unit."""
    position = recording.channels.get("position")
    if position is None or position.unit not in ("rad", "") or _VEHICLES & set(position.labels):
        return
    degrees = not position.unit and hardly_radians(float(np.fmax.reduce(np.abs(position.values), axis=None)))
    turn, said = (360.0, "360") if degrees else (math.tau, "2 pi")
    for label in position.labels:
        known = position.column(label)[np.isfinite(position.column(label))]
        if degrees and (not known.size or float(np.ptp(known)) > float(turn)):
            continue  # counts: angles that begin anew stay within a turn
        names = list(turning_on(recording, (label,), turn, position.unit))
        if "position" in names:
            yield (
                f"{', '.join(sorted(names, reverse=True))}: {label} jumps by {said} between samples, as where encoders wrap; "
                "a joint without limits in the model is taken to go on turning, one with limits to be within them"
            )
        elif names:
            yield f"{', '.join(names)}: {label} is whole turns ({said}) away from its position"
