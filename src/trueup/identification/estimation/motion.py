# SPDX-License-Identifier: Apache-2.0
"""From a recording to the motion of a tree's joints on even instants, and to rows of it that are fitted or judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array, Mask
from trueup.errors import IdentificationError, unknown_name
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.filtering import (
    Lowpass,
    decimated,
    derivative,
    even,
    grid,
    highest_cutoff,
    lowest_rate,
)  # fmt: skip
from trueup.identification.estimation.missing import Gaps, bridged, clear_of, gaps
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.rows import Rows
from trueup.inspection.spikes import without_spikes
from trueup.inspection.turns import unwrapped
from trueup.instant import STILL
from trueup.recording import Channel, Recording, warnings_of

TORQUES = ("torque", "current", "load")
"""Channels that may hold torque, the first one present counts."""
_AHEAD = 4.0
"""Positions are filtered at this many times the cut-off first: it keeps accelerations finite and changes nothing below."""
_RESTING = 0.01
"""Of the top speed: slower samples at either end of a log are standstill."""
_COMPARED = 5.0
"""Samples per second that are compared, over the cut-off."""
_ARRAYS = ("time", "q", "v", "a", "torque")


Torque = Callable[[Array, Array, Array], Array]
"""(S, n) torque at positions, speeds and accelerations (S, n) of a motion in the order of time."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Joint motion on even instants; arrays are (S, n) in rad, rad/s, rad/s^2, N m (m, ..., N)."""

    name: str
    time: Array
    rate: float
    q: Array
    v: Array
    a: Array
    torque: Array
    gaps: Gaps = ()
    """Stretches that the log does not hold."""

    def span(self) -> tuple[float, float]:
        """First and last instant in s of the motion, without standstill at either end, where friction or a brake may hold
        any load; of the log, where nothing moves. Noise of speeds is no motion: it begins with the last rest before a joint
        gets away from where it stood, as it ends.
        """
        begun, ends = (np.flatnonzero(np.abs(self.q - self.q[k]).max(axis=1) > STILL) for k in (0, -1))
        if np.ptp(self.q, axis=0).max() < STILL or not (begun.size and ends.size):
            return float(self.time[0]), float(self.time[-1])
        speed = np.abs(self.v).max(axis=1)
        rests = np.flatnonzero(speed <= _RESTING * float(np.quantile(speed, 0.99)))
        before, after = rests[rests <= begun[0]], rests[rests >= ends[-1]]
        first = int(before[-1]) if before.size else 0
        last = int(after[0]) if after.size else len(speed) - 1
        return float(self.time[first]), float(self.time[last])


@dataclass(frozen=True, eq=False)
class Log:
    """What a recording says of the joints of a tree, before any filter; arrays are (T, n) on even instants."""

    name: str
    time: Array
    rate: float
    position: Array
    velocity: Array | None
    torque: Array
    channel: str
    """The channel that the torque came from: 'torque' or 'current'."""
    units: tuple[str, ...]
    """Of the torque of each joint: N m, N for a slide, or the unit that was logged where its constant is not known."""
    gaps: Gaps = ()
    """Stretches without samples, or without values of a joint."""
    notes: tuple[str, ...] = ()
    """What was done to the log, in words."""

    @property
    def measured(self) -> bool:
        """Whether all torques are in N m (N), measured or by constants that were given."""
        return all(unit.startswith("N") for unit in self.units)

    def motion(self, cutoff: float, *, measured_speed: bool) -> Motion:
        """The motion at about ten times `cutoff` Hz; position and torque have passed the same filter.

        Raises IdentificationError where the log is too short or too slow for the cut-off.
        """
        ahead = min(_AHEAD * cutoff, highest_cutoff(self.rate))
        every = decimated(self.rate, lowest_rate(ahead))  # columns: what nonlinear ones add is filtered away
        passing = Lowpass(self.rate, ahead)
        q, torque = passing(self.position), passing(self.torque)
        v = passing(self.velocity) if measured_speed and self.velocity is not None else derivative(q, self.rate)
        a = derivative(v, self.rate)
        q, v, a, torque = (x[::every] for x in (q, v, a, torque))
        return Motion(self.name, self.time[::every], self.rate / every, q, v, a, torque, self.gaps)


def log_of(recording: Recording, tree: KinematicTree, drives: Drives) -> Log:
    """The log of a tree's joints in a recording, matched by name, geared to the joints.

    Raises UnknownNameError and IdentificationError: no positions or torques, a joint missing, missing samples.
    """
    position = _channel(recording, ("position",))
    source = _channel(recording, TORQUES)
    if not np.all(np.isin(tree.joints, position.labels)) or not np.all(np.isin(tree.joints, source.labels)):
        _name_missing(recording, tree, position, source)
    time, rate = grid(position.time)
    inside = (time >= source.time[0] - 0.5 / rate) & (time <= source.time[-1] + 0.5 / rate)
    if np.count_nonzero(inside) < 20:
        raise IdentificationError(
            f"recording '{recording.name}': positions and {source.name} share {np.count_nonzero(inside)} samples; "
            "their clocks do not fit together, or the log is too short"
        )
    time = time[inside]
    velocity = recording.channels.get("velocity")
    usable = velocity is not None and all(j in velocity.labels for j in tree.joints)
    turning, said = _unwound(position, tree, recording.name)
    notes = [*warnings_of(recording), *said, *_unitless(source, tree, drives)]
    measured = [turning, source, *([velocity] if usable and velocity is not None else [])]
    lost, (places, torques, *speeds) = _sound(measured, tree, time, recording.name, notes)
    return Log(
        recording.name, time, rate, drives.joint_positions(places),
        drives.joint_speeds(speeds[0]) if speeds else None, drives.joint_torques(torques), source.name,
        _units(source, tree, drives), tuple(sorted({*gaps(position.time, source.time), *lost})), tuple(notes),
    )  # fmt: skip


def _sound(
    channels: Sequence[Channel], tree: KinematicTree, time: Array, name: str, notes: list[str]
) -> tuple[Gaps, list[Array]]:
    """Stretches that channels lack, and (T, n) of the tree's joints of each at even instants without spikes; `notes` gets a
    word on what was done.
    """
    lost, found = list[tuple[float, float]](), list[Array]()
    for channel in channels:
        chosen = channel.select(tree.joints)
        values, counts = without_spikes(np.array(chosen.values))
        if counts.any():
            said = ", ".join(f"{joint} {count:.0f}" for joint, count in zip(tree.joints, counts, strict=True) if count)
            notes.append(
                f"recording '{name}': single samples of {channel.name} stand far off their neighbours ({said}); they were "
                "bridged, in what the model is judged by too"
            )
        whole, own, more = bridged(chosen.replace(values=values), name)
        lost += own
        notes += more
        found.append(even(channel.time, whole.values, time))
    return tuple(lost), found


def _units(source: Channel, tree: KinematicTree, drives: Drives) -> tuple[str, ...]:
    logged, known = source.unit or f"units of {source.name}", source.name == "torque"
    return tuple(
        ("N" if slides else "N m") if known or joint in drives.known_constants else logged
        for joint, slides in zip(tree.joints, np.asarray(tree.prismatic).tolist(), strict=True)
    )


def _unitless(source: Channel, tree: KinematicTree, drives: Drives) -> list[str]:
    """What to mind where nothing says in which unit the torque is, or the current that constants make a torque."""
    if source.name == "current" and not source.unit and set(drives.known_constants) & set(tree.joints):
        return [
            "nothing says in which unit current is; it was taken as A, which torque constants are for. If it is not (mA, "
            "counts of a servo), say unit in the mapping, with scale where it is counts"
        ]
    if source.name != "torque" or source.unit or all(joint in drives.known_constants for joint in tree.joints):
        return []
    return [
        "nothing says in which unit torque is; it was taken as N m. If it is not (percent of a rated torque, counts), masses "
        "are not in kg: say unit in the mapping, or how many N m one is as torque_constant of each joint in a drives file "
        "(--drives)"
    ]


def _unwound(position: Channel, tree: KinematicTree, name: str) -> tuple[Channel, tuple[str, ...]]:
    """The positions without the jumps of a turn that endless joints make, and a note."""
    values, found = np.array(position.values), []
    for joint, slides in zip(tree.joints, np.asarray(tree.prismatic).tolist(), strict=True):
        k = position.labels.index(joint)
        on = None if slides else unwrapped(values[:, k])
        if on is not None:
            values[:, k] = on
            found.append(joint)
    if not found:
        return position, ()
    said = f"recording '{name}': {', '.join(found)} jumps by a turn in the log; it was taken as going on"
    return position.replace(values=values), (said,)


def _channel(recording: Recording, names: tuple[str, ...]) -> Channel:
    for name in names:
        if name in recording.channels:
            return recording.channels[name]
    raise IdentificationError(
        f"recording '{recording.name}' has no channel {' or '.join(repr(n) for n in names)}; its channels are: "
        f"{', '.join(recording.channels)}. Say which columns they are in a mapping (`trueup inspect` writes one to edit); "
        "where positions and torques are in two files, give the folder that holds both"
    )


def _name_missing(recording: Recording, tree: KinematicTree, *channels: Channel) -> None:
    for channel in channels:
        for joint in tree.joints:
            if joint not in channel.labels:
                raise unknown_name(
                    "column", joint, channel.labels,
                    f"channel '{channel.name}' of recording '{recording.name}' (a joint of the model; rename columns in "
                    f"the mapping's [joints], lock joints that do not move with --lock, or see `trueup inspect "
                    f"RECORDINGS --model MODEL`, which proposes)",
                )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Piece:
    """A recording, or a part of one, ready to be compared."""

    whole: Motion
    """All of the recording, sampled finely."""
    rows: Rows
    """Filtered, at the instants that are compared."""
    held_out: bool
    lowpass: Lowpass | None
    every: int
    keep: Mask
    """Which of every `every`-th instant of `whole` are compared."""

    @property
    def motion(self) -> Motion:
        """At the instants of `rows`."""
        arrays = {name: getattr(self.whole, name)[:: self.every][self.keep] for name in _ARRAYS}
        return replace(self.whole, **arrays)

    def passed(self, values: Array) -> Array:
        """(S', ...) what is computed at all instants of `whole` (S, ...), through the filter of `rows`, thinned out."""
        return (values if self.lowpass is None else self.lowpass(values))[:: self.every]

    def predicted(self, torque: Torque) -> Array:
        """(S, n) what any model says of this motion, filtered as the torque that was measured."""
        return self.passed(torque(self.whole.q, self.whole.v, self.whole.a))[self.keep]


def pieces_of(motion: Motion, model: DynamicModel, cutoff: float, hold_out: float) -> list[Piece]:
    """The rows of a motion, filtered with its torque, whole or split in two with a gap between.

    Standstill at both ends is left out, and what a filter cannot know or mixes: one period of the cut-off there, around
    gaps, and on both sides of where what is held out begins.
    """
    fewest = 40  # Samples in a piece
    rows = model.rows(motion.time, motion.q, motion.v, motion.a, motion.torque)
    every, lowpass = 1, None
    if cutoff < 0.45 * motion.rate:
        every, lowpass = decimated(motion.rate, _COMPARED * cutoff), Lowpass(motion.rate, cutoff)
        rows = rows.filtered(lowpass, every)
    (start, stop), margin = motion.span(), 1.0 / cutoff
    start, stop = max(start, float(rows.time[0]) + margin), min(stop, float(rows.time[-1]) - margin)
    edge = start + (1.0 - hold_out) * (stop - start)
    known = clear_of(motion.gaps, rows.time, margin)
    keeps = [(known & (rows.time >= start) & (rows.time <= edge), False)]
    if hold_out > 0.0:
        keeps.append((known & (rows.time > edge + 2.0 * margin) & (rows.time <= stop), True))
    if min(np.count_nonzero(keep) for keep, _ in keeps) < fewest:
        raise IdentificationError(
            f"recording '{motion.name}': {max(stop - start, 0.0):.2g} s of motion are too little for a cut-off of "
            f"{cutoff:g} Hz{' and a part held out' if hold_out else ''}"
        )
    return [Piece(motion, rows.part(keep), held, lowpass, every, keep) for keep, held in keeps]
