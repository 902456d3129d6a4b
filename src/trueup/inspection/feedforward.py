# SPDX-License-Identifier: Apache-2.0
"""Drives that are told a position, a speed, a torque and gains at once, as those of legged robots are: one command.

Their torque is kp (position - q) + kd (speed - dq) + torque. A position moved by (kd speed + torque) / kp asks a servo with
these gains for the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.inspection.relations import ALIKE, rate
from trueup.inspection.settings import ALL, setting
from trueup.recording import Channel, Recording
from trueup.rounding import TINY
from trueup.samples import MOSTLY, correlation

_UNITS = {"torque": "N m", "velocity": "rad/s"}
_SAID = {
    "moved": "speeds or torques were commanded beside positions, with gains that the log names ({}): what drives were told, "
    "kp (position - q) + kd (speed - dq) + torque, is taken as positions moved by (kd speed + torque) / kp",
    "idle torque": "torques commanded beside positions are zero all along ({}): they are left out",
    "idle velocity": "speeds commanded beside positions are zero all along ({}): they are left out",
    "unused": "torques or speeds were commanded beside positions, and the log does not name gains ({}): whether drives add "
    "them is not known. Of speeds it is asked whether the recordings want them (`lead`); torques are left out: if drives add "
    "these, name kp and kd (N m/rad, N m s/rad), in a column for each joint",
}


def with_feedforward(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings whose commanded positions stand for the speeds and torques commanded beside them too, and notes.

    They stay as they are where gains are not named, where units are not SI, and where the torques are all that acts,
    gains and positions counted in. What is zero all along is left out.
    """
    result, said = list(recordings), {key: [] for key in _SAID}
    for i, recording in enumerate(recordings):
        name = next((n for n in ("command_sent", "command") if recording.has(n)), "")
        parts = _beside(recording, name) if name else {}
        asked = {kind: channel for kind, channel in parts.items() if np.any(np.nan_to_num(channel.values))}
        changed = _moved(recording, recording.channel(name), asked) if asked else None
        unused = not setting(recording, "kp") and any(
            kind == "torque" or _is_added(kind, c, recording.channel(name)) for kind, c in asked.items()
        )
        idle = [f"idle {kind}" for kind in parts if kind not in asked]
        for key in (*(["moved"] if changed is not None else []), *idle, *(["unused"] if unused else [])):
            said[key].append(recording.name)
        result[i] = recording if changed is None else recording.with_channel(changed)
        for kind, channel in parts.items():
            if changed is not None or kind not in asked:
                result[i] = _without(result[i], channel)
    return result, [_SAID[key].format(", ".join(names)) for key, names in said.items() if names]


def _beside(recording: Recording, name: str) -> dict[str, Channel]:
    """Speeds and torques commanded beside the positions `name` of the same joints; those of others are these alone."""
    told = recording.channel(name).labels
    every = {kind: recording.channels.get(f"{name}_{kind}") for kind in _UNITS}
    shared = {kind: (c, [x for x in c.labels if x in told]) for kind, c in every.items() if c is not None}
    return {kind: c.select(labels) for kind, (c, labels) in shared.items() if labels}


def _without(recording: Recording, part: Channel) -> Recording:
    """Without a part of a channel, which goes where nothing else is in it."""
    whole = recording.channel(part.name)
    rest = [x for x in whole.labels if x not in part.labels]
    return recording.with_channel(whole.select(rest)) if rest else recording.without(whole.name)


def _moved(recording: Recording, command: Channel, parts: Mapping[str, Channel]) -> Channel | None:
    """Positions (T, k) that ask for the same torque; None where nothing is to be added, or gains or units do not tell."""
    gains = {"torque": dict.fromkeys(command.labels, 1.0), "velocity": setting(recording, "kv")}
    added = {kind: c for kind, c in parts.items() if _is_added(kind, c, command)}
    stiffness, values = setting(recording, "kp"), np.array(command.values)
    for column, label in enumerate(command.labels):
        more = np.zeros(len(values))
        for kind, channel in added.items():
            more += gains[kind].get(label, gains[kind].get(ALL, 0.0)) * _at(channel, label, command.time)
        kp = stiffness.get(label, stiffness.get(ALL, 0.0))
        if np.any(more) and (command.unit_of(label) != "rad" or not kp > 0.0):
            return None
        values[:, column] += more / kp if kp > 0.0 else 0.0
    changed = command.replace(values=values)
    if np.array_equal(values, command.values, equal_nan=True):
        return None
    return None if "torque" in added and _acts_alone(recording, command, added) else changed


def _is_added(kind: str, channel: Channel, command: Channel) -> bool:
    """Whether a signal commanded beside positions is one that drives add, and no limit."""
    if any(channel.unit_of(label) != _UNITS[kind] for label in channel.labels):
        return False
    if kind == "torque":
        return bool(np.any(np.nanmax(channel.values, axis=0) > np.nanmin(channel.values, axis=0)))
    pairs = []
    for label in (x for x in channel.labels if x in command.labels):
        when, wanted = rate(command.column(label), command.time)
        pairs.append((np.interp(when, channel.time, channel.column(label)), wanted))
    told, wanted = (np.concatenate(side) for side in zip(*pairs, strict=True)) if pairs else (np.zeros(2), np.zeros(2))
    return correlation(told, wanted) > ALIKE  # a greatest speed is commanded, too


def _acts_alone(recording: Recording, command: Channel, added: Mapping[str, Channel]) -> bool:
    """Whether the commanded torques are what gains make of the positions already, by what was measured."""
    if not recording.has("position"):
        return False
    position, kp, kd = recording.channel("position"), setting(recording, "kp"), setting(recording, "kv")
    torque, speed = added["torque"], added.get("velocity")
    measured = recording.channels.get("torque")
    measured = measured if measured is not None and measured.unit == _UNITS["torque"] else None
    alone, together = 0.0, 0.0
    left, own = np.zeros(3), np.zeros(3)
    for label in (x for x in torque.labels if x in position.labels and x in command.labels):
        time = position.time
        error = command.select([label]).at(time, hold=True)[:, 0] - position.column(label)
        pull = kp.get(label, kp.get(ALL, 0.0)) * error
        pace = np.zeros(len(time)) if speed is None else _at(speed, label, time)
        pull += kd.get(label, kd.get(ALL, 0.0)) * (pace - np.gradient(position.column(label), time))
        told = _at(torque, label, time)
        given = None if measured is None or label not in measured.labels else measured.select([label]).at(time)[:, 0]
        alone += float(np.nanvar(told - (pull if given is None else given)))
        together += float(np.nanvar(told + pull - (pull if given is None else given)))
        beyond = (told - pull, np.diff(told - pull, 2), np.diff(told[1:] - pull[:-1], 2))  # or by the sample before
        left += [float(np.nanvar(x)) for x in beyond]
        own += [float(np.nanvar(x)) for x in (told, np.diff(pull, 2), np.diff(pull, 2))]
    if measured is not None:
        return alone < together
    # Gains make mostly all of its variance, or of that of its change from sample to sample, which shows noise of positions
    # but no weight that is held beside.
    return bool(np.any(left < (1.0 - MOSTLY) * np.maximum(own, TINY)))


def _at(channel: Channel, label: str, time: Array) -> Array:
    """(T,) what is in force; 0 where nothing is."""
    if label not in channel.labels:
        return np.zeros(len(time))
    return np.nan_to_num(channel.select([label]).at(time, hold=True)[:, 0])
