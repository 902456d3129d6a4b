# SPDX-License-Identifier: Apache-2.0
"""Joint motion along a program of straight tool moves, slowed where a joint could not follow, as compiled kernels."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueup.excitation.chain import ChainArrays, place, unforced_acceleration
from trueup.excitation.inverse_kinematics import (
    LEAST_GAIN,
    REACHED,
    SINGULAR,
    Equations,
    invert,
    matrix,
    settle,
    travel,
)
from trueup.excitation.tool_path import Pace, move_lengths, slow_down, starts, tool_laws, tool_state

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

NO_MOTION = 4
"""How a plan ended when all its moves have no length; the other ends are those of the inverse kinematics."""


@njit(cache=True, nogil=True)
def follow(
    chain: ChainArrays,
    equations: Equations,
    begin: Array,
    T: Array,
    P: Array,
    R: Array,
    turns: Array,
    X: Array,
    times: Array,
    start: Array,
    q: Array,
    qd: Array,
    qdd: Array,
    under: Indices,
) -> int:
    """q, qd, qdd (S, n) at `times` (S,) along a program, from the posture `start` (n,) near its first pose.

    Speeds and accelerations are exact, from the Jacobian and its rate. `under` (S,) is the move under way. Returns how
    it ended. Longer than 40 lines because a compiled loop pays for each scratch array that it cannot keep.
    """  # fmt: skip
    m, n = len(chain.joint), len(start)
    R_, R0, p0, z, o = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty((m, 3)), np.empty((m, 3))
    p, v, a, drift = np.empty(3 + X.shape[1]), np.empty(6 + X.shape[1]), np.empty(6 + X.shape[1]), np.empty(6)
    J, A, inverse = np.empty((6, m)), np.empty((m, m)), np.empty((m, m))
    rows = equations.rows
    wanted, speed = np.empty(m), np.empty(m)
    here = start.copy()
    for s in range(len(times)):
        under[s] = tool_state(times[s], begin, T, P, R, turns, X, R_, p, v, a)
        if s > 0:
            dt = times[s] - times[s - 1]
            here = q[s - 1] + dt * qd[s - 1] + 0.5 * dt * dt * qdd[s - 1]
        ended = settle(chain, equations, R_, p[:3], p[3:], LEAST_GAIN, here)
        if ended != REACHED:
            return ended
        place(chain, here, R0, p0, z, o)
        matrix(chain, equations, p0, z, o, J, A)
        if invert(A, inverse) < LEAST_GAIN:
            return SINGULAR
        wanted[:rows] = v[:rows]
        wanted[rows:] = v[6:]
        speed[:] = inverse @ wanted
        unforced_acceleration(chain, p0, z, o, speed, drift)
        wanted[:rows] = a[:rows] - drift[:rows]
        wanted[rows:] = a[6:]
        bend = inverse @ wanted
        q[s], qd[s], qdd[s] = here, np.zeros(n), np.zeros(n)
        for i in range(m):
            qd[s, chain.joint[i]] = speed[i]
            qdd[s, chain.joint[i]] = bend[i]
    return REACHED


@njit(cache=True, nogil=True)
def tool_program(
    chain: ChainArrays,
    equations: Equations,
    P: Array,
    R: Array,
    X: Array,
    pace: Pace,
    speed: Array,
    acceleration: Array,
    start: Array,
    look: int,
    slow: Array,
    begin: Array,
    T: Array,
    turns: Array,
) -> tuple[int, float]:
    """Plans one program: laws T and `begin` of its moves such that no joint exceeds `speed`, `acceleration` (n,).

    A move that asks too much of a joint is slowed down, with those that it blends with, as controllers do. `look`:
    samples on which that is judged. Returns how it ended and the duration [s]. Longer than 40 lines because a compiled
    loop pays for each scratch array that it cannot keep.
    """  # fmt: skip
    moves, n = len(turns), len(start)
    move_lengths(P, R, X, turns)
    reach = np.zeros(moves)
    for k in range(moves):
        length = np.sqrt(np.sum((P[k + 1] - P[k]) ** 2))
        reach[k] = 0.0 if length <= 2.0 * pace.zone else 1.0 - pace.zone / length
    slow[:] = 1.0
    q, qd, qdd = np.empty((look, n)), np.empty((look, n)), np.empty((look, n))
    under, need = np.zeros(look, np.int64), np.empty((moves, 2))
    end = 0.0
    for turn in range(5):
        tool_laws(P, turns, X, pace, slow, T)
        end = starts(T, reach, pace.fly, begin)
        if end <= 0.0:
            return NO_MOTION, 0.0
        ended = follow(
            chain, equations, begin, T, P, R, turns, X, np.linspace(0.0, end, look), start, q, qd, qdd, under
        )
        if ended != REACHED:
            return ended, end
        need[:] = 1.0
        for s in range(look):
            fast, hard = excess(qd[s], qdd[s], speed, acceleration)
            for k in range(max(0, under[s] - 1), under[s] + 1):
                if end * s / (look - 1) <= begin[k] + T[k, 0] + T[k, 1] + T[k, 2]:
                    need[k, 0], need[k, 1] = max(need[k, 0], fast), max(need[k, 1], hard)
        if turn == 4 or slow_down(need, turn, slow) <= 1.01:
            break
    return REACHED, end


@njit(cache=True, nogil=True)
def excess(qd: Array, qdd: Array, speed: Array, acceleration: Array) -> tuple[float, float]:
    """The largest share of a joint's speed, and of its acceleration, that a motion takes; above 1 it is too much."""
    fast, hard = 0.0, 0.0
    for j in range(len(qd)):
        fast = max(fast, abs(qd[j]) / speed[j])
        hard = max(hard, abs(qdd[j]) / acceleration[j])
    return fast, hard


@njit(cache=True, nogil=True)
def keep(time: Array, qd: Array, qdd: Array, speed: Array, acceleration: Array) -> None:
    """Slows a whole sampled motion down, in place, by what its joints still exceed: a peak between earlier looks."""
    factor = 1.0
    for s in range(len(time)):
        fast, hard = excess(qd[s], qdd[s], speed, acceleration)
        factor = max(factor, fast, np.sqrt(hard))
    if factor > 1.0:
        time *= factor
        qd /= factor
        qdd /= factor * factor


@njit(cache=True, nogil=True)
def tool_programs(
    chain: ChainArrays,
    equations: Equations,
    P: Array,
    R: Array,
    X: Array,
    pace: Array,
    speed: Array,
    acceleration: Array,
    posture: Array,
    look: int,
    time: Array,
    q: Array,
    qd: Array,
    qdd: Array,
    ended: Indices,
) -> None:
    """Plans and follows B programs of K via points: P (B, K, 3), R (B, K, 3, 3), X (B, K, own), pace (B, 6).

    time (B, S), q, qd, qdd (B, S, n): samples evenly over each program's own duration; `ended` (B,).
    """  # fmt: skip
    count, moves, samples = len(P), P.shape[1] - 1, time.shape[1]
    for b in range(count):
        own = Pace(pace[b, 0], pace[b, 1], pace[b, 2], pace[b, 3], pace[b, 4], pace[b, 5])
        slow, begin, T, turns = np.empty((moves, 2)), np.empty(moves), np.empty((moves, 3)), np.empty((moves, 3))
        start = posture.copy()
        status = travel(chain, equations, R[b, 0], P[b, 0], X[b, 0], LEAST_GAIN, start)
        if status == REACHED:
            status, end = tool_program(
                chain, equations, P[b], R[b], X[b], own, speed, acceleration, start, look, slow, begin, T, turns
            )
            if status == REACHED:
                for s in range(samples):
                    time[b, s] = end * s / (samples - 1)
                under = np.zeros(samples, np.int64)
                status = follow(
                    chain, equations, begin, T, P[b], R[b], turns, X[b], time[b], start, q[b], qd[b], qdd[b], under
                )
                keep(time[b], qd[b], qdd[b], speed, acceleration)
        ended[b] = status
