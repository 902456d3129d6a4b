# SPDX-License-Identifier: Apache-2.0
"""A long drive cut into short ones: under recorded commands a vehicle drifts away, so each starts anew from a measurement."""

from __future__ import annotations

import numpy as np

from trueup.errors import RecordingError
from trueup.recording import Channel, Recording, is_command, part_of


def windows(
    recording: Recording, length: float = 6.0, *, history: float = 2.0, every: float | None = None
) -> list[Recording]:
    """Pieces of `length` s, one every `every` s (default: end to end), each with the commands of `history` s before it.

    The commands before the start are those that still act when it begins, because of delays. Pieces in which nothing
    moves by more than 0.1 m are left out. Raises RecordingError where none is left.
    """
    if not length > 0.0 or (every is not None and not every > 0.0):
        raise RecordingError(f"windows of {length} s every {every} s: both must be positive")
    pieces = []
    for start in np.arange(recording.time[0], recording.time[-1] - 0.5 * length, every or length).tolist():
        stop = start + length
        channels = {}
        for name, channel in recording.channels.items():
            cut = _cut(channel, start - history if is_command(name) else start, stop)
            if cut is not None:
                channels[name] = cut
        if "position" in channels and _moves(channels["position"]):
            name = f"{recording.name} {start:.0f} s"
            pieces.append(Recording(name, channels, part_of(recording)))
    if not pieces:
        raise RecordingError(f"recording '{recording.name}' has no stretch of {length:g} s in which the vehicle moves")
    return pieces


def _cut(channel: Channel, start: float, stop: float) -> Channel | None:
    inside = (channel.time >= start - 1e-9) & (channel.time <= stop + 1e-9)
    if inside.sum() < 2:
        return None
    return channel.replace(time=channel.time[inside], values=channel.values[inside])


def _moves(position: Channel) -> bool:
    span = np.nanmax(position.values, axis=0) - np.nanmin(position.values, axis=0)
    return bool(np.hypot(*span[:2]) > 0.1)
