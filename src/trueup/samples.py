# SPDX-License-Identifier: Apache-2.0
"""Samples of a signal: their size, what is in force where some are missing, values in between, angles without jumps."""

from __future__ import annotations

import math

import numpy as np

from trueup.arrays import Array, Integers, Mask

COUNTS = tuple(2.0**bits for bits in (15, 16, 24, 31, 32))
"""What counters count until they begin anew: words of 16 and 32 bits, with a sign or without, the realtime tick of
Dynamixel servos (15 bits), the SysTick of ARM's cores (24)."""
MOST = 0.5
"""Of a whole: what is so for more of it is the rule, and what is left the exception."""
MOSTLY = 0.9
"""Of a whole: what is so for as much of it counts as so for all. The tenth that is left are rows that a log has lost, samples
with errors of a bus, moments in which a robot turns round."""
SLIGHT = 0.02
"""Of a whole: what is less of it is as good as none, and what differs by less is as good as the same."""
NEIGHBOURS = 3
"""Samples on either side, by whose median one is judged: faults of up to three samples stand out of it, and a step, which has
its like on one side, does not."""
_UNIT_NORM = 0.1
"""How far the length of a quaternion may be from 1, in the median: logs are rounded, other four numbers are further off."""


def rms(values: Array, axis: int | tuple[int, ...] | None = 0) -> Array:
    """Root mean square of values (T, ...) along their first axis, or others; of all of them where it is None."""
    return np.sqrt(np.mean(values**2, axis=axis))


def correlation(one: Array, other: Array) -> float:
    """Of two series (T,), over the samples that both have; 0 where one of them does not change."""
    good = np.isfinite(one) & np.isfinite(other)
    one, other = one[good], other[good]
    changes = good.any() and min(np.ptp(one), np.ptp(other)) > 0.0
    return float(np.corrcoef(one, other)[0, 1]) if changes else 0.0


def in_force(values: Array) -> Array:
    """(T, k) a command's values, each that is missing as the last one sent before it, at the beginning as the first one.

    A controller holds what it was told (zero-order hold). A column without any value stays NaN.
    """
    known = np.isfinite(values)
    if known.all():
        return values
    first = np.argmax(known, axis=0)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values))[:, None], first), axis=0)
    return np.take_along_axis(values, last, axis=0)


def held_integral(times: Array, values: Array) -> Array:
    """(n, k) integral of a held signal (n, k) up to each of its instants."""
    steps = np.diff(times)[:, None] * values[:-1]
    return np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(steps, axis=0)])


def in_force_over(time: Array, values: Array, begin: Array, step: float) -> Array:
    """(n, k) the mean, over `step` s from each instant of `begin` (n,) on, of commands (T, k) that are held from one to the
    next; the first one before that, too.
    """
    held = in_force(values)
    edges = np.concatenate([[min(time[0], begin[0])], time, [max(time[-1], begin[-1]) + step]])
    total = held_integral(edges, np.concatenate([held[:1], held, held[-1:]]))
    return (between(begin + step, edges, total) - between(begin, edges, total)) / step


def between(at: Array, time: Array, values: Array) -> Array:
    """(n, k) the values (T, k) at instants (n,), or at whatever else `time` (T,) counts: linear, beyond the ends as there."""
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)


def way_along(points: Array) -> Array:
    """(N,) m from the first of (N, 2) points to each, along straight lines."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def thinned(points: Array, most: int) -> Array:
    """Every so many of points (N, ...), about `most` of them."""
    return points[:: max(1, len(points) // most)]


def stretches_of(there: Mask) -> Integers:
    """(n, 2) the first of the samples (T,) of each stretch in which something is so, and the first one behind it."""
    return np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(int))).reshape(-1, 2)


def wrapped(angles: Array) -> Array:
    """Angles in rad, each in the turn from -pi to pi."""
    return (angles + np.pi) % math.tau - np.pi


def unwound(angles: Array, turn: float = math.tau) -> Array:
    """(T,) or (T, k) angles without jumps of a turn, missing samples aside: half way from pi to -pi no heading is zero."""
    values = angles.copy()
    for column in np.atleast_2d(values.T):
        known = np.isfinite(column)
        column[known] = np.unwrap(column[known], period=turn)
    return angles if np.array_equal(values, angles, equal_nan=True) else values


def is_unit(values: Array) -> bool:
    """Whether rows (T, 4) are quaternions: their length is 1."""
    return bool(len(values)) and abs(float(np.median(np.linalg.norm(values, axis=1))) - 1.0) < _UNIT_NORM
