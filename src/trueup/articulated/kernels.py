# SPDX-License-Identifier: Apache-2.0
"""Compiled inner loops over simulations and samples: delayed commands, servo dead bands, reading off at instants."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array, Integers
from trueup.compiled import njit


@njit(cache=True, nogil=True)
def delayed_commands(
    times: Array, values: Array, integral: Array, delay: Array, first: int, step: float, out: Array
) -> None:
    """The mean of each held, delayed command over each step: exact for any fraction of a step, smooth in the delay.

    times (n,) s; values, integral (n, k) held values and their running integral; delay (b, k) s;
    out (b, steps, k): row i, step s covers [(first + s) step, (first + s + 1) step), however many are asked for at once.
    """
    n = len(times)
    for i in range(out.shape[0]):
        for j in range(out.shape[2]):
            if (
                i > 0 and delay[i, j] == delay[0, j]
            ):  # as it is in all rows but that which a slope in the delay is taken of
                out[i, :, j] = out[0, :, j]
                continue
            at = max(np.searchsorted(times, first * step - delay[i, j], side="right") - 1, 0)
            before = 0.0
            for s in range(out.shape[1] + 1):
                t = (first + s) * step - delay[i, j]
                while at + 1 < n and times[at + 1] <= t:
                    at += 1
                area = integral[at, j] + values[at, j] * (t - times[at])
                if s > 0:
                    out[i, s - 1, j] = (area - before) / step
                before = area


@njit(cache=True, nogil=True)
def own_delayed_commands(
    times: Array, values: Array, count: int, delay: Array, first: int, step: float, out: Array
) -> None:
    """As `delayed_commands` from step `first` on, each row with its own commands: values (n, b, k), `count` of them set."""
    for i in range(out.shape[0]):
        for s in range(out.shape[1]):
            for j in range(out.shape[2]):
                # As instants of steps are told to controllers: what is given at the next step is none of this one's.
                left, right = (first + s) * step - delay[i, j], (first + s + 1) * step - delay[i, j]
                at = count - 1
                while at > 0 and times[at] >= right:
                    at -= 1
                area = 0.0
                while at > 0 and times[at] > left:
                    area += values[at, i, j] * (right - times[at])
                    right = times[at]
                    at -= 1
                area += values[at, i, j] * (right - left)
                out[i, s, j] = area / step


@njit(cache=True, nogil=True)
def late_columns(past: Array, whole: Integers, rest: Array, columns: Integers, out: Array) -> None:
    """Fills some columns of `out` (b, size) with what they were whole (b,) steps and the rest (b,) of one ago.

    past (b, m, size), the latest last; what is longer ago counts as the oldest.
    """
    last = past.shape[1] - 1
    for i in range(len(out)):
        later, earlier = last - whole[i], max(last - whole[i] - 1, 0)
        for c in columns:
            out[i, c] = past[i, later, c] + rest[i] * (past[i, earlier, c] - past[i, later, c])


@njit(cache=True, nogil=True)
def set_point(command: float, place: float, pace: float, top: float, most: float, step: float) -> tuple[float, float]:
    """Place and pace one step on of a set point that follows a command within a limit of speed, and `most` change of it."""
    left = command - place
    if np.isinf(most):
        pace = min(max(left / step, -top), top)
    else:
        # The speed from which it can still stop there, a step ahead: sqrt(2 a d) made for steps.
        brake = most * (np.sqrt(0.25 + 2.0 * abs(left) / (most * step)) - 0.5)
        wanted = np.sign(left) * min(brake, top)
        pace += min(max(wanted - pace, -most), most)
        if abs(left) <= most * step and abs(pace) <= 1.001 * most:
            pace = left / step
    return place + pace * step, pace


@njit(cache=True, nogil=True)
def limited_commands(
    command: Array, speed: Array, acceleration: Array, step: float, place: Array, pace: Array, out: Array
) -> None:
    """Set points that follow a command as fast as limits of speed and acceleration let them, and stop where it is.

    command, out (b, steps, k); speed, acceleration (b, k), inf for none; place and pace (b, k) of the set point go on
    from call to call. The profile of drives with a trapezoidal generator (Dynamixel's profile velocity and acceleration).
    """
    for i in range(command.shape[0]):
        for j in range(command.shape[2]):
            x, v, top, most = place[i, j], pace[i, j], speed[i, j], acceleration[i, j] * step
            for s in range(command.shape[1]):
                x, v = set_point(command[i, s, j], x, v, top, most, step)
                out[i, s, j] = x
            place[i, j], pace[i, j] = x, v


ONSET = 2e-3
"""rad (or m) of error within which a servo's punch sets in: an encoder step or two."""


@njit(cache=True, nogil=True)
def firmware_error(error: float, band: float, kick: float) -> float:
    """The error that a plain servo must see to push like one with a dead band and a punch; all in rad.

    `band` half width; `kick` the punch as an error of the plain servo: a spring so steep that it is at its limit from
    the first encoder steps on (least power of Dynamixel AX servos: J. Tan et al., IROS 2016, Figure 8).
    """
    if band > 0.0:
        error = np.sign(error) * max(abs(error) - band, 0.0)
    if kick > 0.0:
        error += min(max(error / ONSET, -1.0), 1.0) * kick
    return error


@njit(cache=True, nogil=True)
def firmware_command(command: Array, position: Array, band: Array, kick: Array, out: Array) -> None:
    """What a servo without dead band and punch must be told to push like one with them; all (b, k), in rad."""
    for i in range(command.shape[0]):
        for j in range(command.shape[1]):
            at = position[i, j]
            out[i, j] = at + firmware_error(command[i, j] - at, band[i, j], kick[i, j])


@njit(cache=True, nogil=True)
def stribeck_friction(
    speed: Array, force: Array, coulomb: Array, static: Array, stribeck: Array, load: Array, out: Array
) -> None:
    """Friction limit of each joint at its present speed: Coulomb + breakaway exp(-(v / vs)^2) + load share; all (b, k).

    Armstrong-Helouvry et al., "A survey of models ... for control of machines with friction", Automatica 30(7), 1994.
    """
    for i in range(speed.shape[0]):
        for j in range(speed.shape[1]):
            ratio = speed[i, j] / stribeck[i, j]
            out[i, j] = coulomb[i, j] + static[i, j] * np.exp(-ratio * ratio) + load[i, j] * abs(force[i, j])


@njit(cache=True, nogil=True)
def read_off(
    history: Array, rows: Integers, first: int, last: int, ends: bool, at: Array, shared: bool, bias: Array,
    out: Array,
) -> None:  # fmt: skip
    """Interpolates a stretch of simulated steps at the instants that fall into it.

    history (n, m, k) holds steps first ... first + m - 1 of `rows` (n,) of b; `at` (b or 1, T) instants in steps,
    ascending; those in [first, last), and all later ones where the run `ends` here, are written to out (b, T, k), plus
    `bias` (b, k). Instants before the run's begin are on the line through its first two steps.
    """
    held = history.shape[1]
    for n in range(history.shape[0]):
        i = rows[n]
        row = 0 if shared else i
        begin = np.searchsorted(at[row], first) if first > 0 else 0
        for t in range(begin, out.shape[1]):
            x = at[row, t]
            if x >= last and not ends:
                break
            k = max(min(int(np.floor(x)) - first, held - 2), 0)
            f = min(x - first - k, 1.0)
            for j in range(out.shape[2]):
                a, b = history[n, k, j], history[n, k + 1, j]
                out[i, t, j] = a + f * (b - a) + bias[i, j]
