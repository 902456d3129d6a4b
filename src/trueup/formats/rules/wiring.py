# SPDX-License-Identifier: Apache-2.0
"""Which pair of columns drives two wheels, which of them is which, and which way each counts: as the robot moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from trueup.arrays import Array
from trueup.formats.mapping import TimeColumn
from trueup.formats.rules.leading import ahead, along, lateness, turning
from trueup.formats.rules.rule import Part
from trueup.formats.rules.sizes import instants_of, usable
from trueup.formats.rules.vehicles import Signal
from trueup.formats.rules.wheels import Pair, in_pulses
from trueup.inspection.alignment import averaged
from trueup.inspection.relations import ALIKE, rate
from trueup.instant import usual_step
from trueup.recording import Channel
from trueup.samples import correlation
from trueup.tracking.wheels import SIDES
from trueup.units import AS_FAR, PULSE_FULL, PULSE_MIDDLE


@dataclass(frozen=True)
class Driven:
    """The pair that drives a robot, left before right as the robot moved, with what is to be said."""

    command: Pair
    sign: tuple[float, float]
    """-1 for a wheel whose command counts backwards."""
    notes: tuple[str, ...]


def measured(found: Sequence[Pair], command: Pair | None = None) -> dict[str, Pair]:
    """Channel to the first pair that was measured: `wheel_speed`, and `wheel_angle` for what adds up."""
    channels, taken = {"wheel_speed": "speed", "wheel_angle": "travel"}, set(command.every if command else ())
    return {
        channel: pair for channel, kind in channels.items()
        if (pair := next((p for p in found if p.kind == kind and not p.commanded and not taken & set(p.columns)), None))
    }  # fmt: skip


def commanded(
    found: Sequence[Pair], place: Sequence[Signal], heading: Sequence[Signal], time: TimeColumn
) -> Driven | None:
    """What drives two wheels; None where nothing does, or where neither a place nor a word says that they are wheels.

    A pair that no word calls a command is one where the motion follows it. Where no name says a side, the motion must.
    """
    moved = along(place, time)
    told = next((p for p in found if p.commanded and p.kind != "travel"), None)
    said: tuple[str, ...] = ()
    if told is None and moved is not None:
        for pair in (p for p in found if p.kind == "speed" and not p.measured):
            late = lateness(pair.columns[0], np.abs(_sum(pair)), moved, time)
            if late is not None and late > 0.5 * usual_step(moved.time):
                told = pair
                said = (
                    f"{_names(pair)}: taken for what was commanded, since the motion follows {1e3 * late:.0f} ms behind and "
                    "nothing else says so; if this was measured, name in [channels.command] what was commanded",
                )  # fmt: skip
                break
    if told is None or not (place or any(p.of_wheels for p in (told, *measured(found, told).values()))):
        return None
    wired = _wired(told, moved, ahead(place, heading, time), turning(heading, time), time)
    if wired is None:
        return None
    pair, sign = wired
    if not told.sided:
        said += (f"{_names(pair)}: taken as left and right, as the robot turned",)
    elif pair is not told:
        said += (
            f"{_names(told)}: the robot turns as if left and right were mixed up; {pair.columns[0].name} taken as the left",
        )
    back = [c.name for c, s in zip(pair.columns, sign, strict=True) if s < 0.0]
    said += tuple(f"{name}: counts backwards while the robot drives on, taken with sign -1" for name in back)
    return Driven(pair, sign, said)


def _names(pair: Pair) -> str:
    return " and ".join(c.name for c in pair.columns)


def _sum(pair: Pair) -> Array:
    """(T,) both wheels' numbers added up, pulses from their middle."""
    left, right = _centred(pair)
    return left + right


def _difference(pair: Pair) -> Array:
    """(T,) by how much the right wheel's numbers are larger than the left one's."""
    left, right = _centred(pair)
    return right - left


def _centred(pair: Pair) -> tuple[Array, Array]:
    middle = PULSE_MIDDLE if in_pulses(pair) else 0.0
    left, right = (c.values - middle for c in pair.columns)
    return left, right


def _wired(
    pair: Pair, moved: Channel | None, forward: Channel | None, turned: Channel | None, time: TimeColumn
) -> tuple[Pair, tuple[float, float]] | None:
    """The pair, left before right, and 1 for wheels that count up while the robot drives on, -1 for others.

    Without `forward` (a heading that points where the robot drives) two wheels that only differ in their side are not told
    apart, nor forwards from backwards. None where the names say no sides and the motion does not either.
    """
    plain = (1.0, 1.0)
    if moved is None or turned is None:
        return (pair, plain) if pair.sided else None
    if not pair.sided and (forward is None or not _as_much(pair, forward, turned, time)):
        return None
    both, difference = _sum(pair), _difference(pair)
    if forward is None:
        straight = _together(pair, np.abs(both), moved, time) + abs(_together(pair, difference, turned, time))
        mirrored = _together(pair, np.abs(difference), moved, time) + abs(_together(pair, both, turned, time))
        if mirrored < straight + ALIKE:
            return pair, plain
        return pair, ((1.0, -1.0) if _together(pair, both, turned, time) < 0.0 else (-1.0, 1.0))
    signs = list(product((1.0, -1.0), (1.0, -1.0)))
    on = {s: s[1] * _together(pair, both if s[0] == s[1] else difference, forward, time) for s in signs}
    to_the_left = {s: s[1] * _together(pair, difference if s[0] == s[1] else both, turned, time) for s in signs}
    swapped = pair.swapped
    # With the columns the other way round, the difference of both is its opposite and the signs change places.
    scores = {(False, s): on[s] + to_the_left[s] for s in signs}
    scores |= {(True, (s[1], s[0])): on[s] - to_the_left[s] for s in signs}
    best = max(scores, key=lambda k: scores[k])
    least = scores[False, plain] if pair.sided else ALIKE
    if scores[best] < least + ALIKE:
        return (pair, plain) if pair.sided else None
    return (swapped if best[0] else pair), best[1]


def _as_much(pair: Pair, forward: Channel, turned: Channel, time: TimeColumn) -> bool:
    """Whether both columns (T,) move the robot about as much as one another, on and round: a speed and a steering do not."""
    instants = instants_of(pair.columns[0], time)
    one, other = (c.values for c in pair.columns)
    if len(instants) != len(one) or len(instants) != len(other):
        return False
    good = usable(instants, one, other)
    if np.count_nonzero(good) < 20:
        return False
    told = [averaged(instants[good], values[good]) for values in (one, other)]
    columns = np.concatenate([c.values - c.values.mean() for c in told], axis=1)
    for motion in (forward, turned):
        shown = np.interp(told[0].time, motion.time, motion.values[:, 0])
        shares = np.abs(np.linalg.lstsq(columns, shown - shown.mean(), rcond=None)[0])
        if AS_FAR * shares.min() < shares.max():  # one is something else than a wheel
            return False
    return True


def _together(pair: Pair, values: Array, motion: Channel, time: TimeColumn) -> float:
    """Correlation of (T,) values with a motion that follows soon, both smoothed."""
    instants = instants_of(pair.columns[0], time)
    good = usable(instants, values) if len(instants) == len(values) else np.zeros(0, dtype=bool)
    if np.count_nonzero(good) < 20:
        return 0.0
    told = averaged(instants[good], values[good])
    return correlation(told.values[:, 0], np.interp(told.time, motion.time, motion.values[:, 0]))


def turned_round(seen: Pair, command: Pair, sign: tuple[float, float], time: TimeColumn) -> tuple[float, float]:
    """(2,) -1 for measured wheels that count down while their own command, times its sign, counts up."""
    signs = []
    for column, told, way in zip(seen.columns, command.columns, sign, strict=True):
        instants, asked = instants_of(column, time), instants_of(told, time)
        good = usable(instants, column.values) if len(instants) == len(column.values) else np.zeros(0, dtype=bool)
        known = usable(asked, told.values) if len(asked) == len(told.values) else np.zeros(0, dtype=bool)
        if min(np.count_nonzero(good), np.count_nonzero(known)) < 20:
            return 1.0, 1.0
        when, values = instants[good], column.values[good]
        if seen.kind == "travel":
            when, values = rate(values, when)
        shown, held = averaged(when, values), averaged(asked[known], way * told.values[known])
        likeness = correlation(shown.values[:, 0], np.interp(shown.time, held.time, held.values[:, 0]))
        signs.append(-1.0 if likeness < -ALIKE else 1.0)
    return signs[0], signs[1]


def part(channel: str, pair: Pair, sign: tuple[float, float] = (1.0, 1.0), said: tuple[str, ...] = ()) -> Part:
    """The channel of a left and a right wheel, and what they were taken for."""
    pulses = in_pulses(pair) and channel == "command"
    scale = tuple(s * (1.0 / PULSE_FULL if pulses else pair.scale) for s in sign)
    offset = tuple(-s * PULSE_MIDDLE / PULSE_FULL for s in sign) if pulses else (0.0,)
    names, unit = " and ".join(c.name for c in pair.columns), f"in {pair.unit}" if pair.unit else "unit unknown"
    told = "the way driven will tell what they are"
    told = "shares of what motors can do, in these numbers" if pair.duty else told
    open_ = {
        "command": "the middle of a servo's pulse counts as zero" if pulses else told,
        "wheel_speed": "taken as counts a second where the robot's file has counts_per_turn",
        "wheel_angle": "taken as counts where the robot's file has counts_per_turn",
    }
    more = unit if pair.unit else f"{unit}: {open_[channel]}"
    note = f"{channel}: {names} taken as a left and a right driven wheel, {more}"
    said = (*said, *(f"{c.name}: counts against its command, taken with sign -1"
                     for c, s in zip(pair.columns, sign, strict=True) if s < 0.0 and channel != "command"))  # fmt: skip
    columns, labels = (pair.every, pair.every_label) if channel == "command" else (pair.columns, pair.labels)
    if len(columns) > len(SIDES):
        said = (*said, f"{', '.join(c.name for c in columns[2:])}: further wheels of the same sides")
    short = scale * (len(columns) // len(SIDES)) if len(set(scale)) > 1 else scale[:1]
    offset = offset * (len(columns) // len(SIDES)) if any(offset) else offset
    return Part(channel, columns, labels, pair.unit, short, (note, *said), (), offset)
