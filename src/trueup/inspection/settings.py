# SPDX-License-Identifier: Apache-2.0
"""Settings of servos that recordings name, joint by joint: stiffness and damping as their firmware counts them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.inspection.diagnosis import few
from trueup.recording import Channel, Recording
from trueup.samples import MOST

GAINS: Mapping[str, tuple[str, ...]] = {
    "kp": ("kp", "p_gain", "kp_gain", "position_p_gain", "p_coefficient"),
    "kv": ("kd", "kv", "d_gain", "kd_gain", "position_d_gain", "d_coefficient"),
}
"""Quantity to the words under which a log names the servo's setting, as a channel or as a fact beside its signals."""
ALL = ""
"""Stands for every joint where a recording names one setting for all."""
_VOLTAGES = ("voltage", "vin", "supply_voltage", "battery_voltage", "input_voltage", "bus_voltage", "battery")
"""Under which a log names what feeds its drives, as a channel or a fact."""
_ONE_BATTERY = 1.15
"""Voltage of a lithium cell, full, over that of the same one half empty (4.2 V, 3.65 V)."""


def setting(recording: Recording, quantity: str) -> dict[str, float]:
    """What a recording names of a quantity ('kp', 'kv') by joint, `ALL` for all of them; {} where it names nothing.

    Of a setting that changes it is the median.
    """
    channel = _channel(recording, quantity)
    if channel is None:
        return _fact(recording, quantity)
    found = {
        label: float(np.median(known))
        for label, column in zip(channel.labels, channel.values.T, strict=True)
        if len(known := column[np.isfinite(column)])
    }
    return {ALL: next(iter(found.values()))} if len(found) == 1 and not _joints(recording) & set(found) else found


def with_steady_gains(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings cut to where the gains of their servos stay the same, where that is most of one, and notes.

    Robots are often switched to their gains while the log already runs.
    """
    result, notes = [], []
    for recording in recordings:
        changing = [s for q in GAINS if (c := _channel(recording, q)) is not None for s in _changes(c, recording)]
        if not changing:
            result.append(recording)
            continue
        first, last = _longest(recording)
        enough = last - first >= MOST * recording.duration
        result.append(recording.slice(first, last) if enough else recording)
        done = (
            f"what is taken of it is where they do not, {first:.4g} to {last:.4g} s" if enough else
            "it is replayed with the median of each, though that is not what it was recorded with; make a file of each gain"
        )  # fmt: skip
        notes.append(f"gains of servos change within '{recording.name}' ({few(changing)}): {done}")
    return result, notes


def at_other_voltages(recordings: Sequence[Recording]) -> list[str]:
    """A sentence where supplies have voltages that differ by more than those of one battery under load, from recording to
    recording or within one.
    """
    named = {r.name: volts for r in recordings if (volts := _voltages(r))}
    goes = (
        "stiffness of servos that drive their motor by duty goes with it, and the greatest speed of any, which nothing here "
        "follows"
    )
    sags = [f"'{n}' {v[0]:.3g} to {v[-1]:.3g}" for n, v in named.items() if max(v) >= _ONE_BATTERY * min(v)]
    if sags:
        return [
            f"the supply's voltage changes within recordings ({few(sags)}): {goes}. What is found is of the mean of them"
        ]
    low, high = (f(named, key=lambda name: float(np.median(named[name])), default="") for f in (min, max))
    least, most = (float(np.median(named.get(name, (0.0,)))) for name in (low, high))
    if most < _ONE_BATTERY * least or not named:
        return []
    return [
        f"recordings were made at other supply voltages, {least:.3g} ('{low}') to {most:.3g} ('{high}'): {goes}. Calibrate "
        "those of each voltage by themselves"
    ]


def _voltages(recording: Recording) -> tuple[float, ...]:
    """The supply's voltage in whatever unit, at the beginning and the end of a line through it, which dips of a moment hardly
    tilt; () where a recording names none.
    """
    for name in _VOLTAGES:
        if recording.has(name):
            channel = recording.channel(name)
            known = np.isfinite(channel.values).any(axis=1)
            time, values = channel.time[known], np.nanmean(channel.values[known], axis=1)
            line = np.polynomial.Polynomial.fit(time, values, int(len(time) > 1)) if len(time) else None
            found = () if line is None else tuple(line(time[[0, -1]]).tolist())
            return found if found and min(found) > 0.0 else ()
    facts = {key.lower().rsplit(".", 1)[-1]: text for key, text in recording.provenance.items()}
    said = (_numbers(facts[name], ALL, recording).get(ALL, 0.0) for name in _VOLTAGES if name in facts)
    volts = next(said, 0.0)
    return (volts,) if volts > 0.0 else ()


def _joints(recording: Recording) -> set[str]:
    """Labels of what moves or is told to."""
    return {label for name, c in recording.channels.items() if name.split("_")[0] in ("position", "command")
            for label in c.labels}  # fmt: skip


def _channel(recording: Recording, quantity: str) -> Channel | None:
    return next((recording.channel(word) for word in GAINS[quantity] if recording.has(word)), None)


def _changes(channel: Channel, recording: Recording) -> list[str]:
    """What changes in a channel of gains, in words; only of joints where it names them."""
    joints = _joints(recording)
    told = [label for label in channel.labels if label in joints] or list(channel.labels)
    spans = [(label, np.fmin.reduce(c := channel.column(label)), np.fmax.reduce(c)) for label in told]
    return [
        f"{channel.name}{f' of {label}' if label in joints else ''} {low:g} ... {high:g}"
        for label, low, high in spans if high > low
    ]  # fmt: skip


def _longest(recording: Recording) -> tuple[float, float]:
    """From when to when all gains stay the same, in s: the longest such stretch."""
    edges = [np.array([recording.start, recording.stop])]
    for channel in (c for q in GAINS if (c := _channel(recording, q)) is not None):
        known = channel.values[np.isfinite(channel.values).all(axis=1)]
        time = channel.time[np.isfinite(channel.values).all(axis=1)]
        edges.append(time[1:][np.any(np.diff(known, axis=0) != 0.0, axis=1)])
    at: Array = np.unique(np.concatenate(edges))
    k = int(np.argmax(np.diff(at)))
    before = recording.time[recording.time < at[k + 1]]
    return float(at[k]), float(at[k + 1] if k + 2 == len(at) else before[-1])


def _fact(recording: Recording, quantity: str) -> dict[str, float]:
    """What is said beside the signals: `kp`, `servo.kp`, `kp.knee`, or a list with a number for each joint."""
    joints = _joints(recording)
    found: dict[str, float] = {}
    for word in GAINS[quantity]:
        for key, text in recording.provenance.items():
            parts = [part for part in re.split(r"[./]", key) if part]
            if word not in [part.lower() for part in parts]:
                continue
            joint = next((part for part in parts if part in joints), ALL)
            found |= _numbers(text, joint, recording)
        if found:
            return found
    return {}


def _numbers(text: str, joint: str, recording: Recording) -> dict[str, float]:
    """Settings in a text: one number, or one for each joint that is commanded, in order; {} for anything else."""
    try:
        values = [float(part) for part in re.split(r"[\s,;]+", text.strip("[]() "))]
    except ValueError:
        return {}
    if len(values) == 1:
        return {joint: values[0]}
    for name in ("command", "position"):
        if recording.has(name) and len(recording.channel(name).labels) == len(values):
            return dict(zip(recording.channel(name).labels, values, strict=True))
    return {}
