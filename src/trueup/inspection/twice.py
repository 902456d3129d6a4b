# SPDX-License-Identifier: Apache-2.0
"""Stretches that stand in two recordings, as where loggers write files that overlap: seen twice, and never held out."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from trueup.inspection.zeros import SETTLES
from trueup.instant import usual_step
from trueup.recording import Recording
from trueup.samples import stretches_of


def seen_twice(training: Sequence[Recording], held_out: Sequence[Recording]) -> list[str]:
    """A sentence for each two recordings that share a stretch, of which one is fitted."""
    seen = [
        f"'{judged.name}' is held out, yet {lasting:.3g} s of it stand in '{fitted.name}' too, which is fitted: of these its "
        "error says nothing. Cut them off, or hold out another"
        for judged, fitted in itertools.product(held_out, training)
        if (lasting := shared(judged, fitted))
    ]
    twice = [
        f"{lasting:.3g} s of '{one.name}' stand in '{other.name}' too: they count twice, and intervals are narrower than "
        "they should be. Cut them off one of both"
        for one, other in itertools.combinations(training, 2)
        if (lasting := shared(one, other))
    ]
    return [*seen, *twice]


def shared(one: Recording, other: Recording) -> float:
    """How long a stretch of positions of one recording is that stands in another, value by value, in s. What is alike for
    less than a servo takes to settle is so by chance: coarse encoders say the same wherever two motions are about as quick.
    """
    channels = [r.channels.get("position") for r in (one, other)]
    if channels[0] is None or channels[1] is None or channels[0].labels != channels[1].labels or one is other:
        return 0.0
    mine, theirs = ([row.tobytes() for row in np.ascontiguousarray(c.values)] for c in channels if c is not None)
    places: dict[bytes, int] = {}
    for k, row in enumerate(theirs):
        places.setdefault(row, k)
    found = np.array([places.get(row, -1) for row in mine])
    goes_on = (found[1:] >= 0) & (np.diff(found) == 1)  # what rests is the same row again and again, and is not counted
    if not goes_on.any():
        return 0.0
    step = usual_step(channels[0].time)
    return sum(float(b - a) * step for a, b in stretches_of(goes_on) if (b - a) * step >= SETTLES)
