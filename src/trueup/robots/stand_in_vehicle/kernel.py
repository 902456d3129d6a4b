# SPDX-License-Identifier: Apache-2.0
"""The truth compiled: a dynamic bicycle with tyre forces, a slow and slack steering, and what is measured of it."""

from __future__ import annotations

import math

import numpy as np

from trueup.arrays import Array
from trueup.compiled import njit
from trueup.controllers.stanley.kernel import MEMORY, stanley
from trueup.rounding import SAME_INSTANT
from trueup.tracking.channels import READ
from trueup.units import GRAVITY

(
    WHEELBASE, FORWARD, MASS, YAW_INERTIA,
    FRONT_STIFFNESS, REAR_STIFFNESS, FRICTION, MAX_STEERING,
    STEERING_DELAY, STEERING_LAG, STEERING_RATE, STEERING_SLACK,
    STEERING_SCALE, STEERING_OFFSET, SPEED_DELAY, SPEED_LAG,
    ACCELERATION, WHEEL_SCALE, LATENCY, POSITION_NOISE,
    HEADING_NOISE, DRIFT, ASYMMETRY, SLOPE,
    RELAXATION, COMPLIANCE, STEERING_QUANTUM, ORDER_PERIOD,
    POSE_PERIOD, SAG,
) = range(30)  # fmt: skip
"""Columns of the truth, in the order of `VehicleTruth`."""

(
    X, Y, HEADING, SPEED, TURNING, SIDEWAYS, LAGGED, SLACK, WHEEL, WANTED, FRONT_SLIP, REAR_SLIP, PUSH, TIME,
    STATE,
) = range(15)  # fmt: skip
"""Where the numbers of a state stand, and how many they are: pose of the rear axle; wheel speed; yaw rate; lateral speed of
the centre of mass; steering after lag, slack, rate limit; speed wanted; slip of both axles as the tyres have taken it up;
side force in front; time."""
_SLOW = 0.15  # m/s: below, slip angles are taken at this speed, and steering counts less


@njit(cache=True, nogil=True, error_model="numpy")
def advance(p: Array, s: Array, speed: float, steering: float, h: float) -> None:
    """One step h of the truth p (`VehicleTruth.row`) under the orders that have arrived (m/s, rad)."""
    s[WANTED] += (speed - s[WANTED]) * (1.0 - math.exp(-h / p[SPEED_LAG]))
    s[SPEED] += min(max(s[WANTED] - s[SPEED], -p[ACCELERATION] * h), p[ACCELERATION] * h)
    s[LAGGED] += (min(max(steering, -p[MAX_STEERING]), p[MAX_STEERING]) - s[LAGGED]) * (
        1.0 - math.exp(-h / p[STEERING_LAG])
    )
    s[SLACK] = min(max(s[SLACK], s[LAGGED] - 0.5 * p[STEERING_SLACK]), s[LAGGED] + 0.5 * p[STEERING_SLACK])
    s[WHEEL] += min(max(s[SLACK] - s[WHEEL], -p[STEERING_RATE] * h), p[STEERING_RATE] * h)
    delta = p[STEERING_SCALE] * s[WHEEL] * (1.0 - p[ASYMMETRY] if s[WHEEL] < 0.0 else 1.0) + p[STEERING_OFFSET]
    delta -= p[COMPLIANCE] * s[PUSH]
    u = p[WHEEL_SCALE] * (1.0 - p[SAG] * s[TIME] / 100.0) * s[SPEED]
    s[TIME] += h
    ahead, behind = p[WHEELBASE] - p[FORWARD], p[FORWARD]
    floor = max(u, _SLOW)
    slip_front = delta * min(u / _SLOW, 1.0) - math.atan((s[SIDEWAYS] + ahead * s[TURNING]) / floor)
    slip_rear = -math.atan((s[SIDEWAYS] - behind * s[TURNING]) / floor)
    if p[RELAXATION] > 0.0:
        taken = 1.0 - math.exp(-h * floor / p[RELAXATION])
        s[FRONT_SLIP] += taken * (slip_front - s[FRONT_SLIP])
        s[REAR_SLIP] += taken * (slip_rear - s[REAR_SLIP])
        slip_front, slip_rear = s[FRONT_SLIP], s[REAR_SLIP]
    hold_front, hold_rear = (
        p[FRICTION] * p[MASS] * GRAVITY * behind / p[WHEELBASE],
        p[FRICTION] * p[MASS] * GRAVITY * ahead / p[WHEELBASE],
    )
    front = hold_front * math.tanh(p[FRONT_STIFFNESS] * slip_front / hold_front) * math.cos(delta)
    rear = hold_rear * math.tanh(p[REAR_STIFFNESS] * slip_rear / hold_rear)
    s[PUSH] = front
    s[SIDEWAYS] += h * ((front + rear) / p[MASS] - u * s[TURNING] - p[SLOPE] * math.cos(s[HEADING]))
    s[TURNING] += h * (ahead * front - behind * rear) / p[YAW_INERTIA]
    sideways = s[SIDEWAYS] - behind * s[TURNING]
    s[X] += h * (u * math.cos(s[HEADING]) - sideways * math.sin(s[HEADING]))
    s[Y] += h * (u * math.sin(s[HEADING]) + sideways * math.cos(s[HEADING]))
    s[HEADING] += h * s[TURNING]


@njit(cache=True, nogil=True, error_model="numpy")
def in_force(orders: Array, column: int, last: int, tick: float, every: int) -> float:
    """The order that has arrived: held since the tick at which it was given (or `every` so many), zero before the first."""
    n = min(math.floor(tick + SAME_INSTANT), last)
    return orders[n - n % every, column] if n >= 0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def measure(p: Array, truth: Array, n: int, period: float, noise: Array, out: Array) -> None:
    """What is known at tick n: a late, noisy, drifting pose; wheel speed and turn rate with little noise (ticks, 7)."""
    fixed = n - n % max(1, round(p[POSE_PERIOD] / period))
    back = max(fixed - p[LATENCY] / period, 0.0)
    i = min(int(back), max(n - 1, 0))
    part = back - i
    for c in range(3):
        out[c] = truth[i, c] + part * (truth[min(i + 1, n), c] - truth[i, c])
    out[0] += p[POSITION_NOISE] * noise[fixed, 0] + p[DRIFT] * noise[fixed, 5]
    out[1] += p[POSITION_NOISE] * noise[fixed, 1] + p[DRIFT] * noise[fixed, 6]
    out[2] += p[HEADING_NOISE] * noise[fixed, 2]
    out[3] = truth[n, 3] + 0.004 * noise[n, 3]
    out[4] = truth[n, 4] + 0.01 * noise[n, 4]


@njit(cache=True, nogil=True, error_model="numpy")
def between(p: Array, s: Array, orders: Array, n: int, period: float, h: float) -> None:
    """From tick n to the next one, under the orders (ticks, 2) given so far."""
    count, every = round(period / h), max(1, round(p[ORDER_PERIOD] / period))
    for j in range(count):
        now = n + j / count
        speed = in_force(orders, 0, n, now - p[SPEED_DELAY] / period, every)
        steering = in_force(orders, 1, n, now - p[STEERING_DELAY] / period, every)
        if p[STEERING_QUANTUM] > 0.0:
            steering = p[STEERING_QUANTUM] * round(steering / p[STEERING_QUANTUM])
        advance(p, s, speed, steering, h)


@njit(cache=True, nogil=True, error_model="numpy")
def follow(
    p: Array, start: Array, gains: Array, settings: Array, path: Array, period: float, h: float, noise: Array,
    truth: Array, seen: Array, orders: Array,
) -> None:  # fmt: skip
    """Closed loop with the Stanley law, b rows: gains (b, 7), noise (b, ticks, 7); truth, seen (b, ticks, READ)."""
    s, memory = np.empty(STATE), np.empty(MEMORY)
    for i in range(gains.shape[0]):
        s[:] = 0.0
        s[:3] = start
        memory[:] = 0.0
        for n in range(truth.shape[1]):
            truth[i, n] = s[:READ]
            measure(p, truth[i], n, period, noise[i], seen[i, n])
            o = seen[i, n]
            speed, steering = stanley(gains[i], settings, path, memory, o[0], o[1], o[2], o[3], o[4])
            orders[i, n, 0], orders[i, n, 1] = speed, steering
            between(p, s, orders[i], n, period, h)


@njit(cache=True, nogil=True, error_model="numpy")
def play(
    p: Array, start: Array, period: float, h: float, noise: Array, orders: Array, truth: Array, seen: Array
) -> None:
    """Open loop under orders (ticks, 2); truth, seen (ticks, READ)."""
    s = np.zeros(STATE)
    s[:3] = start
    for n in range(truth.shape[0]):
        truth[n] = s[:READ]
        measure(p, truth, n, period, noise, seen[n])
        between(p, s, orders, n, period, h)
