# SPDX-License-Identifier: Apache-2.0
"""Where steering and motor are along a drive: run under all of its commands, and until these tell the wheel, as it turns."""

from __future__ import annotations

import math

import numpy as np

from trueup.arrays import Array
from trueup.compiled import njit
from trueup.engines.vehicle.kernels import (
    ANGLE,
    DRIVE_DELAY,
    LAGGED,
    MAX_STEERING,
    MOTOR,
    RELAXATION,
    SLACK,
    SLOW,
    STATE,
    STEERING_DELAY,
    WHEEL,
    moves_wheels,
    share_of,
    steady_turn,
    steered,
    step_actuators,
    step_steering,
)
from trueup.rounding import ROUNDED, TINY

ACTUATORS = (LAGGED, SLACK, WHEEL, MOTOR)
"""Columns of a way (G, 4): what of the state actuators are, at each instant of a grid; the steering in the first three."""
STEERING = 3


@njit(cache=True, nogil=True, error_model="numpy")
def delayed(values: Array, column: int, last: int, at: float, before: float) -> float:
    """A signal given at each instant of a grid up to `last`, at a fraction of an instant; `before` until the first."""
    if at >= last:
        return values[last, column]
    if at < 0.0:
        return values[0, column] + min(-at, 1.0) * (before - values[0, column])
    i = int(at)
    return values[i, column] + (at - i) * (values[i + 1, column] - values[i, column])


@njit(cache=True, nogil=True, error_model="numpy")
def orders(p: Array, dt: float, commands: Array, k: int) -> tuple[float, float]:
    """What drives and what steers at grid instant k, of commands (G, 2): throttle or speed, and steering."""
    last = len(commands) - 1
    drive = delayed(commands, 0, last, k - p[DRIVE_DELAY] / dt, commands[0, 0])
    return drive, delayed(commands, 1, last, k - p[STEERING_DELAY] / dt, commands[0, 1])


@njit(cache=True, nogil=True, error_model="numpy")
def advance(p: Array, dt: float, commands: Array, k: int, shares: Array, s: Array) -> None:
    """The actuators one step on from grid instant k, under commands (G, 2)."""
    drive, steering = orders(p, dt, commands, k)
    step_actuators(p, dt, drive, steering, shares, s)


@njit(cache=True, nogil=True, error_model="numpy")
def take(way: Array, k: int, s: Array) -> None:
    """The actuators where a way (G, 4) has them at grid instant k."""
    for c in range(len(ACTUATORS)):
        s[ACTUATORS[c]] = way[k, c]


@njit(cache=True, nogil=True, error_model="numpy")
def wheels_told(p: Array, dt: float, commands: Array, k: int) -> tuple[float, float]:
    """Where motor and steering were in the end if the commands in force at grid instant k lasted."""
    drive, steering = orders(p, dt, commands, k)
    drive, steering = moves_wheels(p, drive, steering)
    return drive, min(max(steering, -p[MAX_STEERING]), p[MAX_STEERING])


@njit(cache=True, nogil=True, error_model="numpy")
def run_actuators(p: Array, dt: float, commands: Array, told: int, end: int, shares: Array, way: Array) -> float:
    """Writes way (n, 4) under all commands since grid instant `told`, the first that is known.

    Until then everything stands where that command has it. Returns how far the wheel is from where it is told to be, as a
    root mean square until instant `end`, in units of the command.
    """
    s, behind = np.zeros(STATE), 0.0
    s[MOTOR], s[WHEEL] = wheels_told(p, dt, commands, told)
    s[LAGGED] = s[SLACK] = s[WHEEL]
    for k in range(max(end, len(way))):
        if k < len(way):
            for c in range(len(ACTUATORS)):
                way[k, c] = s[ACTUATORS[c]]
        if k >= told:
            drive, steering = wheels_told(p, dt, commands, k)
            behind += (s[WHEEL] - steering) ** 2
            s[MOTOR] += shares[0] * (drive - s[MOTOR])
            step_steering(p, dt, steering, shares[1], s)
    return math.sqrt(behind / max(end - told, 1))


@njit(cache=True, nogil=True, error_model="numpy")
def tell_wheel(
    p: Array, dt: float, commands: Array, seen: Array, noise: Array, spread: float, told: int, share: float, way: Array
) -> None:  # fmt: skip
    """Steering of a way (n, 4) while it has not forgotten what came before the commands: a slow wheel may be anywhere.

    Two states a standard deviation to either side of the wheel, `spread` (units of the command) when the commands begin, run
    under these (sigma points: S. J. Julier, J. K. Uhlmann, Unscented filtering and nonlinear estimation, Proc. IEEE 92(3),
    2004) and draw near. Until they meet, turn rates that are seen, of variances `noise` (G,), move them by what these tell.
    """
    first = told + math.ceil(max(p[STEERING_DELAY], 0.0) / dt)
    low, high, reach = np.zeros(STATE), np.zeros(STATE), np.abs(commands[:, 1]).max()
    middle = wheels_told(p, dt, commands, first)[1]
    low[LAGGED] = low[SLACK] = low[WHEEL] = middle - spread
    high[LAGGED] = high[SLACK] = high[WHEEL] = middle + spread
    low[ANGLE], high[ANGLE] = steered(p, low[WHEEL]), steered(p, high[WHEEL])
    for k in range(first, len(way)):
        if noise[k] < np.inf:
            weigh(p, seen[k, 3], seen[k, 4], noise[k], reach, low, high)
        apart = 0.0
        for c in range(STEERING):
            n = ACTUATORS[c]
            apart += high[n] - low[n] + abs(0.5 * (low[n] + high[n]) - way[k, c])
            way[k, c] = 0.5 * (low[n] + high[n])
        if apart < ROUNDED:
            return
        steering, rolled = wheels_told(p, dt, commands, k)[1], share_of(p[RELAXATION], dt * max(abs(seen[k, 3]), SLOW))
        for s in (low, high):
            step_steering(p, dt, steering, share, s)
            s[ANGLE] += rolled * (steered(p, s[WHEEL]) - s[ANGLE])


@njit(cache=True, nogil=True, error_model="numpy")
def weigh(p: Array, speed: float, turn: float, noise: float, reach: float, low: Array, high: Array) -> None:
    """A turn rate that is seen at a speed, of variance `noise`, moves two states a standard deviation from their mean."""
    below, above = steady_turn(p, speed, low[ANGLE]), steady_turn(p, speed, high[ANGLE])
    half = 0.5 * (above - below)
    doubt = half * half + max(noise, TINY)
    shift, left = half * (turn - 0.5 * (below + above)) / doubt, math.sqrt(noise / doubt)
    for c in (LAGGED, SLACK, WHEEL, ANGLE):
        middle, apart = 0.5 * (low[c] + high[c]), 0.5 * (high[c] - low[c])
        middle += shift * apart
        if c != ANGLE:
            middle = min(max(middle, -reach), reach)
        low[c], high[c] = middle - left * apart, middle + left * apart
