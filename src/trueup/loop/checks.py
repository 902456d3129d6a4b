# SPDX-License-Identifier: Apache-2.0
"""Looks at recordings before a calibration: what cannot be right is said, what cannot be used is refused."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from trueup.calibration import Replay
from trueup.errors import CalibrationError
from trueup.evidence import HALVED
from trueup.inspection.alignment import on_other_clocks
from trueup.inspection.repeats import BASE, grouped, lost, together
from trueup.inspection.twice import seen_twice
from trueup.recording import Channel, Recording, warnings_of
from trueup.samples import correlation
from trueup.trial import command_of
from trueup.units import hardly_radians


def check(training: Sequence[Recording], held_out: Sequence[Recording]) -> list[str]:
    """Warnings, in words. Raises CalibrationError where nothing can be fitted."""
    if not training:
        raise CalibrationError("no recording to fit: all were held out")
    names = [r.name for r in (*training, *held_out)]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise CalibrationError(f"two recordings are called {', '.join(twice)}: rename one, or leave one out")
    warnings: list[str] = []
    for recording in (*training, *held_out):
        warnings += _about(recording)
    warnings += _silent((*training, *held_out))
    warnings += on_other_clocks((*training, *held_out)) + _disagreeing(training) + seen_twice(training, held_out)
    if not held_out:
        warnings.append(
            "no recording was held out (--hold-out NAME, or 30% for the end of each): nothing shows that this fit holds on "
            "motions that it has not seen"
        )
    return warnings + _never_moving(training)


def _about(recording: Recording) -> list[str]:
    found = warnings_of(recording) + _lost(recording)
    command = command_of(recording)
    if command is not None and recording.has("position"):
        position = recording.channel("position")
        if command.name != "command_torque" and command.unit in ("", position.unit):  # torques lead where they like
            found += _far(recording.name, command, position)
    return found


def _silent(recordings: Sequence[Recording]) -> list[str]:
    """Recordings without commands beside others that have some."""
    silent = [r.name for r in recordings if command_of(r) is None]
    if len(silent) in (0, len(recordings)):
        return []
    return [
        f"{', '.join(silent)}: no command, unlike in the others; they are replayed as if nothing had been asked of them, "
        "so their errors say nothing of the model: name the command in the mapping, or leave them out"
    ]


def _disagreeing(training: Sequence[Recording]) -> list[str]:
    """Repeats of one command that part: what each does later is chance, and no parameter can replay all of them."""
    found = [together(group) for group in grouped(training) if all(r.has(c) for r in group for c in BASE)]
    return [
        f"{f.summary}: fit their average, which ends there (trueup.inspection.repeats.together), or a motion that repeats"
        for f in found
        if f.parted is not None
    ]


def _lost(recording: Recording) -> list[str]:
    gaps = {name: lost(recording.channel(name)) for name in BASE if recording.has(name)}
    return [
        f"'{recording.name}': '{name}' was lost from {gap[0]:.3g} to {gap[1]:.3g} s; nothing is compared there"
        for name, gap in gaps.items()
        if gap is not None
    ]


def doubtful_units(recordings: Sequence[Recording], replays: Sequence[Replay]) -> list[str]:
    """Radians that may be degrees. Joints that no command of a position leads and that `replays` follow are what they are: a
    pole that goes round and round swings otherwise than one that moves by as many degrees.
    """
    found = []
    for recording in recordings:
        command = command_of(recording)
        led = () if command is None or command.unit in ("N m", "N") else command.labels
        own = [r for r in replays if r.recording == recording.name and r.channel == "position"]
        followed = {label for r in own for label in _followed(r)} - {*led}
        for name in ("position", "command", "command_sent"):
            if recording.has(name):
                found += _units(recording.name, recording.channel(name), followed)
    return found


def _followed(replay: Replay) -> list[str]:
    """Labels of which a replay explains most of the motion."""
    moved = np.nanstd(replay.measured, axis=0)
    return [n for n, off, sd in zip(replay.labels, replay.rmse_after(), moved, strict=True) if off < HALVED * sd]


def _units(recording: str, channel: Channel, followed: Collection[str]) -> list[str]:
    largest = np.nanmax(np.abs(channel.values), axis=0, initial=0.0)
    big = [
        f"{label} reaches {v:.4g}"
        for label, v in zip(channel.labels, largest, strict=True)
        if channel.unit_of(label) == "rad" and hardly_radians(float(v)) and label not in followed
    ]
    if not big:
        return []
    return [
        f"'{recording}', channel '{channel.name}': {', '.join(big)} rad, more than two turns: are these degrees? "
        'then say unit = "deg" in the mapping'
    ]


def _far(recording: str, command: Channel, position: Channel) -> list[str]:
    """Command and position of different joints or units hardly follow one another."""
    labels = [x for x in position.labels if x in command.labels and command.unit_of(x) in ("", position.unit_of(x))]
    found = []
    held = command.select(labels).at(position.time, hold=True) if labels else np.zeros((0, 0))
    for j, label in enumerate(labels):
        moved, asked = position.column(label), held[:, j]
        spread, wanted = float(np.nanstd(moved)), float(np.nanstd(asked[np.isfinite(moved)]))
        if min(spread, wanted) < 1e-3:
            continue
        if correlation(moved, asked) < 0.3:
            best = _better_partner(command, position, label)
            if best:
                found.append(
                    f"'{recording}': position of '{label}' follows the command of '{best}', not its own: are the joints in "
                    "the wrong order?"
                )
            elif wanted > 0.1:
                found.append(f"'{recording}': position of '{label}' does not follow its own command")
    return found


def _better_partner(command: Channel, position: Channel, label: str) -> str:
    moved = position.column(label)
    held = command.at(position.time, hold=True)
    scores = {}
    for j, other in enumerate(command.labels):
        if other != label and float(np.nanstd(held[np.isfinite(moved), j])) > 1e-3:
            scores[other] = correlation(moved, held[:, j])
    best = max(scores, key=lambda k: scores[k], default="")
    return best if best and scores[best] > 0.8 else ""


def _never_moving(training: Sequence[Recording]) -> list[str]:
    moves: dict[str, float] = {}
    for recording in training:
        if recording.has("position"):
            channel = recording.channel("position")
            for label, span in zip(channel.labels, np.nanmax(channel.values, axis=0) - np.nanmin(channel.values, axis=0),
                                   strict=True):  # fmt: skip
                moves[label] = max(moves.get(label, 0.0), float(span))
    still = [label for label, span in moves.items() if span < 5e-3]
    return [
        f"joint '{label}' never moves in the recordings that are fitted: nothing can be learned of it"
        for label in still
    ]
