# SPDX-License-Identifier: Apache-2.0
"""Positions whose unit nobody said: what they are, told from how far the joints of the model can move."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.recording import Channel, Recording
from trueup.simulators.mujoco.model import Model
from trueup.simulators.mujoco.wiring import joint_id
from trueup.trial import COMMANDS
from trueup.units import to_si

Array = NDArray[np.float64]

_BEYOND = 0.2  # rad that a joint may be found beyond its range: zeros and ranges of models are not exact
_FREE = 2.0 * np.pi  # rad: as far as joints without a range are taken to turn


def with_units(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings whose positions and commands, where they have no unit, are in rad, and a note on what was assumed.

    Degrees, where all measured positions then lie in the joints' ranges; else nothing is changed.
    """
    without = [r for r in recordings if r.has("position") and not r.channel("position").unit]
    if not without or not all(_within(model, r.channel("position")) for r in without):
        return list(recordings), []
    names = ", ".join(r.name for r in without)
    note = (
        f"positions without a unit are taken as degrees, which fits the joints' ranges ({names}); if they are percent "
        'of a range (LeRobot\'s -100 ... 100), give unit = "rad" with scale and offset in the mapping'
    )
    return [_in_rad(r) if r in without else r for r in recordings], [note]


def of_slides(model: Model, recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings whose positions and commands of slides are said to be in m (N for forces), beside hinges in rad."""
    compiled = model.compiled
    slides = {j for j in model.scalar_joints() if compiled.jnt_type[joint_id(compiled, j)] == mujoco.mjtJoint.mjJNT_SLIDE}
    linear = {"rad": "m", "rad/s": "m/s", "N m": "N"}
    result = []
    for recording in recordings:
        for channel in recording.channels.values():
            if channel.unit not in linear or not slides & set(channel.labels):
                continue
            units = tuple(linear[channel.unit] if label in slides else channel.unit for label in channel.labels)
            alike = len(set(units)) == 1
            recording = recording.with_channel(channel.replace(unit=units[0]) if alike else channel.replace(units=units))
        result.append(recording)
    return result


def _within(model: Model, channel: Channel) -> bool:
    """Whether every joint that the model has stays in its range, the numbers taken as degrees."""
    _, factor, _ = to_si("deg")
    ranges = {label: _range(model, label) for label in channel.labels if label in model.scalar_joints()}
    for label, (lower, upper) in ranges.items():
        column = channel.column(label) * factor
        column = column[np.isfinite(column)]
        if len(column) and (column.min() < lower - _BEYOND or column.max() > upper + _BEYOND):
            return False
    return bool(ranges)


def _range(model: Model, joint: str) -> tuple[float, float]:
    compiled, j = model.compiled, joint_id(model.compiled, joint)
    if not compiled.jnt_limited[j]:
        return -_FREE, _FREE
    return float(compiled.jnt_range[j, 0]), float(compiled.jnt_range[j, 1])


def _in_rad(recording: Recording) -> Recording:
    _, factor, _ = to_si("deg")
    for name in ("position", *COMMANDS[:2]):
        if recording.has(name) and not (channel := recording.channel(name)).unit:
            recording = recording.with_channel(channel.replace(unit="rad", values=channel.values * factor))
    if recording.has("velocity") and not (speed := recording.channel("velocity")).unit:
        recording = recording.with_channel(speed.replace(unit="rad/s", values=speed.values * factor))
    return recording
