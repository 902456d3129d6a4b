# SPDX-License-Identifier: Apache-2.0
"""The frequency up to which a log shows motion rather than noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.identification.estimation.filtering import derivative, slow_cutoff
from trueup.identification.estimation.missing import clear_of
from trueup.identification.estimation.motion import Log
from trueup.noise import FEWEST
from trueup.rounding import TINY
from trueup.samples import between

_NOISY = 0.1  # share of accelerations that noise may be


def natural_cutoff(logs: Sequence[Log]) -> float:
    """A cut-off in Hz from the motion: five times the frequency below which 99 % of the speeds' power lies, or where the
    noise of accelerations reaches a tenth of them, whichever is lower.

    At least 5 Hz, at most 40 Hz or 0.16 of the rate: torque above is noise, ripple and elasticity.
    """
    found = []
    for log in logs:
        frequency, power, noise = _speed_power(log)
        seen = power[frequency <= min(20.0, 0.15 * log.rate)]
        share = np.cumsum(seen / np.maximum(seen.sum(axis=0), TINY), axis=0).mean(axis=1)
        found.append(min(5.0 * float(frequency[int(np.searchsorted(share, 0.99))]), _quiet(frequency, power, noise)))
    lowest = min(log.rate for log in logs)
    return float(np.clip(round(max(found), 1), slow_cutoff(lowest), min(40.0, 0.16 * lowest)))


def _quiet(frequency: Array, power: Array, noise: Array) -> float:
    """The frequency in Hz up to which noise is less than `_NOISY` of the accelerations, in the median of the joints.

    `power` and `noise` (F, n) are those of speeds.
    """
    squares = frequency[:, None] ** 2
    share = np.cumsum(noise * squares, axis=0) / np.maximum((power * squares).sum(axis=0), TINY)
    loud = np.flatnonzero(np.median(share, axis=1) > _NOISY**2)
    return float(frequency[loud[0]]) if len(loud) else np.inf


def _speed_power(log: Log) -> tuple[Array, Array, Array]:
    """(F,) Hz, (F, n) power of the joints' speeds, that of white noise in the positions taken away, and that of the noise.

    Differences of noisy positions hold ever more power towards high frequencies; it is not motion.
    """
    v = _bridged(derivative(log.position, log.rate), log)
    power = np.abs(np.fft.rfft(v - v.mean(axis=0), axis=0)) ** 2
    frequency = np.asarray(np.fft.rfftfreq(len(v), 1.0 / log.rate), dtype=np.float64)
    differences = (log.rate * np.sin(2.0 * np.pi * frequency / log.rate))[:, None] ** 2
    high = (frequency > 0.25 * log.rate) & (frequency < 0.45 * log.rate)
    noise = np.median(power[high] / differences[high], axis=0) / np.log(2.0)  # of white noise: power is exponential
    expected = noise * differences
    # Noise scatters about what is expected: single frequencies say little, the mean of many does.
    count = min(FEWEST, len(power))
    near = np.stack([np.convolve(p, np.full(count, 1.0 / count), mode="same") for p in power.T], axis=1)
    moving = np.where(near > 2.0 * expected, np.maximum(power - expected, 0.0), 0.0)
    return frequency, moving, expected


def _bridged(speeds: Array, log: Log) -> Array:
    """Speeds (T, n) that go straight on over the gaps of a log: what is not fitted there (a collision) is no motion of its
    own.
    """
    if not log.gaps:
        return speeds
    known = clear_of(log.gaps, log.time)
    return between(log.time, log.time[known], speeds[known]) if known.any() else speeds
