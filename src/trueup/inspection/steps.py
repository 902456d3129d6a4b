# SPDX-License-Identifier: Apache-2.0
"""Drives that do not jump when their command does: limits of speed and acceleration, told from how long steps take."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.inspection.relations import TOLERANCE
from trueup.instant import STILL
from trueup.recording import Channel, Recording
from trueup.samples import MOST
from trueup.trial import command_of
from trueup.units import AS_FAR

_SAME_SPEED, _SAME_ACCELERATION = 0.3, 0.65  # exponents of speed by size of the step: 0, 1/2; linear servos have 1


def profiles(servos: Mapping[str, str], recordings: Sequence[Recording]) -> tuple[dict[str, float], dict[str, float]]:
    """Joints whose steps take as long as a limited speed needs, with that speed in rad/s (m/s); the same of acceleration.

    A servo without limits is twice as fast on a step of twice the size, one with a limited speed as fast, one with
    limited acceleration in between. Both limits are given where the speed is limited: the second, as a start, is
    reached in a tenth of a second. `servos`: joints with a position servo, each with its actuator's name.
    """
    fewest = 4  # steps from which a law is told
    speed: dict[str, float] = {}
    acceleration: dict[str, float] = {}
    for joint, actuator in servos.items():
        found = _steps(joint, actuator, recordings)
        law = _law(found) if len(found) >= fewest else None
        if law is None or law[0] >= _SAME_ACCELERATION:
            continue
        _, fastest, steepest = law
        if law[0] < _SAME_SPEED:
            speed[joint], acceleration[joint] = fastest, 10.0 * fastest
        else:
            acceleration[joint] = steepest
    return speed, acceleration


def accelerations(joint: str, actuator: str, recordings: Sequence[Recording]) -> Array:
    """(n,) acceleration in rad/s2 (m/s2) of each step of a joint's command, were it half speeding up, half slowing down."""
    return _acceleration(*_steps(joint, actuator, recordings).T)


def _acceleration(size: Array, speed: Array) -> Array:
    """(n,) of steps at such speeds in the middle half of the way: half way takes sqrt(size / acceleration) from rest, a
    quarter of it 1 / sqrt(2) of that, and slowing down is the same backwards.
    """
    seconds = 0.5 * size / speed
    return size * ((2.0 - np.sqrt(2.0)) / seconds) ** 2


def _steps(joint: str, actuator: str, recordings: Sequence[Recording]) -> Array:
    """(n, 2) size and speed of the steps of a joint's command in all recordings."""
    return np.array([step for r in recordings for step in _steps_of(r, joint, actuator)]).reshape(-1, 2)


def _law(found: Array) -> tuple[float, float, float] | None:
    """Exponent of the speed by the size of the step; speed and acceleration at steps (n, 2); None where there is none."""
    size, speed = found.T
    if size.max() < AS_FAR * size.min():
        return None
    exponent, level = np.polyfit(np.log(size), np.log(speed), 1)
    if np.std(np.log(speed) - level - exponent * np.log(size)) > TOLERANCE:
        return None
    large = size >= np.median(size)
    return float(exponent), float(np.median(speed[large])), float(np.median(_acceleration(size, speed)))


def _steps_of(recording: Recording, joint: str, actuator: str) -> Iterator[tuple[float, float]]:
    """Size and speed of each step of a joint's command that was held until the joint arrived."""
    command = command_of(recording)
    label = next((x for x in command.labels if x in (joint, actuator)), "") if command is not None else ""
    if command is None or not label or not recording.has("position"):
        return
    position = recording.channel("position")
    if joint not in position.labels or command.unit_of(label) not in ("rad", "m"):
        return
    told = command.column(label)
    moves = np.abs(np.diff(told))
    for i in np.flatnonzero(moves > STILL):
        if i > 0 and moves[i - 1] > 1e-3:
            continue  # one of many small ones
        later = np.flatnonzero(moves[i + 1 :] > 1e-3)
        end = command.time[i + 2 + later[0] - 1] if len(later) else command.time[-1]
        step = _passage(position, joint, float(command.time[i + 1]), float(end), float(moves[i]))
        if step is not None:
            yield step


def _passage(position: Channel, joint: str, begin: float, end: float, asked: float) -> tuple[float, float] | None:
    """How far a joint went between two times, and its mean speed from a quarter to three quarters of the way."""
    inside = (position.time >= begin) & (position.time <= end)
    time, values = position.time[inside], position.column(joint)[inside]
    time, values = time[np.isfinite(values)], values[np.isfinite(values)]
    if len(values) < 8:
        return None
    went = float(np.mean(values[-max(1, len(values) // 8) :]) - values[0])
    if abs(went) < max(STILL, MOST * asked):
        return None
    share = (values - values[0]) / went
    first, last = (_reached(time, share, level) for level in (0.25, 0.75))
    return (abs(went), 0.5 * abs(went) / (last - first)) if last > first else None


def _reached(time: Array, share: Array, level: float) -> float:
    """When a share of the way was first passed, in s."""
    k = int(np.argmax(share > level))
    if k == 0:
        return float(time[0])
    return float(time[k - 1] + (level - share[k - 1]) / (share[k] - share[k - 1]) * (time[k] - time[k - 1]))
