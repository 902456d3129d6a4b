# SPDX-License-Identifier: Apache-2.0
"""Stretches in which the drives had let go, as after an emergency stop: no joint follows its command.

A servo that is on pulls its joint to its command. Where it is too slow or too weak for that, its joint is on its way, or
rests as if before a wall while the other joints follow; all joints stray at once where nothing drives them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Mask
from trueup.inspection.pauses import parted
from trueup.inspection.stamps import Gap
from trueup.inspection.zeros import FAR, SETTLES
from trueup.noise import UNUSUAL
from trueup.recording import Recording
from trueup.samples import MOSTLY, stretches_of
from trueup.trial import command_of, shared_joints

LONG = SETTLES
"""s: half of it before and behind is left out too, since it shows late that
nothing pulls, and a drive that is switched on again begins with a jerk."""


@dataclass(frozen=True, eq=False)
class _Apart:
    """How far joints of a recording are beside their commands."""

    time: Array
    """(T,) in s."""
    joints: tuple[str, ...]
    position: Array
    """(T, k) rad or m."""
    commands: Array
    """(T, k) the commands in force then."""

    @property
    def apart(self) -> Array:
        """(T, k) position less command."""
        return self.position - self.commands


def without_released(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings in parts between stretches in which the drives had let go, and notes; the others are the same objects."""
    apart = {r: a for r in recordings if (a := _apart(r)) is not None}
    usual = _usual(list(apart.values()))

    def released(recording: Recording) -> list[Gap]:
        own = apart.get(recording)
        return [] if own is None else _released(own, np.array([usual[j] for j in own.joints]))

    def note(recording: Recording, gaps: Sequence[Gap], spans: str, parts: str) -> str:
        return (
            f"in '{recording.name}' no joint follows its command ({spans}; {_furthest(apart[recording], gaps, usual)}): "
            "the drives had let go, as after an emergency stop. That is left out, and it is replayed as "
            f"{parts}, each from where the robot was measured to be"
        )

    return parted(recordings, released, note)


def _apart(recording: Recording) -> _Apart | None:
    """None where no joint has a position and a command of one unit."""
    command, position = command_of(recording), recording.channels.get("position")
    if command is None or position is None:
        return None
    joints = shared_joints(command, position)
    if not joints:
        return None
    told, there = command.select(joints).at(position.time, hold=True), position.select(joints).values
    good = np.isfinite(told).all(axis=1) & np.isfinite(there).all(axis=1)
    return _Apart(position.time[good], joints, there[good], told[good]) if np.count_nonzero(good) > 2 else None


def _usual(every: Sequence[_Apart]) -> dict[str, float]:
    """How far each joint is beside its command, in the median over all recordings."""
    by: dict[str, list[Array]] = {}
    for one in every:
        for joint, column in zip(one.joints, np.abs(one.apart).T, strict=True):
            by.setdefault(joint, []).append(column)
    return {joint: float(np.median(np.concatenate(columns))) for joint, columns in by.items()}


def _released(one: _Apart, usual: Array) -> list[Gap]:
    """Where the drives had let go, with what hangs on that before and behind; `usual` (k,) as `_usual`."""
    far: Mask = np.any(_stuck(one, np.maximum(FAR, UNUSUAL * usual)), axis=1)
    stuck = _runs(far, one.time)
    if not stuck or far.all():
        return []
    near = np.quantile(np.abs(one.apart[~far]), MOSTLY, axis=0)
    close: Mask = np.all(np.abs(one.apart) <= np.maximum(near, usual), axis=1)
    spans: list[tuple[int, int]] = []
    for first, last in stuck:
        before, after = np.flatnonzero(close[:first]), np.flatnonzero(close[last:])
        span = int(before[-1]) if len(before) else 0, last + int(after[0]) if len(after) else len(one.time) - 1
        if not spans or span[0] > spans[-1][1]:
            spans.append(span)
    outside = np.ones(len(one.time), dtype=bool)
    for begin, end in spans:
        outside[begin : end + 1] = False
    follows = np.abs(one.apart[outside]).max(axis=0, initial=0.0)
    gaps = [(one.time[a] - 0.5 * LONG, one.time[b] + 0.5 * LONG) for a, b in spans if _let_go(one, a, b, follows)]
    return [Gap(max(float(one.time[0]), float(a)), float(b - max(one.time[0], a))) for a, b in gaps]


def _stuck(one: _Apart, far: Array) -> Mask:
    """(T, k) whether a joint is far beside its command and not on its way there."""
    window = 0.2 * LONG
    later = np.minimum(np.searchsorted(one.time, one.time + window), len(one.time) - 1)
    earlier = np.maximum(np.searchsorted(one.time, one.time - window), 0)
    towards = (one.position[later] - one.position[earlier]) * -np.sign(one.apart)
    # A joint that needs more than ten times as long as servos settle in is not on its way.
    return (np.abs(one.apart) > far) & (towards < np.abs(one.apart) * 2.0 * window / (10.0 * LONG))


def _runs(mask: Mask, time: Array) -> list[tuple[int, int]]:
    """First and last of the samples of each stretch that lasts long enough."""
    return [(int(a), int(b) - 1) for a, b in stretches_of(mask) if time[b - 1] - time[a] >= LONG]


def _let_go(one: _Apart, begin: int, end: int, follows: Array) -> bool:
    """Whether all joints that were told to move strayed, and another left its command by itself where fewer than two were.

    `follows` (k,): how far joints are beside their commands elsewhere, at most.
    """
    there, told = one.position[begin : end + 1], one.commands[begin : end + 1]
    strayed: Mask = np.any(np.abs(there - told) > follows, axis=0)
    asked = np.ptp(told, axis=0) > 2.0 * follows  # so far that it shows whether they followed
    if not strayed[asked].all() or np.count_nonzero(strayed) < 2:
        return False
    away = np.diff(there, axis=0) * np.sign(there - told)[1:]
    left = np.where(away > 0.0, away, 0.0).sum(axis=0) - np.abs(np.diff(told, axis=0)).sum(axis=0)
    return bool(np.count_nonzero(asked) > 1 or (left > FAR)[~asked].any())


def _furthest(one: _Apart, found: Sequence[Gap], usual: dict[str, float]) -> str:
    """The joint that strayed furthest, in words."""
    inside = np.any([(one.time >= g.start) & (one.time <= g.start + g.duration) for g in found], axis=0)
    most = np.abs(one.apart[inside]).max(axis=0)
    k = int(np.argmax(most))
    return f"{one.joints[k]} is up to {most[k]:.3g} rad or m beside it, elsewhere {usual[one.joints[k]]:.2g}"
