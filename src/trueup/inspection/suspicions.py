# SPDX-License-Identifier: Apache-2.0
"""Units and signs that cannot be right, told from the size of numbers and from how channels fit together."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from trueup.noise import estimate_noise
from trueup.recording import Channel, Recording
from trueup.units import FURTHEST_TURN

Array = NDArray[np.float64]

_LARGEST_SPEED = 60.0  # rad/s, of a joint
_LARGEST_CURRENT = 60.0  # A
_LARGEST_TORQUE = 5e3  # N m
_RATIOS = (
    (180.0 / math.pi, "{a} is in degrees and {b} in radians"),
    (math.pi / 180.0, "{a} is in radians and {b} in degrees"),
    (60.0 / (2.0 * math.pi), "{a} is in revolutions per minute and {b} in radians"),
    (1.0 / (2.0 * math.pi), "{a} is in revolutions and {b} in radians"),
    (2.0 * math.pi, "{a} is in radians and {b} in revolutions"),
    (1000.0, "{a} is in thousandths of the unit of {b}"),
    (0.001, "{b} is in thousandths of the unit of {a}"),
    (-1.0, "{a} has the other sign than {b}"),
)
_VEHICLES = frozenset({"throttle", "speed", "steering", "turn", "x", "latitude"})  # commands and places are no angles
_TOLERANCE = 0.12  # of a ratio
_CORRELATED = 0.9


def suspicions(recording: Recording) -> Iterator[str]:
    """Sentences about units and signs that cannot be right, and what to write into the mapping."""
    yield from _too_large(recording)
    yield from _unsigned(recording)
    yield from _ratios(recording)


def _too_large(recording: Recording) -> Iterator[str]:
    limits = {
        "position": ("rad", FURTHEST_TURN, "degrees", "deg"),
        "command": ("rad", FURTHEST_TURN, "degrees", "deg"),
        "command_sent": ("rad", FURTHEST_TURN, "degrees", "deg"),
        "velocity": ("rad/s", _LARGEST_SPEED, "degrees per second (or rpm)", "deg/s"),
        "current": ("A", _LARGEST_CURRENT, "milliamperes", "mA"),
        "torque": ("N m", _LARGEST_TORQUE, "thousandths of a newton metre", "mN m"),
    }
    for name, (unit, limit, suspected, written) in limits.items():
        channel = recording.channels.get(name)
        if channel is None or channel.unit not in (unit, "") or _VEHICLES & set(channel.labels):
            continue
        sizes = np.where(np.isnan(channel.values), 0.0, np.abs(channel.values)).max(axis=0)
        if sizes.max() <= limit:
            continue
        worst = int(np.argmax(sizes))
        reached = f"{sizes[worst]:.4g} {channel.unit}".rstrip()
        geared = ", or the angle of a motor before its gear" if unit == "rad" else ""
        yield (
            f"{name}: {channel.labels[worst]} reaches {reached}: {suspected} suspected{geared}. "
            f'If so, set unit = "{written}" in the mapping'
        )


def _unsigned(recording: Recording) -> Iterator[str]:
    """A torque or current without sign, though the joint moves both ways."""
    velocity = recording.channels.get("velocity")
    for name in ("torque", "current", "load"):
        channel = recording.channels.get(name)
        if channel is None or velocity is None:
            continue
        lowest, highest = np.fmin.reduce(channel.values, axis=None), np.fmax.reduce(channel.values, axis=None)
        moving = [label for label in channel.labels if label in velocity.labels and _both_ways(velocity, label)]
        # One joint that carries a load may well need torque of one sign only; several hardly do.
        if len(channel.labels) > 1 and moving and lowest >= 0.0 and highest > 0.0:
            yield (
                f"{name}: no value is ever negative though joints move both ways ({', '.join(moving)}), so this seems "
                "to be a size without a sign. Do not fit it as it stands"
            )


def _both_ways(velocity: Channel, label: str) -> bool:
    speed = velocity.column(label)
    return bool(np.mean(speed > 0.0) > 0.1 and np.mean(speed < 0.0) > 0.1)


def _ratios(recording: Recording) -> Iterator[str]:
    position = recording.channels.get("position")
    if position is None:
        return
    for name in ("command", "command_sent"):
        if name in recording.channels:
            yield from _compare(recording.channels[name], position, recording.channels[name].name, "position", False)
    if "velocity" in recording.channels:
        yield from _compare(recording.channels["velocity"], position, "velocity", "the derivative of position", True)


def _compare(channel: Channel, position: Channel, a: str, b: str, derive: bool) -> Iterator[str]:
    """Whether one channel is a known multiple of the other, joint by joint; sentences name the joints together."""
    found: dict[str, list[str]] = {}
    for label in channel.labels:
        if label in position.labels:
            ratio = _ratio(channel, position, label, derive)
            for known, sentence in _RATIOS:
                if ratio is not None and abs(ratio / known - 1.0) < _TOLERANCE:
                    found.setdefault(f"{known:.3g} times {b}: {sentence.format(a=a, b=b)}", []).append(label)
    for sentence, labels in found.items():
        yield f"{a} of {', '.join(labels)} is about {sentence}? Correct unit or sign in the mapping"


def _ratio(channel: Channel, position: Channel, label: str, derive: bool) -> float | None:
    """Slope of `channel` over position (or its derivative); None where they do not go together."""
    reference, time = position.column(label), position.time
    if derive:
        if len(time) < 20:
            return None
        # Differences over several samples, so that noise and encoder steps do not drown the speed.
        span = _span(position, label)
        time, reference = (
            0.5 * (time[span:] + time[:-span]),
            (reference[span:] - reference[:-span]) / (time[span:] - time[:-span]),
        )
    values = channel.select([label]).at(time, hold=not derive)[:, 0]
    good = np.isfinite(values) & np.isfinite(reference)
    if np.count_nonzero(good) < 20:
        return None
    x, y = reference[good] - reference[good].mean(), values[good] - values[good].mean()
    sizes = float(np.sqrt(np.sum(x**2) * np.sum(y**2)))
    if sizes == 0.0 or abs(float(np.sum(x * y))) / sizes < _CORRELATED:
        return None
    # The geometric mean of both regressions is not pulled to zero by noise in one of them.
    return float(np.sign(np.sum(x * y)) * np.sqrt(np.sum(y**2) / np.sum(x**2)))


def _span(position: Channel, label: str) -> int:
    """Samples over which the position usually changes by ten times its noise."""
    noise = float(estimate_noise(position.column(label), position.time)[0])
    steps = np.diff(position.column(label))
    steps = steps[np.isfinite(steps)]
    usual = float(np.sqrt(np.mean(steps**2))) if steps.size else 0.0
    wanted = 10.0 * noise / usual if usual > 0.0 and math.isfinite(noise) else 1.0
    return int(np.clip(math.ceil(wanted), 1, max(1, len(steps) // 20)))
