# SPDX-License-Identifier: Apache-2.0
"""Which sensor of a model a channel of x, y and z is: by its name, or as the only accelerometer or gyro that there is."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.recording import Channel, Recording
from trueup.samples import between, is_unit

_AXES = ("x", "y", "z")
_QUATERNION = ("w", "x", "y", "z")
_WORDS = {"m/s^2": re.compile(r"acc", re.I), "rad/s": re.compile(r"gyr|omega|ang(ular)?_?(vel|rate)", re.I)}
"""What a sensor measures, in SI, and names of channels that say so."""


def sensed(recordings: Sequence[Recording], sensors: Mapping[str, str]) -> dict[str, str]:
    """Channels of x, y and z, or labelled so, each to the sensor of the model that it is. `sensors`: those of three numbers,
    each to the unit of what it measures: 'm/s^2' of an accelerometer, 'rad/s' of a gyro, '' of any other.
    """
    every = [(name, c.labels) for r in recordings for name, c in r.channels.items()]
    channels = dict.fromkeys(name for name, labels in every if sorted(labels) == list(_AXES))
    found = {name: s for name, labels in every for s in sensors if sorted(labels) == list(labels_of(s, _AXES))}
    found |= {name: name for name in channels if name in sensors}
    for unit, words in _WORDS.items():
        alike = [name for name in channels if words.search(name)]
        only = [name for name, measured in sensors.items() if measured == unit]
        if len(alike) == len(only) == 1 and only[0] not in found.values():
            found.setdefault(alike[0], only[0])
    return found


def is_accelerometer(channel: Channel) -> bool:
    """Whether a channel is an accelerometer's, by its unit or its name."""
    return channel.unit == "m/s^2" or bool(_WORDS["m/s^2"].search(channel.name))


def is_gyro(name: str) -> bool:
    """Whether a channel of this name is a gyro's."""
    return bool(_WORDS["rad/s"].search(name))


def labels_of(sensor: str, axes: Sequence[str]) -> tuple[str, ...]:
    """By which columns along these axes are known to be a sensor's."""
    return tuple(f"{sensor}.{axis}" for axis in axes)


def with_sensors(sensors: Mapping[str, str], recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings whose channels of sensors have the model's labels, where they are in the sensor's unit, and a note."""
    found, named, result = sensed(recordings, sensors), dict[str, str](), []
    for recording in recordings:
        for name, sensor in found.items():
            channel = recording.channels.get(name)
            if channel is None or sorted(channel.labels) != list(_AXES) or sensors[sensor] not in ("", channel.unit):
                continue
            recording = recording.with_channel(channel.replace(labels=labels_of(sensor, channel.labels)))
            named[name] = sensor
        result.append(recording)
    said = ", ".join(name if name == sensor else f"{name} ({sensor})" for name, sensor in named.items())
    note = f"compared with sensors of the model, by their names or as the only ones of their kind: {said}"
    return result, [note] if said else []


def in_other_units(sensors: Mapping[str, str], recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A sentence for each channel that is a sensor's by its name and not by its unit."""
    said = []
    for name, sensor in sensed(recordings, sensors).items():
        units = {r.channels[name].unit for r in recordings if name in r.channels}
        if sensors[sensor] and units != {sensors[sensor]}:
            given = ", ".join(f"'{unit}'" for unit in sorted(units))
            said.append(
                f"channel '{name}' seems to be the model's sensor '{sensor}', yet its unit is {given}: say "
                f"{sensors[sensor]}, or what it is, in the mapping"
            )
    return tuple(said)


def turned(recordings: Sequence[Recording]) -> tuple[float, str]:
    """How far, in rad, what a gyro is on turned within a second at most, and the gyro's channel; 0.0 and '' without one in
    rad/s. Its bias is the median of what it shows. An inertial unit's quaternions (w, x, y, z) tell it, too, in no unit.
    """
    most = (0.0, "")
    for recording in recordings:
        for name, c in recording.channels.items():
            good = np.isfinite(c.values).all(axis=1)
            time, values = c.time[good], c.values[good]
            if len(time) < 2:
                continue
            if sorted(c.labels) == list(_QUATERNION) and is_unit(values):
                most = max(most, (_turned_apart(time, c.select(_QUATERNION).values[good]), name))
            elif c.unit == "rad/s" and c.values.shape[1] == len(_AXES) and _WORDS["rad/s"].search(name):
                rates = values - np.median(values, axis=0)
                angles = np.vstack([np.zeros(3), np.cumsum(rates[:-1] * np.diff(time)[:, None], axis=0)])
                later = between(time + 1.0, time, angles)
                most = max(most, (float(np.max(np.abs(later - angles))), name))
    return most


def _turned_apart(time: Array, quaternions: Array) -> float:
    """The largest angle in rad between quaternions (T, 4) a second apart."""
    later = np.minimum(np.searchsorted(time, time + 1.0), len(time) - 1)
    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    return float(np.max(2.0 * np.arccos(np.clip(np.abs(np.sum(unit * unit[later], axis=1)), 0.0, 1.0))))
