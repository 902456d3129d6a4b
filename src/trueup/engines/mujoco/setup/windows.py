# SPDX-License-Identifier: Apache-2.0
"""Recordings of robots with a free base begun again every half second: errors of the base grow beyond use in longer ones."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.articulated.pose import ANGLES, ORIENTATION, POSITION
from trueup.calibration import Replay
from trueup.engines.mujoco.base import floating, free_joint
from trueup.engines.mujoco.model import Model
from trueup.recording import Channel, Recording, is_command, part_of

_LENGTH = 0.5  # s: a trunk on legs is an inverted pendulum, whose errors grow fivefold in that time
_MOST = 12  # windows of one recording, spread evenly
_BEFORE = 0.3  # s of commands kept before each window: they may act late
_AT = re.compile(r" at (\d+\.\d) s(?=$|')")
_FEWEST = 8  # samples in a window


def begun_again(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings cut into windows that start where the robot was measured to be, and a note; others as they are.

    A robot that stands on its own legs is unstable, or nearly: replayed for long, one that differs by a hair stumbles
    elsewhere, and such errors tell nothing of the parameters (multiple shooting: Bock and Plitt 1984).
    """
    tracked = [
        r for r in recordings if r.has(POSITION) and r.has(ORIENTATION) and r.channel(ORIENTATION).labels == ANGLES
    ]
    if not tracked or (free_joint(model.compiled) < 0 and floating(model, tracked) is model):
        return list(recordings), []
    found = [window for r in recordings for window in (_windows(r) if r in tracked else [r])]
    if len(found) == len(recordings):
        return found, []
    note = (
        f"each recording of the free base is replayed in windows of {_LENGTH:g} s, {len(found)} in all, each from where the "
        "robot was then"
    )
    return found, [note]


def joined(replays: Sequence[Replay]) -> tuple[Replay, ...]:
    """Replays with windows put together again, one a recording: what was simulated jumps where a window begins."""
    groups: dict[tuple[str, str, tuple[str, ...], bool], list[Replay]] = {}
    for replay in replays:
        key = (_AT.sub("", replay.recording), replay.channel, replay.labels, replay.held_out)
        groups.setdefault(key, []).append(replay)
    return tuple(_whole(name, parts) for (name, *_), parts in groups.items())


def _whole(name: str, parts: Sequence[Replay]) -> Replay:
    if not _AT.search(parts[0].recording):
        return parts[0]
    starts = [float(found[1]) for part in parts if (found := _AT.search(part.recording))]
    commands = [part.command for part in parts if part.command is not None]
    return replace(
        parts[0], recording=name, time=np.concatenate([p.time + s for p, s in zip(parts, starts, strict=True)]),
        measured=np.concatenate([p.measured for p in parts]), before=np.concatenate([p.before for p in parts]),
        after=np.concatenate([p.after for p in parts]),
        command=np.concatenate(commands) if len(commands) == len(parts) else None,
    )  # fmt: skip


def folded(warnings: Sequence[str], recordings: Sequence[Recording]) -> list[str]:
    """Warnings on windows said once for the recording that they were cut from, where half of its windows have them."""
    windows = Counter(_AT.sub("", r.name) for r in recordings if _AT.search(r.name))
    found = Counter(_AT.sub("", warning, count=1) for warning in warnings)
    kept = []
    for warning, times in found.items():
        whole = next((count for name, count in windows.items() if f"'{name}'" in warning), 1)
        if 2 * times >= whole:
            kept.append(warning if whole == 1 else f"{warning} ({times} of {whole} windows)")
    return kept


def _windows(recording: Recording) -> list[Recording]:
    time = recording.time
    count = round((time[-1] - time[0]) / _LENGTH)
    if count < 2 or len(time) / count < _FEWEST:
        return [recording]
    starts = time[0] + _LENGTH * np.arange(count)
    if count > _MOST:
        starts = starts[np.unique(np.linspace(0, count - 1, _MOST).round().astype(int))]
    return [_window(recording, float(start)) for start in starts]


def _window(recording: Recording, start: float) -> Recording:
    parts = (
        _cut(channel, start - (_BEFORE if is_command(name) else 0.0), start + _LENGTH)
        for name, channel in recording.channels.items()
    )
    kept = {channel.name: channel for channel in parts if channel is not None}
    name = f"{recording.name} at {start - recording.start:.1f} s"
    return recording.replace(name=name, channels=kept, provenance=part_of(recording))


def _cut(channel: Channel, start: float, stop: float) -> Channel | None:
    first, last = np.searchsorted(channel.time, [start - 1e-9, stop - 1e-9])
    if is_command(channel.name):
        first = max(int(np.searchsorted(channel.time, start, side="right")) - 1, 0)  # the one in force at the start
    if last <= first:
        return None
    return channel.replace(time=channel.time[first:last], values=channel.values[first:last])
