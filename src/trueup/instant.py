# SPDX-License-Identifier: Apache-2.0
"""Where something was at an instant and how fast, from noisy samples around it, with standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from trueup.arrays import Array
from trueup.evidence import STANDARD_ERRORS
from trueup.noise import estimate_noise
from trueup.recording import Channel
from trueup.rounding import ROUNDED

REACH = 0.25
"""s to either side: what lies further off says nothing of an instant."""
_GROWTH = 1.5  # each window holds so many times the samples of the one before


LOOKS = 100
"""Instants of a run at which something is looked at that costs a simulation: a median is then known to a tenth."""
CUBIC = 0.08
"""s that a cubic is laid through for speeds and accelerations: five samples of a servo bus at 50 Hz."""
MOVING = 3.0
"""Standard deviations of a speed's noise from which on something moves."""
HARDLY = 0.05
"""Of the fastest speed, of the full command, of a range: what is less hardly moves, and noise decides its sign."""
MISSING = 1.75
"""Usual steps: where the next sample comes later than that one is missing: two steps, less what a clock jitters. With 1.5,
logs of a servo on a busy bus (280 Hz) and of a car at 10 Hz would miss samples which they have."""
STILL = 0.02
"""rad (m): a joint that goes less far rests, and so does a base."""


@dataclass(frozen=True, eq=False)
class Instant:
    """Values and speeds (k,) of a channel's labels at one instant, with standard deviations; NaN where unmeasured."""

    value: Array
    speed: Array
    value_sd: Array
    speed_sd: Array
    acceleration: Array
    """0 where speeds were measured, or none is seen."""

    def speed_of_steps(self, step: float) -> Array:
        """(k,) the speed that semi-implicit steps of `step` s begin with to pass here as fast: they move by the speed at the
        end of each, so that what goes through these positions has its speeds half a step earlier.
        """
        return self.speed - 0.5 * step * self.acceleration


def usual_step(time: Array) -> float:
    """The usual time between samples at (T,) instants, in s, which gaps do not move: the mean of all that is within half the
    median of it, since of stamps in whole milliseconds the median is one as well (17 ms of 60 Hz).
    """
    steps = np.diff(time)
    middle = float(np.median(steps))
    return float(np.mean(steps[np.abs(steps - middle) <= 0.5 * abs(middle)])) if np.isfinite(middle) else middle


def samples_of_cubic(step: float) -> int:
    """How many samples, `step` s apart, each part of a `moving_cubic` is laid through: an odd number, more than decide it."""
    return 2 * max(round(0.5 * CUBIC / step), 2) + 1


def moving_cubic(values: Array, step: float) -> Array:
    """(3, T, ...) samples (T, ...) that lie `step` s apart, smoothed, their rates and the rates of these.

    A. Savitzky, M. Golay, Analytical Chemistry 36(8), 1964; of few samples by one polynomial through all.
    """
    from scipy.signal import savgol_filter  # takes long to import

    window = min(samples_of_cubic(step), len(values) - 1 + len(values) % 2)
    degree = min(3, window - 1)
    each = (savgol_filter(values, window, degree, deriv=order, delta=step, axis=0) for order in range(3))
    return np.stack([np.asarray(values, dtype=np.float64) for values in each])


def rate_noise(step: float) -> float:
    """Standard deviation of a rate of a `moving_cubic` through samples of which the noise is one."""
    from scipy.signal import savgol_coeffs

    return float(np.linalg.norm(savgol_coeffs(samples_of_cubic(step), 3, deriv=1, delta=step)))


@lru_cache(maxsize=2**16)  # minutes cut into thousands of windows begin at each again and again
def at_instant(position: Channel, velocity: Channel | None, time: float) -> Instant:
    """The state at `time` by a polynomial through positions, and measured velocities of the same labels, around it.

    Long windows average noise, short ones follow the motion: of all, in the order of how well they know the speed, the last
    is taken whose estimates lie within two standard errors of those of all before (O. Lepski, Theory Probab. Appl. 35(3),
    1990; A. Goldenshluger and A. Nemirovski, Math. Methods Stat. 6(2), 1997), and then an earlier one, so that noise is more
    than what bends (P. Hall, Ann. Statist. 20(2), 1992). A speed that is not seen to differ from zero is zero.

    Inside a log cubics, which follow a motion further, and parabolas beside them where velocities were measured: two windows
    back, and of more standard errors the noisier a window is, since each may end the search by chance and then costs the more
    (O. Lepski, E. Mammen, V. Spokoiny, Ann. Statist. 25(3), 1997).
    At a log's first or last sample, where nothing from the
    other side averages what bends and motion begins with a kink, and where few samples are near, parabolas: one window back,
    two standard errors. The first window is one position and one velocity, where both were measured.
    """
    return Instant(*np.array([_state(position, velocity, label, time) for label in position.labels]).reshape(-1, 5).T)


def _state(
    position: Channel, velocity: Channel | None, label: str, time: float
) -> tuple[float, float, float, float, float]:
    """Value, speed, their standard deviations, and the acceleration (0 where speeds were measured, or none is seen)."""
    t, rows, seen = _samples(position, label, time, 0)
    if not len(t):
        return np.nan, np.nan, np.nan, np.nan, np.nan
    enough = len(t) > 4  # positions for a cubic that has a degree of freedom left
    level = float(seen[0] / rows[0, 0])
    seen = seen - level * rows[:, 0]
    rates = velocity if velocity is not None and label in velocity.labels else None
    if rates is not None:
        more = _samples(rates, label, time, 1)
        t, rows, seen = (np.concatenate(pair) for pair in zip((t, rows, seen), more, strict=True))
    order = np.argsort(np.abs(t), kind="stable")
    between = enough and bool(np.any(t < 0.0) and np.any(t > 0.0))
    degrees = (2, 3) if between else (2,)
    states, covariances = _windows(rows[order], seen[order], degrees)
    if not len(states):
        return level, 0.0, float(1.0 / rows[0, 0]), np.nan, 0.0
    sd = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    far = STANDARD_ERRORS * sd
    if between:  # the noisier a window, the rarer it must be that noise alone ends the search there
        far *= np.sqrt(1.0 + np.log(np.maximum(sd / sd[-1], 1.0)))
    last = 0
    while last + 1 < len(states) and np.all(np.abs(states[last + 1, :2] - states[: last + 1, :2]) <= far[: last + 1]):
        last += 1
    last = max(0, last - len(degrees))
    (value, speed, acceleration), covariance = states[last], covariances[last]
    if abs(speed) < STANDARD_ERRORS * sd[last, 1]:
        value, speed, acceleration = value - covariance[0, 1] / covariance[1, 1] * speed, 0.0, 0.0
    acceleration = float(acceleration) if rates is None else 0.0
    return float(level + value), float(speed), float(sd[last, 0]), float(sd[last, 1]), acceleration


def _windows(rows: Array, seen: Array, degrees: Sequence[int]) -> tuple[Array, Array]:
    """(w, 3) value, speed and acceleration by the samples (n, 4), (n,) of each window, the nearest first, and (w, 2, 2)
    covariances, in the order of how well they know the speed, the least first: by polynomials of the highest degree,
    and where speeds were measured by those of each.
    """
    normal = np.cumsum(rows[:, :, None] * rows[:, None, :], axis=0)
    slope = np.cumsum(rows * seen[:, None], axis=0)
    places = np.cumsum(rows[:, 0] > 0.0)
    paces = np.arange(1, len(rows) + 1) - places
    both = int(max(np.searchsorted(places, 1), np.searchsorted(paces, 1))) + 1
    # With a degree of freedom left: as many positions as the polynomial has numbers, and one sample more.
    firsts = {degree + 1: int(np.searchsorted(places, degree + 1)) + 2 for degree in degrees}
    found = [_fitted(normal, slope, 2, [both])]
    if both >= min(firsts.values()):  # no speed was measured near
        found, firsts = [], {max(firsts): firsts[max(firsts)]}
    for width, first in firsts.items():
        counts = [first]
        while counts[-1] < len(rows):
            counts.append(min(int(np.ceil(counts[-1] * _GROWTH)), len(rows)))
        found.append(_fitted(normal, slope, width, counts))
    states, covariances = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.argsort(-covariances[:, 1, 1], kind="stable")
    return states[order], covariances[order]


def _fitted(normal: Array, slope: Array, width: int, counts: Sequence[int]) -> tuple[Array, Array]:
    """(w, 3) value, speed and acceleration (0: not asked for) by the first so many of the samples, of which normal equations
    (n, 4, 4), (n, 4) are summed up, by the first `width` numbers; and (w, 2, 2) covariances of the first two.
    """
    counts = [count - 1 for count in counts if count <= len(normal)]
    states, own, right = np.zeros((len(counts), 3)), normal[counts, :width, :width], slope[counts, :width]
    scale = 1.0 / np.sqrt(np.diagonal(own, axis1=1, axis2=2))  # powers of milliseconds are of very different size
    inverse = np.linalg.inv(own * scale[:, :, None] * scale[:, None]) * scale[:, :, None] * scale[:, None]
    states[:, :width] = np.einsum("wij,wj->wi", inverse, right)[:, :3]
    return states, inverse[:, :2, :2]


def _samples(channel: Channel, label: str, time: float, order: int) -> tuple[Array, Array, Array]:
    """(n,) instants of samples near `time`, from there on; (n, 4) what each is of value, speed, acceleration and jerk;
    (n,) the samples; both in units of their noise.
    """
    fewest = 4  # samples of a parabola that has a degree of freedom left
    values, good = channel.column(label), np.arange(*_around(channel.time, time))
    good = good[np.isfinite(values[good])]
    if len(good) < fewest:  # a gap: whatever is nearest to it
        good = np.flatnonzero(np.isfinite(values))
    away = np.abs(channel.time[good] - time)
    near = good[np.argsort(away, kind="stable")[: max(fewest, int((away <= REACH).sum()))]]
    t, one = channel.time[near] - time, np.ones(len(near))
    noise = max(float(np.nan_to_num(_noise(channel)[channel.labels.index(label)])), ROUNDED)
    rows = [one, t, t**2 / 2.0, t**3 / 6.0] if order == 0 else [0.0 * one, one, t, t**2 / 2.0]
    return t, np.stack(rows, axis=1) / noise, values[near] / noise


def _around(times: Array, time: float) -> tuple[int, int]:
    """The first and the last but one of the samples that may count, of instants (T,) in their order."""
    first, stop = np.searchsorted(times, (time - REACH, time + REACH))
    return max(int(first) - 1, 0), min(int(stop) + 1, len(times))


@lru_cache(maxsize=256)
def _noise(channel: Channel) -> Array:
    return estimate_noise(channel.values, channel.time)
