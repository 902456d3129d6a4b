# SPDX-License-Identifier: Apache-2.0
"""Where steering and motor are along a drive: run under all of its commands."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.compiled import njit
from trueup.engines.vehicle.kernels import (
    DRIVE_DELAY,
    LAGGED,
    MAX_STEERING,
    MOTOR,
    SLACK,
    STATE,
    STEERING_DELAY,
    WHEEL,
    moves_wheels,
    step_actuators,
    step_steering,
)

ACTUATORS = (LAGGED, SLACK, WHEEL, MOTOR)
"""Columns of a way (G, 4): what of the state actuators are, at each instant of a grid."""


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
def run_actuators(p: Array, dt: float, commands: Array, told: int, shares: Array, way: Array) -> None:
    """Writes way (n, 4) under all commands (G, 2) since grid instant `told`, the first that is known.

    Until then everything stands where that command has it.
    """
    s = np.zeros(STATE)
    s[MOTOR], s[WHEEL] = wheels_told(p, dt, commands, told)
    s[LAGGED] = s[SLACK] = s[WHEEL]
    for k in range(len(way)):
        for c in range(len(ACTUATORS)):
            way[k, c] = s[ACTUATORS[c]]
        if k >= told:
            drive, steering = wheels_told(p, dt, commands, k)
            s[MOTOR] += shares[0] * (drive - s[MOTOR])
            step_steering(p, dt, steering, shares[1], s)
