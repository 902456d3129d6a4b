# SPDX-License-Identifier: Apache-2.0
"""Whole runs of a vehicle, compiled: under recorded commands from what was seen until then, or with the Stanley law."""

from __future__ import annotations

import math

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.compiled import njit
from trueup.controllers.stanley.kernel import MEMORY, stanley
from trueup.engines.vehicle.beginning import advance, begin, delayed, forward_speed, place
from trueup.engines.vehicle.kernels import (
    DRIVE,
    DRIVE_DELAY,
    DRIVE_LAG,
    HEADING,
    HEADING_NOISE,
    LAGGED,
    LATENCY,
    MOTOR,
    POSE_LEFT,
    POSE_TURN,
    POSITION_NOISE,
    SPEED,
    SPEED_GAIN,
    STATE,
    STEERING_DELAY,
    STEERING_LAG,
    TURNING,
    X,
    Y,
    share_of,
    step_actuators,
    step_chassis,
    tracked_ahead,
)  # fmt: skip
from trueup.rounding import PRINTED, SAME_INSTANT
from trueup.tracking.channels import READ


@njit(cache=True, nogil=True, error_model="numpy")
def keep(p: Array, s: Array, out: Array) -> None:
    """What would be measured in a state: out (READ,), see `tracking.channels`."""
    ahead, aside, c, d = tracked_ahead(p), p[POSE_LEFT], math.cos(s[HEADING]), math.sin(s[HEADING])
    out[0] = s[X] + ahead * c - aside * d
    out[1] = s[Y] + ahead * d + aside * c
    out[2] = s[HEADING] - p[POSE_TURN]
    out[3], out[4] = s[SPEED], s[TURNING]


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
def measure(p: Array, history: Array, last: int, at: float, dt: float, noise: Array, out: Array) -> None:
    """What is measured `at` a fraction of a step: out (READ,); the pose late and with noise (3,), standard normal."""
    late = at - p[LATENCY] / dt
    for c in range(3):
        out[c] = seen_pose(history, late, last, c)
    for c in range(3, READ):
        out[c] = seen_pose(history, at, last, c)
    out[0] += p[POSITION_NOISE] * noise[0]
    out[1] += p[POSITION_NOISE] * noise[1]
    out[2] += p[HEADING_NOISE] * noise[2]


@njit(cache=True, nogil=True, error_model="numpy")
def read_off(
    p: Array, history: Array, last: int, dt: float, times: Array, noise: Array, period: float, out: Array
) -> None:
    """What is measured at `times` (T,) since the start: out (T, READ); `noise` (ticks, 3), one row every `period` s."""
    for k in range(len(times)):
        n = min(int(times[k] / period + PRINTED), len(noise) - 1)
        measure(p, history, last, times[k] / dt, dt, noise[n], out[k])


@njit(cache=True, nogil=True, error_model="numpy")
def replay_rows(
    rows: Array, dt: float, commands: Array, seen: Array, starts: Integers, pasts: Integers, settle: int, lag: int,
    log_begin: Integers, doubt: float, faster: float, first: Integers, times: Array, out: Array,
) -> None:  # fmt: skip
    """Open loop for all rows (b, n): stretch j begins at grid instant starts[j], is read at times[first[j]:first[j+1]].

    commands (G, 2), seen (G, 5) on the grid; pasts (S,) how many steps of the past are known; times since the start of
    their stretch, ascending; out (b, len(times), READ). Commands count at any time, what was seen only until the start, at
    which the vehicle is `faster` (m/s) than that tells.
    Nobody reacts to noise here, so there is none.
    """
    s, shares, silence = np.empty(STATE), np.empty(2), np.zeros((1, 3))
    longest = 0.0
    for j in range(len(times)):
        longest = max(longest, times[j])
    history = np.empty((math.ceil(longest / dt - SAME_INSTANT) + 2, READ))
    for i in range(rows.shape[0]):
        p = rows[i]
        shares[0], shares[1] = share_of(p[DRIVE_LAG], dt), share_of(p[STEERING_LAG], dt)
        for j in range(len(starts)):
            if first[j] == first[j + 1]:
                continue
            begin(p, dt, commands, seen, starts[j], pasts[j], settle, lag, log_begin, doubt, shares, s)
            s[SPEED] += faster
            keep(p, s, history[0])
            steps = math.ceil(times[first[j + 1] - 1] / dt - SAME_INSTANT)
            for k in range(steps):
                advance(p, dt, commands, starts[j] + k, shares, s)
                step_chassis(p, dt, s)
                keep(p, s, history[k + 1])
            here = slice(first[j], first[j + 1])
            read_off(p, history, steps, dt, times[here], silence, 1.0, out[i, here])


@njit(cache=True, nogil=True, error_model="numpy")
def in_force(p: Array, speed: float) -> float:
    """What is commanded of the drive of a vehicle that keeps its `speed` (m/s); of a throttle nothing is known."""
    return speed / p[DRIVE] if p[SPEED_GAIN] > 0.0 else 0.0 if p[DRIVE] > 0.0 else speed


@njit(cache=True, nogil=True, error_model="numpy")
def start_from(p: Array, before: Array, s: Array) -> None:
    """The state s (STATE,) of a vehicle whose tracked point is where, and as fast as, `before` (STATE,) has it."""
    s[:] = before
    s[SPEED] = forward_speed(p, before)
    if p[DRIVE] > 0.0:
        s[MOTOR] = in_force(p, s[SPEED])
    place(p, before, s)


@njit(cache=True, nogil=True, error_model="numpy")
def start_all(rows: Array, before: Array, state: Array) -> None:
    """`start_from` for all rows: state (b, STATE)."""
    for i in range(rows.shape[0]):
        start_from(rows[i], before, state[i])


@njit(cache=True, nogil=True, error_model="numpy")
def drive(
    p: Array, before: Array, orders: Array, tick: int, substeps: int, dt: float, shares: Array, s: Array, history: Array
) -> None:  # fmt: skip
    """From control tick `tick` to the next one: `substeps` steps under the delayed orders (ticks, 2) so far.

    before (STATE,) is the start: its speed and steering are in force until the first order arrives.
    """
    period = substeps * dt
    resting = in_force(p, before[SPEED])
    for j in range(substeps):
        now = tick + j / substeps
        wanted = delayed(orders, 0, tick, now - p[DRIVE_DELAY] / period, resting)
        steering = delayed(orders, 1, tick, now - p[STEERING_DELAY] / period, before[LAGGED])
        step_actuators(p, dt, wanted, steering, shares, s)
        step_chassis(p, dt, s)
        keep(p, s, history[tick * substeps + j + 1])


@njit(cache=True, nogil=True, error_model="numpy")
def follow_rows(
    rows: Array, start: Array, gains: Array, settings: Array, path: Array, ticks: int, substeps: int, dt: float,
    noise: Array, read: Array, out: Array, orders: Array,
) -> None:  # fmt: skip
    """Closed loop with the Stanley law: rows (b, n) with gains (b, 7) on one path; out (b, T, READ), orders (b, ticks, 2)."""
    history = np.empty((ticks * substeps + 1, READ))
    s, pose, shares = np.empty(STATE), np.empty(READ), np.empty(2)
    memory = np.empty(MEMORY)
    for i in range(rows.shape[0]):
        p = rows[i]
        start_from(p, start, s)
        memory[:] = 0.0
        shares[0], shares[1] = share_of(p[DRIVE_LAG], dt), share_of(p[STEERING_LAG], dt)
        keep(p, s, history[0])
        for n in range(ticks):
            measure(p, history, n * substeps, n * substeps, dt, noise[n], pose)
            speed, steering = stanley(gains[i], settings, path, memory, pose[0], pose[1], pose[2], pose[3], pose[4])
            orders[i, n, 0], orders[i, n, 1] = speed, steering
            drive(p, start, orders[i], n, substeps, dt, shares, s, history)
        read_off(p, history, ticks * substeps, dt, read, noise, substeps * dt, out[i])


@njit(cache=True, nogil=True, error_model="numpy")
def measure_all(rows: Array, history: Array, k: int, dt: float, noise: Array, out: Array) -> None:
    """`measure` after k steps for all rows: history (b, steps + 1, READ), out (b, READ)."""
    for i in range(rows.shape[0]):
        measure(rows[i], history[i], k, k, dt, noise, out[i])


@njit(cache=True, nogil=True, error_model="numpy")
def drive_all(
    rows: Array, alive: Mask, start: Array, orders: Array, tick: int, substeps: int, dt: float, state: Array,
    history: Array,
) -> None:  # fmt: skip
    """`drive` for rows that are `alive` (b,): orders (b, ticks, 2), state (b, STATE), history (b, steps + 1, READ)."""
    shares = np.empty(2)
    for i in range(rows.shape[0]):
        if not alive[i]:
            continue
        shares[0], shares[1] = share_of(rows[i, DRIVE_LAG], dt), share_of(rows[i, STEERING_LAG], dt)
        drive(rows[i], start, orders[i], tick, substeps, dt, shares, state[i], history[i])


@njit(cache=True, nogil=True, error_model="numpy")
def read_all(
    rows: Array, history: Array, last: int, dt: float, times: Array, noise: Array, period: float, out: Array
) -> None:
    """`read_off` for all rows: out (b, T, READ)."""
    for i in range(rows.shape[0]):
        read_off(rows[i], history[i], last, dt, times, noise, period, out[i])
