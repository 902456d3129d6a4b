# SPDX-License-Identifier: Apache-2.0
"""Compiled loops of the bicycle: one step, delayed commands, whole runs with recorded commands or the Stanley law."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueup.controllers.stanley.kernel import MEMORY, stanley

Array = NDArray[np.float64]

(
    WHEELBASE, MAX_STEERING, SPEED_DELAY, STEERING_DELAY,
    ACCELERATION_LIMIT, YAW_RATE_LIMIT, YAW_ACCELERATION_LIMIT, SPEED_LAG,
    STEERING_LAG, STEERING_RATE_LIMIT, WHEEL_SCALE, STEERING_SCALE,
    STEERING_OFFSET, STEERING_SLACK, UNDERSTEER, POSITION_NOISE,
    HEADING_NOISE, LOCALISATION_LATENCY,
) = range(18)  # fmt: skip
"""Columns of a row of the model: the vehicle, then QUANTITIES in their order."""

STATE = 8
"""x, y (m), heading (rad) of the rear axle; wheel speed (m/s); yaw rate (rad/s); steering (rad) after lag, slack, rate."""
POSE = 5
"""What is kept of each step: x, y, heading, wheel speed, yaw rate."""


@njit(cache=True, nogil=True, error_model="numpy")
def at_times(times: Array, values: Array, column: int, t: float, before: float, hint: int) -> tuple[float, int]:
    """A sampled signal at time t by linear interpolation, held after its end; `hint` is where the last look-up ended.

    One sample earlier than the first it is `before`: what was in force until then.
    """
    n = len(times)
    if t < times[0]:
        gap = times[1] - times[0] if n > 1 else 1e-3
        return values[0, column] + min((times[0] - t) / gap, 1.0) * (before - values[0, column]), 0
    i = hint
    while i + 1 < n and times[i + 1] <= t:
        i += 1
    while i > 0 and times[i] > t:
        i -= 1
    if i + 1 >= n:
        return values[i, column], i
    part = (t - times[i]) / (times[i + 1] - times[i])
    return values[i, column] + part * (values[i + 1, column] - values[i, column]), i


@njit(cache=True, nogil=True, error_model="numpy")
def at_ticks(values: Array, column: int, last: int, tick: float, before: float) -> float:
    """As `at_times` for a signal given at each control tick up to `last`, at a fraction of a tick."""
    if tick >= last:
        return values[last, column]
    if tick < 0.0:
        return values[0, column] + min(-tick, 1.0) * (before - values[0, column])
    i = int(tick)
    return values[i, column] + (tick - i) * (values[i + 1, column] - values[i, column])


@njit(cache=True, nogil=True, error_model="numpy")
def toward(value: float, wanted: float, most: float) -> float:
    """`wanted`, or as far toward it as `most` allows."""
    return value + min(max(wanted - value, -most), most)


@njit(cache=True, nogil=True, error_model="numpy")
def step_vehicle(
    p: Array, speed_share: float, steering_share: float, dt: float, speed: float, steering: float, s: Array
) -> None:
    """One step of s (STATE,) under delayed commands. p as `Vehicle.row`; shares are 1 - exp(-dt / lag) of the two lags.

    Steering clip, then omega* = v tan(delta) / (L (1 + K v^2)), its clamp (beta_4), its rate limit (beta_5), pose; the
    speed beside it under beta_3. The pose moves on a circle, exactly, while speed and yaw rate last a step.
    """
    s[3] = toward(s[3], s[3] + speed_share * (speed - s[3]), p[ACCELERATION_LIMIT] * dt)
    s[5] += steering_share * (min(max(steering, -p[MAX_STEERING]), p[MAX_STEERING]) - s[5])
    gap = 0.5 * p[STEERING_SLACK]
    s[6] = min(max(s[6], s[5] - gap), s[5] + gap)
    s[7] = toward(s[7], s[6], p[STEERING_RATE_LIMIT] * dt)
    v = p[WHEEL_SCALE] * s[3]
    turn = v * math.tan(p[STEERING_SCALE] * s[7] + p[STEERING_OFFSET]) / (p[WHEELBASE] * (1.0 + p[UNDERSTEER] * v * v))
    s[4] = toward(s[4], min(max(turn, -p[YAW_RATE_LIMIT]), p[YAW_RATE_LIMIT]), p[YAW_ACCELERATION_LIMIT] * dt)
    half = 0.5 * s[4] * dt
    chord = v * dt * (1.0 - half * half / 6.0 if abs(half) < 1e-4 else math.sin(half) / half)
    s[0] += chord * math.cos(s[2] + half)
    s[1] += chord * math.sin(s[2] + half)
    s[2] += s[4] * dt


@njit(cache=True, nogil=True, error_model="numpy")
def share_of(lag: float, dt: float) -> float:
    """How much of a step toward its goal a first-order lag makes in dt."""
    return 1.0 - math.exp(-dt / lag) if lag > 1e-9 else 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def keep(s: Array, out: Array) -> None:
    """Copies what is kept of a state."""
    for c in range(POSE):
        out[c] = s[c]


@njit(cache=True, nogil=True, error_model="numpy")
def seen_pose(history: Array, at: float, last: int, column: int) -> float:
    """A column of the history at a fraction of a step; before the start as in its first step, back in time."""
    if at <= 0.0:
        return history[0, column] + at * (history[1, column] - history[0, column] if last > 0 else 0.0)
    if at >= last:
        return history[last, column]
    i = int(at)
    return history[i, column] + (at - i) * (history[i + 1, column] - history[i, column])


@njit(cache=True, nogil=True, error_model="numpy")
def read_off(
    p: Array, history: Array, last: int, dt: float, times: Array, noise: Array, period: float, out: Array
) -> None:
    """What is measured at `times` (T,) since the start: out (T, POSE). Poses come late and noisy.

    `noise` (ticks, 3) standard normal numbers, one row for each measurement of the pose, every `period` s; or none.
    """
    for k in range(len(times)):
        at, late = times[k] / dt, (times[k] - p[LOCALISATION_LATENCY]) / dt
        for c in range(3):
            out[k, c] = seen_pose(history, late, last, c)
        for c in range(3, POSE):
            out[k, c] = seen_pose(history, at, last, c)
        if len(noise):
            n = min(int(times[k] / period + 1e-6), len(noise) - 1)
            out[k, 0] += p[POSITION_NOISE] * noise[n, 0]
            out[k, 1] += p[POSITION_NOISE] * noise[n, 1]
            out[k, 2] += p[HEADING_NOISE] * noise[n, 2]


@njit(cache=True, nogil=True, error_model="numpy")
def replay_rows(
    rows: Array, start: Array, times: Array, commands: Array, steps: int, dt: float, read: Array, out: Array
) -> None:
    """Open loop: every row (b, n) under the same recorded commands (times (n,) since the start, commands (n, 2)).

    start (STATE,); read (T,) instants; out (b, T, POSE).
    """
    history = np.empty((steps + 1, POSE))
    none = np.empty((0, 3))
    s = np.empty(STATE)
    for i in range(rows.shape[0]):
        p = rows[i]
        s[:] = start
        speed_share, steering_share = share_of(p[SPEED_LAG], dt), share_of(p[STEERING_LAG], dt)
        before, b = at_times(times, commands, 1, -p[STEERING_DELAY], commands[0, 1], 0)
        s[5] = s[6] = s[7] = min(max(before, -p[MAX_STEERING]), p[MAX_STEERING])
        keep(s, history[0])
        a = 0
        for k in range(steps):
            speed, a = at_times(times, commands, 0, k * dt - p[SPEED_DELAY], start[3], a)
            steering, b = at_times(times, commands, 1, k * dt - p[STEERING_DELAY], commands[0, 1], b)
            step_vehicle(p, speed_share, steering_share, dt, speed, steering, s)
            keep(s, history[k + 1])
        read_off(p, history, steps, dt, read, none, 1.0, out[i])


@njit(cache=True, nogil=True, error_model="numpy")
def observe(p: Array, history: Array, k: int, dt: float, noise: Array, out: Array) -> None:
    """What the controller sees after k steps: out (POSE,); `noise` (3,) standard normal numbers of this measurement."""
    late = k - p[LOCALISATION_LATENCY] / dt
    for c in range(3):
        out[c] = seen_pose(history, late, k, c)
    out[0] += p[POSITION_NOISE] * noise[0]
    out[1] += p[POSITION_NOISE] * noise[1]
    out[2] += p[HEADING_NOISE] * noise[2]
    out[3] = history[k, 3]
    out[4] = history[k, 4]


@njit(cache=True, nogil=True, error_model="numpy")
def drive(
    p: Array, before: Array, orders: Array, tick: int, substeps: int, dt: float, shares: Array, s: Array, history: Array
) -> None:  # fmt: skip
    """From control tick `tick` to the next one: `substeps` steps under the delayed orders (ticks, 2) so far.

    before (STATE,) is the start: its speed and steering are in force until the first order arrives.
    """
    period = substeps * dt
    for j in range(substeps):
        now = tick + j / substeps
        speed = at_ticks(orders, 0, tick, now - p[SPEED_DELAY] / period, before[3])
        steering = at_ticks(orders, 1, tick, now - p[STEERING_DELAY] / period, before[5])
        step_vehicle(p, shares[0], shares[1], dt, speed, steering, s)
        keep(s, history[tick * substeps + j + 1])


@njit(cache=True, nogil=True, error_model="numpy")
def follow_rows(
    rows: Array, start: Array, gains: Array, settings: Array, path: Array, ticks: int, substeps: int, dt: float,
    noise: Array, read: Array, out: Array, orders: Array,
) -> None:  # fmt: skip
    """Closed loop with the Stanley law: rows (b, n) with gains (b, 7) on one path; out (b, T, POSE), orders (b, ticks, 2)."""
    history = np.empty((ticks * substeps + 1, POSE))
    s, seen, shares = np.empty(STATE), np.empty(POSE), np.empty(2)
    memory = np.empty(MEMORY)
    for i in range(rows.shape[0]):
        p = rows[i]
        s[:] = start
        memory[:] = 0.0
        shares[0], shares[1] = share_of(p[SPEED_LAG], dt), share_of(p[STEERING_LAG], dt)
        keep(s, history[0])
        for n in range(ticks):
            observe(p, history, n * substeps, dt, noise[n], seen)
            speed, steering = stanley(gains[i], settings, path, memory, seen[0], seen[1], seen[2], seen[3], seen[4])
            orders[i, n, 0], orders[i, n, 1] = speed, steering
            drive(p, start, orders[i], n, substeps, dt, shares, s, history)
        read_off(p, history, ticks * substeps, dt, read, noise, substeps * dt, out[i])


@njit(cache=True, nogil=True, error_model="numpy")
def observe_all(rows: Array, history: Array, k: int, dt: float, noise: Array, out: Array) -> None:
    """`observe` for all rows: history (b, steps + 1, POSE), out (b, POSE)."""
    for i in range(rows.shape[0]):
        observe(rows[i], history[i], k, dt, noise, out[i])


@njit(cache=True, nogil=True, error_model="numpy")
def drive_all(
    rows: Array, start: Array, orders: Array, tick: int, substeps: int, dt: float, state: Array, history: Array
) -> None:  # fmt: skip
    """`drive` for all rows: orders (b, ticks, 2), state (b, STATE), history (b, steps + 1, POSE)."""
    shares = np.empty(2)
    for i in range(rows.shape[0]):
        shares[0], shares[1] = share_of(rows[i, SPEED_LAG], dt), share_of(rows[i, STEERING_LAG], dt)
        drive(rows[i], start, orders[i], tick, substeps, dt, shares, state[i], history[i])


@njit(cache=True, nogil=True, error_model="numpy")
def read_all(
    rows: Array, history: Array, last: int, dt: float, times: Array, noise: Array, period: float, out: Array
) -> None:
    """`read_off` for all rows: out (b, T, POSE)."""
    for i in range(rows.shape[0]):
        read_off(rows[i], history[i], last, dt, times, noise, period, out[i])
