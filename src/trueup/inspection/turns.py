# SPDX-License-Identifier: Apache-2.0
"""Joints that turn on and on, logged by encoders that begin anew after each turn: the motion without those jumps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.inspection.scales import Way
from trueup.inspection.zeros import FAR
from trueup.recording import Channel, Recording
from trueup.samples import unwound

_COMMANDS = ("command_sent", "command")


def without_wraps(
    joints: Mapping[str, Way], drives: Mapping[str, str], recordings: Sequence[Recording]
) -> tuple[list[Recording], list[str]]:
    """Recordings in which hinges without a range go on turning where their log jumps by a whole turn, and notes.

    So do their commands, which lie in the turn in which the joint follows them. `drives`: each joint to the name of what
    drives it, by which commands may be called, too. Hinges with a range are where that is, whole turns away from what
    encoders say that count from zero to a turn.
    """
    result, jumped, beside, within = list(recordings), {}, {}, {}
    for joint in (j for j, way in joints.items() if not way.slides):
        names = (joint, *filter(None, [drives.get(joint)]))
        wraps = any(unwrapped(column) is not None for r in recordings if (column := _position(r, joint)) is not None)
        away = _turns_away(joint, joints[joint].range, recordings, wraps=wraps)
        for i, recording in enumerate(result):
            if away[i] is None:
                continue
            changed = turning_on(recording, names, wraps=wraps, away=away[i] or 0.0)
            if "position" in changed and joints[joint].range is not None:
                within.setdefault(joint, []).append(recording.name)
            elif "position" in changed:
                jumped.setdefault(joint, []).append(recording.name)
            elif changed:
                beside.setdefault(joint, []).append(recording.name)
            for channel in changed.values():
                result[i] = result[i].with_channel(channel)
    says = "{} jump by a whole turn between samples ({}), as of encoders that wrap: they are taken to go on turning"
    said = "commands of {} are whole turns away from where the joint is ({}): they are taken to mean the turn that it is in"
    ranged = (
        "positions of {} jump by a whole turn or lie one beside the joint's range ({}), as of encoders that count from zero "
        "to a turn: they are taken to be in that range"
    )
    told = ((f"positions of {says}", jumped), (said, beside), (ranged, within))
    return result, [text.format(", ".join(found), _named(found)) for text, found in told if found]


def _turns_away(
    joint: str, ends: tuple[float, float] | None, recordings: Sequence[Recording], *, wraps: bool
) -> list[float | None]:
    """For each recording by how many turns a joint's encoder is to be moved once it goes on: so that all of its motion is in
    the joint's range, as near to the middle as can be; None where it stays as it is, 0 of a joint without a range.
    """
    if ends is None:
        return [0.0] * len(recordings)
    found: list[float | None] = []
    for recording in recordings:
        column = _position(recording, joint)
        known = np.zeros(0) if column is None else column[np.isfinite(column)]
        inside = bool(known.size) and ends[0] - FAR <= known.min() and known.max() <= ends[1] + FAR
        if not known.size or (inside and not wraps) or np.ptp(known) > math.tau:
            found.append(None)
            continue
        on = unwound(known, math.tau)
        turns = float(np.round((sum(ends) - on.min() - on.max()) / (2.0 * math.tau)))
        fits = ends[0] - FAR <= on.min() + turns * math.tau and on.max() + turns * math.tau <= ends[1] + FAR
        found.append(turns if fits else None)
    return found


def _named(found: Mapping[str, Sequence[str]]) -> str:
    return ", ".join(dict.fromkeys(name for names in found.values() for name in names))


def turning_on(
    recording: Recording, names: Sequence[str], turn: float = math.tau, unit: str = "rad", *, wraps: bool = False,
    away: float = 0.0,
) -> dict[str, Channel]:  # fmt: skip
    """Channels of a recording that change where a joint, the first of `names`, goes on turning in place of its jumps.

    `turn` is one turn in the channels' `unit`; `wraps` says that angles of this joint are known to be logged within one,
    `away` by how many turns they are to be moved.
    """
    measured, changed = _position(recording, names[0], unit), {}
    if measured is None:
        return {}
    on = unwrapped(measured, turn)
    on = on if not away else (measured if on is None else on) + away * turn
    position = recording.channel("position")
    if on is not None:
        changed["position"] = _with(position, names[0], on)
    for channel in (recording.channel(name) for name in _COMMANDS if recording.has(name)):
        label = next((n for n in names if n in channel.labels), None)
        if label is None or channel.unit_of(label) != unit:
            continue
        told = channel.column(label)
        last = np.clip(np.searchsorted(channel.time, position.time, side="right") - 1, 0, None).astype(np.int64)
        turns = _turns(told, last, measured if on is None else on, turn, wraps=wraps or on is not None)
        if np.any(turns):
            changed[channel.name] = _with(channel, label, told + turn * turns)
    return changed


def unwrapped(values: Array, turn: float = math.tau) -> Array | None:
    """(T,) an angle without its jumps of about a whole `turn` between samples; None where it has none."""
    known = np.isfinite(values)
    if not _jumps(np.diff(values[known]), turn).any():
        return None
    return unwound(values, turn)


def _jumps(steps: Array, turn: float) -> Mask:
    """Which steps are nearer to whole turns than to any half of one: a gap in a log may hide a motion of more than half."""
    whole = np.round(steps / turn)
    return (whole != 0.0) & (np.abs(steps - whole * turn) < 0.25 * turn)


def _turns(told: Array, last: Integers, position: Array, turn: float, *, wraps: bool) -> Array:
    """(T,) whole turns by which commands (T,) lie beside the positions (P,) before which each was the `last` (P,).

    Piece by piece between jumps, each by where the joint is at its end: it may have been told to turn by more than half a
    turn. Of angles that are not known to wrap only clear jumps part pieces, and one piece is away only as a whole.
    """
    steps = np.nan_to_num(np.diff(told))
    piece = np.concatenate([[0], np.cumsum(np.abs(steps) > 0.5 * turn if wraps else _jumps(steps, turn))])
    found: list[float] = []
    for away in np.split(position - told[last], np.searchsorted(piece[last], np.arange(1, piece[-1] + 1))):
        known = away[np.isfinite(away)]
        if not len(known):
            found.append(found[-1] if found else 0.0)
        elif wraps or piece[-1] > 0 or bool(_jumps(known, turn).all()):
            found.append(float(np.round(known[-1] / turn)))
        else:
            found.append(0.0)
    return np.array(found)[piece]


def _position(recording: Recording, joint: str, unit: str = "rad") -> Array | None:
    """(T,) measured positions of a joint in this unit; None where a recording has none."""
    channel = recording.channels.get("position")
    if channel is None or joint not in channel.labels or channel.unit_of(joint) != unit:
        return None
    return channel.column(joint)


def _with(channel: Channel, label: str, column: Array) -> Channel:
    values = np.array(channel.values)
    values[:, channel.labels.index(label)] = column
    return channel.replace(values=values)
