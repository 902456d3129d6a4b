# SPDX-License-Identifier: Apache-2.0
"""Time laws of one move: from rest to rest under limits of speed, acceleration and jerk, in the least time.

A law is the running integral of three rectangles folded into each other, of lengths T1 >= T2 + T3, T2 >= T3:
cruise, ramp and rounding. T3 = 0 gives the trapezoidal profile, T3 > 0 the one of limited jerk.
"""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.compiled import njit


@njit(cache=True, nogil=True)
def ramps(distance: float, speed: float, acceleration: float, jerk: float) -> tuple[float, float, float]:
    """(T1, T2, T3) in s of the fastest law over `distance` >= 0; `jerk` may be infinite (trapezoidal profile).

    The law takes T1 + T2 + T3, its top speed is distance / T1, its top acceleration distance / (T1 T2), its jerk
    distance / (T1 T2 T3). Short moves never reach `speed`, shorter ones not `acceleration` either.
    """
    if distance <= 0.0:
        return 0.0, 0.0, 0.0
    third = acceleration / jerk
    second = speed / acceleration
    if second < third:
        second = third = np.sqrt(speed / jerk)
    first = distance / speed
    if first >= second + third:  # else the end of speeding up would meet the beginning of slowing down
        return first, second, third
    third = acceleration / jerk
    second = 0.5 * (np.sqrt(third * third + 4 * distance / acceleration) - third)
    if second < third:
        second = third = np.cbrt(0.5 * distance / jerk)
    return second + third, second, third


@njit(cache=True, nogil=True)
def law(t: float, first: float, second: float, third: float) -> tuple[float, float, float]:
    """(s, ds/dt, d2s/dt2) at `t` s of the law from 0 to 1 with these rectangles; before it 0, after it 1, at rest."""
    total = first + second + third
    if t <= 0.0:
        return 0.0, 0.0, 0.0
    if t >= total:
        return 1.0, 0.0, 0.0
    if t > 0.5 * total:  # laws are symmetric; seen from the nearer end the powers below do not cancel
        s, rate, bend = _rising(total - t, first, second, third)
        return 1.0 - s, rate, -bend
    return _rising(t, first, second, third)


@njit(cache=True, nogil=True)
def advance(start: Array, end: Array, s: float, rate: float, bend: float, q: Array, qd: Array, qdd: Array) -> None:
    """Adds the way from `start` (n,) to `end`, of which the share s is behind, ds/dt and d2s/dt2, to q, qd, qdd (n,)."""
    for i in range(len(start)):
        step = end[i] - start[i]
        q[i] += step * s
        qd[i] += step * rate
        qdd[i] += step * bend


@njit(cache=True, nogil=True)
def _rising(t: float, first: float, second: float, third: float) -> tuple[float, float, float]:
    s, rate, bend = 0.0, 0.0, 0.0
    if third > 0.0:
        for i in range(8):  # folded rectangles: one truncated cubic for each subset of the three
            left = t - (i & 1) * first - (i >> 1 & 1) * second - (i >> 2) * third
            if left > 0.0:
                sign = 1.0 - 2.0 * ((i & 1) ^ (i >> 1 & 1) ^ (i >> 2))
                s += sign * left * left * left / 6
                rate += sign * left * left / 2.0
                bend += sign * left
        scale = 1.0 / (first * second * third)
    else:
        for i in range(4):
            left = t - (i & 1) * first - (i >> 1) * second
            if left > 0.0:
                sign = 1.0 - 2.0 * ((i & 1) ^ (i >> 1))
                s += sign * left * left / 2.0
                rate += sign * left
                bend += sign
        scale = 1.0 / (first * second)
    return s * scale, rate * scale, bend * scale


@njit(cache=True, nogil=True)
def time_of_share(share: float, first: float, second: float, third: float) -> float:
    """The instant [s] at which a law has covered `share` of its way."""
    low, high = 0.0, first + second + third
    for _ in range(40):
        middle = 0.5 * (low + high)
        if law(middle, first, second, third)[0] < share:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
