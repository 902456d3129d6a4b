# SPDX-License-Identifier: Apache-2.0
"""Which way round a recorded heading grows, and from which zero: as the way driven shows it, in recordings together."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array, Integers, Mask
from trueup.evidence import FEWEST_PARTS, STANDARD_ERRORS, evidence
from trueup.recording import Channel, Recording
from trueup.rounding import TINY
from trueup.tracking.heading import SPAN, motion, telling, told_by

_WITHIN = 0.3  # rad: as far as a tracker's frame may be turned on the car without being another convention

_SURE = np.cos(_WITHIN + _WITHIN)
"""Share of the squares of moves that lies along the heading, less that across, of moves that far beside it."""

_ROUNDS = 10
"""Zero and lever arm in turn: each takes what the other leaves."""

Source = tuple[str, ...]
"""Where a heading comes from: recordings that agree on it were logged alike."""


def heading_source(recording: Recording) -> Source:
    """The names and units of the heading's channel and of the place, and the columns that both were read from."""
    channels = [*told_by(recording)[:1], *([recording.channel("position")] if recording.has("position") else [])]
    said = recording.provenance.get("guesses", "").splitlines()
    columns = (line for line in said for c in channels if line.startswith(f"{c.name}: "))
    named = (part for c in channels for part in (c.name, *c.labels, c.unit, *c.units))
    return (*named, recording.provenance.get("mapping", ""), *columns)


@dataclass(frozen=True, eq=False)
class Moves:
    """Where a tracked point went around (K,) samples, of those that stand out of its noise, and the heading there.

    A robot goes along its heading c exp(i (sign angle + zero)), c m of either sign since it may back off, and its tracker's
    noise is as large in all directions. The most likely zero is then half the angle of the sum of way^2 exp(-2i sign angle),
    and what lies across it, squared, is half of what that sum lacks of the sum of |way|^2. A move counts by its length: what
    a robot that stands or creeps seems to do says little.
    """

    way: Array
    """(K, 2) in m."""
    angle: Array
    """(K,) the heading as recorded, in rad."""
    swing: Array
    """(K, 2) where a point one metre ahead went by the turn of that heading alone."""
    block: Integers
    """(K,) which span of time each belongs to: moves of one share samples."""

    @classmethod
    def of(cls, position: Channel, heading: Channel, good: Mask) -> Moves:
        """Of the good samples of both, which have the same times."""
        time, points, angle = position.time[good], position.values[good], heading.values[good, 0]
        if len(time) < FEWEST_PARTS:
            return cls(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)), np.zeros(0, dtype=np.int64))
        moved, sure = motion(time, points)
        sure &= np.linalg.norm(moved, axis=1) > telling(points)
        swing = motion(time, np.stack([np.cos(angle), np.sin(angle)], axis=1))[0]
        return cls(moved[sure], angle[sure], swing[sure], ((time[sure] - time[0]) / SPAN).astype(np.int64))

    @property
    def squares(self) -> Array:
        """(B,) sums of their squared lengths, in m^2, block by block."""
        return self._by_block(np.sum(self.way**2, axis=1))

    def along(self, sign: float) -> complex:
        """In m^2: its size is that of `squares` where all go along the heading, its angle twice the zero."""
        return complex(np.sum(self._turned(sign) ** 2))

    def shows(self, sign: float) -> bool:
        """Whether they go along the heading of this sign, from whatever zero."""
        return _tell([self]) and abs(self.along(sign)) >= _SURE * self.squares.sum()

    @property
    def turns(self) -> bool:
        """Whether the heading is another by more than a frame may be turned on the car, in some moves than in others."""
        long = np.sum(self.way**2, axis=1)
        return bool(abs(np.sum(long * np.exp(1j * self.angle))) < np.cos(_WITHIN) * long.sum())

    def unlike(self, sign: float) -> tuple[float, float]:
        """Squares in m^2 of what lies across the heading of this sign, and of the whole, from the zero and with the lever arm
        of the tracked point that suit it best: a point ahead of the axle swings aside as a robot turns on the spot.
        """
        turned = self._turned(sign)
        across = sign * np.imag((self.swing[:, 0] + 1j * self.swing[:, 1]) * np.exp(-1j * self.angle))
        own, zero = turned, 0.5 * np.angle(np.sum(turned**2))
        for _ in range(_ROUNDS):
            lever = np.sum(np.imag(turned * np.exp(-1j * zero)) * across) / max(float(np.sum(across**2)), TINY)
            own = turned - 1j * lever * across * np.exp(1j * zero)
            zero = 0.5 * np.angle(np.sum(own**2))
        return float(np.sum(np.imag(own * np.exp(-1j * zero)) ** 2)), float(np.sum(np.abs(own) ** 2))

    def across(self, sign: float, zero: float) -> Array:
        """(B,) squares in m^2 of what lies across the heading, block by block."""
        return self._by_block(np.imag(self._turned(sign) * np.exp(-1j * zero)) ** 2)

    def forward(self, sign: float, zero: float) -> Array:
        """(B,) how far in m^2 they go on rather than back, block by block."""
        turned = self._turned(sign) * np.exp(-1j * zero)
        return self._by_block(np.real(turned) * np.abs(turned))

    def _turned(self, sign: float) -> NDArray[np.complex128]:
        return (self.way[:, 0] + 1j * self.way[:, 1]) * np.exp(-1j * sign * self.angle)

    def _by_block(self, values: Array) -> Array:
        index = np.unique(self.block, return_inverse=True)[1]
        return np.bincount(index, values).astype(np.float64) if len(values) else np.zeros(0)


@dataclass(frozen=True)
class Sense:
    """A yaw (x forward, growing to the left) is `sign` times the recorded heading, and `zero` more."""

    sign: float = 1.0
    zero: float | None = None
    """In rad; None where recordings differ, or do not show it."""
    contradicted: bool = False
    """Whether the way driven goes along the heading in neither sense, from whatever zero: it is another frame's that turns
    otherwise, as that of wheel odometry beside satellites where wheels skid."""

    @classmethod
    def of(cls, drives: Sequence[Moves]) -> Sense:
        """What recordings show together: the sign that was recorded unless the other one clearly goes with the way.

        Where some clearly show one sign and some the other, those are asked that went farther.
        """
        if _contradicted(drives):
            return cls(contradicted=True)
        clear = {sign: [d for d in drives if _clearer([d], sign, None)] for sign in (1.0, -1.0)}
        fewer = min(clear.values(), key=lambda some: sum(float(d.squares.sum()) for d in some))
        drives = [d for d in drives if all(d is not one for one in fewer)]
        if not _tell(drives):
            return cls()
        total = float(sum(d.squares.sum() for d in drives))
        axes = {sign: sum(d.along(sign) for d in drives) for sign in (1.0, -1.0)}
        one = max(abs(axis) for axis in axes.values()) >= _SURE * total  # zero for all of them
        sign = -1.0 if _clearer(drives, -1.0, axes if one else None) else 1.0
        if abs(axes[sign]) < _SURE * total:
            return cls(sign)
        return cls(sign, _directed(drives, sign, 0.5 * float(np.angle(axes[sign]))))

    def zero_of(self, drive: Moves) -> float:
        """The zero of one recording: its own where it shows one, from the side of all where both lie on one axis."""
        if not drive.shows(self.sign):
            return self.zero or 0.0
        own = 0.5 * float(np.angle(drive.along(self.sign)))
        if self.zero is None or abs(_wrapped(own - self.zero, np.pi)) > _WITHIN:
            return _directed([drive], self.sign, own)
        return _snapped(self.zero + _wrapped(own - self.zero, np.pi))


def aligned(
    position: Channel, heading: Channel, good: Mask, shared: Sense | None = None
) -> tuple[Channel | None, list[str]]:
    """The heading in the sense and from the zero of the way driven (x forward, growing to the left), and notes; None where
    the way goes along it in neither sense.

    `shared` is what recordings logged alike show together; without, this one is asked alone. Unchanged where both agree
    within _WITHIN, or where the way says nothing clear.
    """
    moves = Moves.of(position, heading, good)
    sense = shared or Sense.of([moves])
    if sense.contradicted:
        return None, []
    zero, notes = sense.zero_of(moves), []
    if shared is not None and _clearer([moves], -sense.sign, None):
        here, there = ("right", "left") if sense.sign > 0.0 else ("left", "right")
        notes.append(
            f"the heading grows to the {here} by the way driven here, to the {there} by that of all recordings together: "
            "taken as in all; give this one by itself, or with a mapping of its own, if it was logged otherwise"
        )
    if sense.sign > 0.0 and zero == 0.0:
        return heading, notes
    grows = "grows to the right" if sense.sign < 0.0 else "is turned"
    notes.append(
        f"the heading {grows} and its zero is {np.degrees(zero):.0f} deg from x: changed to that of the way driven"
    )
    return heading.replace(values=sense.sign * heading.values + zero), notes


def _tell(drives: Collection[Moves]) -> bool:
    """Whether their moves are as good as FEWEST_PARTS of one length that share no sample (L. Kish, Survey Sampling, 1965)."""
    squares = np.concatenate([np.zeros(0), *(d.squares for d in drives)])
    return bool(squares.sum() ** 2 >= FEWEST_PARTS * np.sum(squares**2) > 0.0)


def _contradicted(drives: Sequence[Moves]) -> bool:
    """Whether moves lie beside headings that turn, each in the sense that suits it best, by more than a frame may be turned
    on the car. Where the heading stays as it is the car may stand while its receiver drifts.
    """
    turning = [d for d in drives if d.turns]
    if not _tell(turning):
        return False
    across, whole = np.sum([min(d.unlike(1.0), d.unlike(-1.0)) for d in turning], axis=0)
    return bool(whole - 2.0 * across < _SURE * whole)


def _clearer(drives: Collection[Moves], sign: float, axes: Mapping[float, complex] | None) -> bool:
    """Whether the heading of this sign goes with the way, and clearly better than that of the other sign.

    Each sign with the zero that suits it best: of all drives, twice the angle of `axes`, or where None of each by itself.
    """
    across = {
        s: np.concatenate([d.across(s, 0.5 * float(np.angle(d.along(s) if axes is None else axes[s]))) for d in drives])
        for s in (sign, -sign)
    }
    total = float(sum(d.squares.sum() for d in drives))
    if not _tell(drives) or total - 2.0 * across[sign].sum() < _SURE * total:
        return False
    return evidence(across[-sign], across[sign], across[sign] + across[-sign]).holds


def _directed(drives: Sequence[Moves], sign: float, axis: float) -> float:
    """The zero of an axis, forward where drives mostly go: to x or to y (north) where they do not tell, nor turned round
    whatever they do where a heading that grows to the left is along x.
    """
    if sign > 0.0 and abs(_wrapped(axis, np.pi)) < _WITHIN:
        return 0.0
    forward = np.concatenate([d.forward(sign, axis) for d in drives])
    told = abs(float(forward.sum())) >= STANDARD_ERRORS * float(np.linalg.norm(forward))
    usual = _wrapped(axis - 0.25 * np.pi, np.pi) + 0.25 * np.pi
    return _snapped(_wrapped(axis + np.pi * float(forward.sum() < 0.0), 2.0 * np.pi) if told else usual)


def _snapped(zero: float) -> float:
    """A quarter turn within _WITHIN of it, in place of an angle in rad."""
    quarters = round(zero / (0.5 * np.pi)) * 0.5 * np.pi
    return _wrapped(quarters if abs(zero - quarters) < _WITHIN else zero, 2.0 * np.pi)


def _wrapped(angle: float, turn: float) -> float:
    """The same angle within half a turn of zero."""
    return float((angle + 0.5 * turn) % turn - 0.5 * turn)
