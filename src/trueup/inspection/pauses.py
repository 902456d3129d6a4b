# SPDX-License-Identifier: Apache-2.0
"""Logs whose logger stopped for a while: what was commanded then nobody knows, so what comes after begins anew."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from trueup.arrays import Array, Mask
from trueup.inspection.repeats import BASE, LONGEST_GAP
from trueup.inspection.stamps import Gap, clock_of
from trueup.instant import usual_step
from trueup.noise import FEWEST
from trueup.recording import Channel, Recording, is_command, part_of
from trueup.rounding import PRINTED


def parted_at_pauses(recordings: Sequence[Recording], late: float = 0.0) -> tuple[list[Recording], list[str]]:
    """Recordings in parts between their pauses, each from where the robot was measured to be then, and notes.

    Those without pauses are the same objects. Commands act up to `late` s after they were given: so long behind a pause
    nothing is measured yet, since what was commanded in it acts. What has fewer than `FEWEST` samples is left out; a
    recording that would have no part left stays whole.
    """

    def note(recording: Recording, gaps: Sequence[Gap], spans: str, parts: str) -> str:
        count = "a pause" if len(gaps) == 1 else f"{len(gaps)} pauses"
        return (
            f"'{recording.name}' has {count} without command and position ({spans}): what was commanded then is unknown; it "
            f"is replayed as {parts}, each from where the robot was measured to be{waits}"
        )

    waits = f", {late:g} s behind a pause, when what was commanded in it has acted" if late else ""

    return parted(recordings, pauses, note, late)


def parted(
    recordings: Sequence[Recording],
    gaps_of: Callable[[Recording], Sequence[Gap]],
    said: Callable[[Recording, Sequence[Gap], str, str], str],
    late: float = 0.0,
) -> tuple[list[Recording], list[str]]:
    """Recordings in parts between their gaps, or as they are, and a note on each that was parted: what is `said` of it, its
    gaps, these as words, and the names of its parts. See `parts_between` for `late`.
    """
    result, notes = list[Recording](), list[str]()
    for recording in recordings:
        gaps = gaps_of(recording)
        parts = parts_between(recording, gaps, late) if gaps else []
        result += parts or [recording]
        if parts:
            spans = ", ".join(f"{g.start:.4g} ... {g.start + g.duration:.4g} s" for g in gaps[:3])
            spans += " ..." * (len(gaps) > 3)
            notes.append(said(recording, gaps, spans, ", ".join(repr(p.name) for p in parts)))
    return result, notes


def pauses(recording: Recording) -> list[Gap]:
    """Where neither command nor position was logged for far longer than is usual in this log, and the command before cannot
    be held: for `LONGEST_GAP` or longer nobody knows what it was; or it is further away after the gap than it goes from one
    sample to the next anywhere else.

    A command that is published when it changes is no pause while positions go on, nor is a single sample that is missing.
    Nothing is missing of what nobody commands; recordings of a free base are judged by where that was lost (`repeats.lost`).
    """
    commands = [c for name, c in recording.channels.items() if is_command(name)]
    if not commands or not recording.has("position") or any(recording.has(name) for name in BASE):
        return []
    stamps = np.unique(np.concatenate([_known(c) for c in (*commands, recording.channel("position"))]))
    rate, _, gaps = clock_of(stamps)
    real = [g for g in gaps if not g.is_single(rate)]
    leaps = np.any([_leaps(c, real) for c in commands], axis=0)
    return [g for g, leap in zip(real, leaps, strict=True) if leap or g.duration >= LONGEST_GAP]


def _leaps(command: Channel, gaps: Sequence[Gap]) -> Mask:
    """(G,) over which of the gaps a command goes further than between any two of its samples that no gap parts."""
    known = np.isfinite(command.values).all(axis=1)
    time, change = command.time[known], np.abs(np.diff(command.values[known], axis=0))
    middles = [g.start + 0.5 * g.duration for g in gaps]
    over = np.searchsorted(time, middles) - 1
    inside = (over >= 0) & (over < len(change))
    elsewhere = np.delete(change, over[inside], axis=0)
    leaps = np.zeros(len(gaps), dtype=bool)
    if len(elsewhere):
        leaps[inside] = (change[over[inside]] > elsewhere.max(axis=0) + PRINTED).any(axis=1)
    return leaps


def parts_between(recording: Recording, gaps: Sequence[Gap], late: float = 0.0, known: float = 0.0) -> list[Recording]:
    """What lies before, between and behind the gaps, as recordings of their own; none of fewer than `FEWEST` samples.

    Behind a gap nothing is measured for the first `late` s; commands go back by `known` s, into the gap.
    """
    again = [_resumed(recording, g.start + g.duration) for g in gaps]
    begins = [(recording.start, recording.start), *((b - known, b + late) for b in again)]
    ends = [*(g.start for g in gaps), recording.stop]
    position = _known(recording.channel("position"))
    parts = [
        _part(recording, max(told, recording.start), seen, end) for (told, seen), end in zip(begins, ends, strict=True)
        if np.count_nonzero((position >= seen) & (position <= end)) >= FEWEST
    ]  # fmt: skip
    return [p.replace(name=f"{recording.name} part {k}", provenance=part_of(p)) for k, p in enumerate(parts, 1)]


def _part(recording: Recording, told: float, seen: float, end: float) -> Recording:
    """What was commanded from `told` on and measured from `seen` on, until `end`, in s."""
    part = recording.slice(seen, end)
    if told == seen:
        return part
    commands = {name: c for name, c in recording.slice(told, end).channels.items() if is_command(name)}
    return part.replace(channels={**part.channels, **commands})


def _resumed(recording: Recording, instant: float) -> float:
    """From when on it is known again what is commanded, in s: a stale command would kick the robot until then. Where none
    comes within the usual time between commands, the one before the pause is taken to hold: it may be sent when it changes.
    """
    latest = instant
    for name, channel in recording.channels.items():
        stamps = _known(channel) if is_command(name) else np.zeros(0)
        later = stamps[stamps >= instant]
        if len(later) and len(stamps) > 1 and later[0] - instant <= min(usual_step(stamps), LONGEST_GAP):
            latest = max(latest, float(later[0]))
    return latest


def _known(channel: Channel) -> Array:
    """(n,) when a channel has a value of any label, in s."""
    return channel.time[np.isfinite(channel.values).any(axis=1)]
