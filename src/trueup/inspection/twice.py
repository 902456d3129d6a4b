# SPDX-License-Identifier: Apache-2.0
"""Stretches that stand in two recordings, as where loggers write files that overlap: seen twice, and never held out."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.inspection.zeros import SETTLES
from trueup.instant import usual_step
from trueup.recording import Recording
from trueup.samples import stretches_of


def seen_twice(training: Sequence[Recording], held_out: Sequence[Recording]) -> list[str]:
    """A sentence for each two recordings that share a stretch, of which one is fitted."""
    every = [_Positions.of(r) for r in (*training, *held_out)]
    alike, fitted = _sharing_rows(every), range(len(training))
    seen = [
        f"'{every[j].name}' is held out, yet {lasting:.3g} s of it stand in '{every[k].name}' too, which is fitted: of these "
        "its error says nothing. Cut them off, or hold out another"
        for j, k in itertools.product(range(len(training), len(every)), fitted)
        if (k, j) in alike and (lasting := every[j].shared(every[k]))
    ]
    twice = [
        f"{lasting:.3g} s of '{every[j].name}' stand in '{every[k].name}' too: they count twice, and intervals are narrower "
        "than they should be. Cut them off one of both"
        for j, k in itertools.combinations(fitted, 2)
        if (j, k) in alike and (lasting := every[j].shared(every[k]))
    ]
    return [*seen, *twice]


def _sharing_rows(every: Sequence[_Positions]) -> set[tuple[int, int]]:
    """Pairs of recordings, by their places, that have some row in common: of hundreds next to none need a closer look."""
    having: dict[bytes, list[int]] = {}
    for k, one in enumerate(every):
        for row in one.places:
            having.setdefault(row, []).append(k)
    some = {tuple(own) for own in having.values() if len(own) > 1}
    return {pair for own in some for pair in itertools.combinations(own, 2)}


@dataclass(frozen=True, eq=False)
class _Positions:
    """What a recording says of its joints, row by row."""

    name: str
    labels: tuple[str, ...]
    time: Array
    """(T,) in s."""
    rows: Sequence[bytes]
    places: Mapping[bytes, int]
    """Where each row stands first."""

    @classmethod
    def of(cls, recording: Recording) -> _Positions:
        """Of a recording; nothing where it has no positions."""
        channel, places = recording.channels.get("position"), dict[bytes, int]()
        if channel is None:
            return cls(recording.name, (), np.zeros(0), (), places)
        rows = [row.tobytes() for row in np.ascontiguousarray(channel.values)]
        for k, row in enumerate(rows):
            places.setdefault(row, k)
        return cls(recording.name, channel.labels, channel.time, rows, places)

    def shared(self, other: _Positions) -> float:
        """How long a stretch of this is that stands in another, value by value, in s. What is alike for less than a servo
        takes to settle is so by chance: coarse encoders say the same wherever two motions are about as quick.
        """
        if self.labels != other.labels:
            return 0.0
        found = np.array([other.places.get(row, -1) for row in self.rows])
        goes_on = (found[1:] >= 0) & (
            np.diff(found) == 1
        )  # what rests is the same row again and again, and not counted
        if not goes_on.any():
            return 0.0
        step = usual_step(self.time)
        return sum(float(b - a) * step for a, b in stretches_of(goes_on) if (b - a) * step >= SETTLES)
