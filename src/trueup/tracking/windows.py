# SPDX-License-Identifier: Apache-2.0
"""Drives in windows, each of which begins anew from a measurement, and the noise of their localisation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.errors import RecordingError
from trueup.noise import estimate_noise
from trueup.recording import Channel, Recording, is_command, part_of
from trueup.rounding import SAME_INSTANT
from trueup.tracking.heading import telling

LENGTH = 6.0
"""In s: long enough to see a delay and a curve, too short to drift far away; what is left out together of drives."""
_BEFORE = 20.0
"""In s: commands that come before. A steering that is limited in speed is where those have brought it that it took since it
stood at its other end: at the slowest that is searched (`steering_rate_limit`, 0.1 rad/s) 2 rad.
"""


def windows(recording: Recording, length: float = LENGTH) -> list[Recording]:
    """Pieces of `length` s, end to end, each with the commands of `_BEFORE` s before it.

    These still act when it begins, because of delays and slow wheels. Pieces in which nothing moves are left out. Raises
    RecordingError where none is left.
    """
    if not length > 0.0:
        raise RecordingError(f"windows of {length} s: their length must be positive")
    pieces = []
    for start in np.arange(recording.time[0], recording.time[-1] - 0.5 * length, length).tolist():
        cuts = {
            n: _cut(c, start - _BEFORE if is_command(n) else start, start + length)
            for n, c in recording.channels.items()
        }
        channels = {name: cut for name, cut in cuts.items() if cut is not None}
        if "position" in channels and moves(channels["position"].values):
            pieces.append(Recording(f"{recording.name} {start:.0f} s", channels, part_of(recording)))
    if not pieces:
        raise RecordingError(f"recording '{recording.name}' has no stretch of {length:g} s in which the vehicle moves")
    return pieces


def _cut(channel: Channel, start: float, stop: float) -> Channel | None:
    inside = (channel.time >= start - SAME_INSTANT) & (channel.time <= stop + SAME_INSTANT)
    if inside.sum() < 2:
        return None
    return channel.replace(time=channel.time[inside], values=channel.values[inside])


def moves(points: Array) -> bool:
    """Whether some of points (N, 2) in m are further from their middle than one must go to show a direction: a vehicle that
    stands tells nothing.
    """
    known = points[np.isfinite(points).all(axis=1)]
    away = np.linalg.norm(known - np.median(known, axis=0), axis=1) if len(known) else np.zeros(0)
    return bool(np.any(away > telling(known)))


def noise_of(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Localisation noise that the recordings show: standard deviations of position in m and of heading in rad."""
    each = [
        [float(np.median(estimate_noise(c.values, c.time))) for c in (r.channel("position"), r.channel("heading"))]
        for r in recordings
    ]
    position, heading = np.median(each, axis=0)
    return float(position), float(heading)
