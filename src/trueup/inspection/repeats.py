# SPDX-License-Identifier: Apache-2.0
"""Repeats of one run: what was lost of each, how far they are apart, and their average as far as they go together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.ends import ENDED, ended
from trueup.errors import RecordingError
from trueup.recording import Channel, Recording, is_command, with_warnings
from trueup.rounding import NEGLIGIBLE, SAME_INSTANT
from trueup.samples import between
from trueup.trial import command_of

LONGEST_GAP = 0.5
"""s without a measurement of the base after which nobody can say what a robot did there: a fall takes as long."""


BASE = ("base_position", "base_orientation")


def lost(channel: Channel) -> tuple[float, float] | None:
    """From when to when, in s, a channel has no sample for longest, where that is `LONGEST_GAP` or longer."""
    known = channel.time[np.isfinite(channel.values).all(axis=1)]
    edges = np.concatenate([channel.time[:1], known, channel.time[-1:]])
    longest = int(np.diff(edges).argmax())
    first, last = float(edges[longest]), float(edges[longest + 1])
    return (first, last) if last - first >= LONGEST_GAP else None


def bridged(recording: Recording, channels: Sequence[str] = BASE) -> Recording:
    """The recording with gaps of these channels closed by straight lines.

    Raises RecordingError, naming channel and instants, where something was lost for `LONGEST_GAP` or longer.
    """
    for name in channels:
        if not recording.has(name):
            continue
        channel = recording.channel(name)
        if (gap := lost(channel)) is not None:
            raise RecordingError(
                f"recording '{recording.name}': '{name}' was lost from {gap[0]:.3g} to {gap[1]:.3g} s "
                f"({gap[1] - gap[0]:.2g} s; at most {LONGEST_GAP:g} s can be bridged): markers were out "
                "of the cameras' sight; perform the run again"
            )
        known = np.isfinite(channel.values).all(axis=1)
        values = between(channel.time, channel.time[known], channel.values[known])
        recording = recording.with_channel(channel.replace(values=values))
    return recording


def grouped(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Recordings that were commanded alike from their start on, several a group; those that were alone are left out."""
    groups: dict[tuple[tuple[str, ...], bytes], list[Recording]] = {}
    for recording in recordings:
        if (command := command_of(recording)) is not None:
            given = np.column_stack([command.time - recording.start, command.values])
            groups.setdefault((command.labels, np.round(given, 6).tobytes()), []).append(recording)
    return [group for group in groups.values() if len(group) > 1]


@dataclass(frozen=True, eq=False)
class Repeats:
    """Several runs of one command as one."""

    average: Recording
    """Measured channels averaged, up to where the runs part or the first of them ends."""
    spread: Mapping[str, float]
    """Channel to the standard deviation between runs, root mean square over time and labels, while they go together."""
    parted: float | None
    """s on their clock from which they have less in common with their average than the average moves; None: never."""

    @property
    def summary(self) -> str:
        """The spread in words, and where runs disagree."""
        words = ", ".join(f"{name} {value:.2g}" for name, value in self.spread.items())
        said = f"repeats of '{self.average.name}' differ by {words} (standard deviation, rad or m)"
        if self.parted is None:
            return said
        return f"{said}; they disagree from {self.parted:.3g} s on, where each does something else"


def together(recordings: Sequence[Recording], name: str = "") -> Repeats:
    """The average of repeats and how far they are apart.

    They part where the variance between them is that of their average over the whole run: from there on, it tells no more
    of any of them than its mean pose would. Raises RecordingError without recordings, or where these share no channel.
    """
    if not recordings:
        raise RecordingError("no repeats to average")
    first = recordings[0]
    shared = [c for c in first.channels if not is_command(c) and all(r.has(c) for r in recordings)]
    if not shared:
        raise RecordingError(
            f"repeats of '{first.name}' share no measured channel; it has: {', '.join(first.channels)}"
        )
    begin = max(float(r.channel(c).time[0]) for r in recordings for c in shared)
    stop = min(float(r.channel(c).time[-1]) for r in recordings for c in shared)
    means, between = {}, {}
    for c in shared:
        channel = first.channel(c)
        time = channel.time[(channel.time >= begin - SAME_INSTANT) & (channel.time <= stop + SAME_INSTANT)]
        runs = np.stack([r.channel(c).select(channel.labels).at(time) for r in recordings])
        means[c] = channel.replace(time=time, values=runs.mean(axis=0))
        between[c] = runs.var(axis=0, ddof=1) if len(recordings) > 1 else np.zeros(runs.shape[1:])
    parted = min(
        (p for c in shared if (p := _parting(means[c].time, means[c].values, between[c])) is not None), default=None
    )
    last = stop if parted is None else max(parted, begin)
    spread = {
        c: float(np.sqrt(np.nanmean(between[c][means[c].time <= last + SAME_INSTANT]))) for c in shared
    }  # fmt: skip
    whole = Recording(name or first.name, {**{n: c for n, c in first.channels.items() if is_command(n)}, **means},
                      {**first.provenance, "repeats": ", ".join(r.name for r in recordings)})  # fmt: skip
    found = Repeats(_until(whole, begin, last, recordings), spread, parted)
    if parted is None:
        return found
    average = found.average
    return Repeats(average.replace(provenance=with_warnings(average.provenance, [found.summary])), spread, parted)


def _parting(time: Array, mean: Array, between: Array) -> float | None:
    """When the variance between runs, summed over labels, first exceeds that of their average over time."""
    moved = float(np.nansum(np.nanvar(mean, axis=0)))
    apart = np.flatnonzero(np.nan_to_num(between).sum(axis=1) > max(moved, NEGLIGIBLE))
    return float(time[apart[0]]) if len(apart) else None


def _until(whole: Recording, begin: float, last: float, recordings: Sequence[Recording]) -> Recording:
    """The part before `last`; an end that all runs had counts where it lies before."""
    ends = [e for r in recordings if (e := ended(r)) is not None]
    provenance = {k: v for k, v in whole.provenance.items() if k != ENDED}
    if len(ends) == len(recordings) and min(e.at for e in ends) <= last:
        provenance[ENDED] = f"{min(e.at for e in ends)!r} {ends[0].name}"
    return whole.replace(provenance=provenance).slice(begin, last)
