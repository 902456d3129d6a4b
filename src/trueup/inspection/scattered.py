# SPDX-License-Identifier: Apache-2.0
"""Joints that were logged apart from the others, as a gripper by a driver and a topic of its own: read with the rest."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from trueup.arrays import Array, Integers
from trueup.recording import Channel, Recording, is_command
from trueup.trial import COMMANDS
from trueup.units import hardly_radians

_KINDS = ("position", "velocity", "torque", "current", *COMMANDS)
APART = "seen by sensors of their own"
"""Key of the provenance that names the joints whose positions were logged apart from the others', a line each."""
_ALIKE = ({"rad", "m"}, {"rad/s", "m/s"}, {"N m", "N"}, {"A"})
"""Units that stand beside one another in a channel of hinges and slides."""


def gathered(
    recordings: Sequence[Recording], joints: Collection[str], *, filled: bool = False
) -> tuple[list[Recording], list[str]]:
    """Recordings whose channels hold all of the model's `joints` that were logged, and a note.

    A recording has one clock for all joints of a kind, a robot of several drivers one for each, under whatever name.
    Measurements of the others stand at the instants next to their own (with `filled` at all of them, in between too);
    commands at theirs. What has no unit has that of the others, as columns of one table have.
    """
    changed, told, unsaid = [], dict[str, list[str]](), dict[str, None]()
    for recording in recordings:
        for name, channel in sorted(recording.channels.items(), key=lambda item: -len(item[1].time)):
            kind = max((k for k in _KINDS if name.startswith(f"{k}_")), key=len, default="") or _by_labels(
                channel, joints
            )
            main = recording.channels.get(kind) if name not in _KINDS else None
            more = [j for j in channel.labels if main is not None and j in joints and j not in main.labels]
            if main is None or not more:
                continue
            if _unit_unsaid(channel, more, main):
                unsaid |= dict.fromkeys(more)
                channel = channel.replace(unit=main.unit)
            if not any({main.unit, channel.unit} <= units for units in _ALIKE):
                continue
            recording = recording.without(name).with_channel(_joined(main, channel.select(more), filled=filled))
            if rest := [label for label in channel.labels if label not in more]:
                recording = recording.with_channel(channel.select(rest))
            told[name] = list(dict.fromkeys([*told.get(name, []), *more]))
            if kind == "position":
                own = "\n".join(dict.fromkeys([*seen_apart([recording]), *more]))
                recording = recording.replace(provenance={**recording.provenance, APART: own})
        changed.append(recording)
    said = "; ".join(f"{', '.join(names)} from {name}" for name, names in told.items())
    said += f"; nothing says the unit of {', '.join(unsaid)}, which is taken as SI" if unsaid else ""
    return changed, [f"joints that were logged apart from the others are read with these: {said}"] if told else []


def seen_apart(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Joints whose positions were logged apart from the others', by whatever sensor and clock."""
    return tuple(dict.fromkeys(j for r in recordings for j in r.provenance.get(APART, "").splitlines()))


def _by_labels(channel: Channel, joints: Collection[str]) -> str:
    """The kind of a channel of any other name: angles and ways of nothing but the model's joints are their positions."""
    ways = {channel.unit_of(label) for label in channel.labels} <= _ALIKE[0]
    return "position" if ways and {*channel.labels} <= {*joints} and not is_command(channel.name) else ""


def _unit_unsaid(channel: Channel, more: Sequence[str], main: Channel) -> bool:
    """Whether nobody said the unit of these columns, and numbers do not speak against that of the others."""
    largest = float(np.nanmax(np.abs(channel.select(more).values), initial=0.0))
    if channel.unit or channel.units or not any(main.unit in units for units in _ALIKE):
        return False
    return main.unit != "rad" or not hardly_radians(largest)


def _joined(main: Channel, other: Channel, *, filled: bool) -> Channel:
    """A channel with the joints of both."""
    time, labels = main.time, (*main.labels, *other.labels)
    if is_command(main.name):
        time = np.union1d(main.time, other.time)
        values = np.concatenate([_given(main, time), _given(other, time)], axis=1)
    else:
        seen = other.at(time)
        if not filled:
            seen[~np.isin(np.arange(len(time)), _nearest(time, other.time))] = np.nan
        values = np.concatenate([main.values, seen], axis=1)
    units = tuple([*(main.unit_of(j) for j in main.labels), *(other.unit_of(j) for j in other.labels)])
    return main.replace(labels=labels, time=time, values=values, units=units if len(set(units)) > 1 else ())


def _given(channel: Channel, time: Array) -> Array:
    """(T, k) what was commanded at these instants, NaN where nothing was: what was stays in force."""
    values = np.full((len(time), len(channel.labels)), np.nan)
    values[np.searchsorted(time, channel.time)] = channel.values
    return values


def _nearest(time: Array, instants: Array) -> Integers:
    """Which of the times (T,) lie next to an instant each."""
    after = np.clip(np.searchsorted(time, instants), 1, len(time) - 1)
    return after - (instants - time[after - 1] < time[after] - instants)
