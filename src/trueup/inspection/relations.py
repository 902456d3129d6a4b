# SPDX-License-Identifier: Apache-2.0
"""How one signal goes with another: as a multiple of it, or of its rate of change."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.noise import estimate_noise
from trueup.recording import Channel, Recording
from trueup.trial import command_of

CORRELATED = 0.9
"""Correlation from which one signal is called a multiple of another: a fifth of its variance may be something else."""
ALIKE = 0.5
"""Correlation from which one signal is of the same kind as another, and below its opposite of the other sign: a speed that is
told beside positions which are held from sample to sample (a greatest speed goes with none), wheels and turns of a drive."""
TOLERANCE = 0.12
"""Relative, of a factor or speed: units differ by more (rpm and rev/s beside rad/s by 1.5), delays and filters make less."""


def factor(values: Array, reference: Array) -> float | None:
    """How many times `reference` (T,) `values` (T,) are, offsets aside; None where they do not go together.

    The geometric mean of both regressions, which noise in one of them does not pull to zero.
    """
    fewest = 20  # Samples from which a correlation says something
    good = np.isfinite(values) & np.isfinite(reference)
    if np.count_nonzero(good) < fewest:
        return None
    x, y = reference[good] - reference[good].mean(), values[good] - values[good].mean()
    sizes, together = float(np.sqrt(np.sum(x**2) * np.sum(y**2))), float(np.sum(x * y))
    if sizes == 0.0 or abs(together) / sizes < CORRELATED:
        return None
    return float(np.sign(together) * np.sqrt(np.sum(y**2) / np.sum(x**2)))


def rate(values: Array, time: Array) -> tuple[Array, Array]:
    """Time (m,) and rate of change (m,) of `values` (T,) at `time` (T,) in s.

    Differences are taken over as many samples as the values usually need to change by ten times their noise, so that noise
    and encoder steps do not drown the rate.
    """
    noise = float(estimate_noise(values, time)[0])
    steps = np.diff(values)
    steps = steps[np.isfinite(steps)]
    usual = float(np.sqrt(np.mean(steps**2))) if steps.size else 0.0
    wanted = 10.0 * noise / usual if usual > 0.0 and math.isfinite(noise) else 1.0
    span = int(np.clip(math.ceil(wanted), 1, max(1, len(steps) // 20)))
    return 0.5 * (time[span:] + time[:-span]), (values[span:] - values[:-span]) / (time[span:] - time[:-span])


def nearest(value: float, known: Mapping[str, float]) -> str:
    """The name of the factor that a measured one is, within its tolerance; '' for none of them."""
    near = {name: abs(math.log(value / size)) for name, size in known.items() if value * size > 0.0}
    best = min(near, key=lambda name: near[name], default="")
    return best if best and near[best] < TOLERANCE else ""


def follows_by_speed(label: str, recordings: Sequence[Recording]) -> bool:
    """Whether a joint whose commands are called positions follows them by its speed rather than by where it is."""
    likeness = np.zeros(2)
    for recording in recordings:
        command, position = command_of(recording), recording.channels.get("position")
        if command is None or position is None or not {label} <= set(command.labels) & set(position.labels):
            continue
        if command.unit_of(label) != position.unit_of(label):
            return False
        likeness += _likeness(command.select([label]), position.select([label]))
    return bool(likeness[1] > max(likeness[0], 0.0))


def _likeness(command: Channel, position: Channel) -> Array:
    """(2,) correlations of a joint's command with its position and with its speed, each times the samples."""
    good = np.isfinite(position.values[:, 0])
    time, there = position.time[good], position.values[good, 0]
    told = command.at(time, hold=True)[:, 0]
    if len(time) < 3 or min(np.ptp(told), np.ptp(there)) <= 0.0:
        return np.zeros(2)
    return np.array([len(time) * np.corrcoef(told, v)[0, 1] for v in (there, np.gradient(there, time))])
