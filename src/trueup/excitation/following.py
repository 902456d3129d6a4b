# SPDX-License-Identifier: Apache-2.0
"""Joint motion along a program of straight tool moves, slowed where a joint could not follow, as compiled kernels."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array, Integers
from trueup.compiled import njit
from trueup.excitation.chain import ChainArrays, place, unforced_acceleration
from trueup.excitation.inverse_kinematics import (
    LEAST_GAIN,
    REACHED,
    REASONS,
    SINGULAR,
    Equations,
    invert,
    matrix,
    settle,
    travel,
)
from trueup.excitation.tool_path import Pace, Program, program, slow_down, starts, tool_laws, tool_state
from trueup.identification.poses import apply, copy_row, distance

NO_MOTION = len(REASONS)
"""How a plan ended when all its moves have no length; the other ends are those of the inverse kinematics."""


@njit(cache=True, nogil=True)
def follow(
    chain: ChainArrays, equations: Equations, way: Program, times: Array, start: Array, q: Array, qd: Array, qdd: Array,
    under: Integers,
) -> int:  # fmt: skip
    """q, qd, qdd (S, n) at `times` (S,) along a program, from the posture `start` (n,) near its first pose.

    Speeds and accelerations are exact, from the Jacobian and its rate. `under` (S,) is the move under way. Returns how
    it ended. Longer than 40 lines because a compiled loop pays for each scratch array that it cannot keep.
    """
    m, n = len(chain.joint), len(start)
    R_, R0, p0, z, o = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty((m, 3)), np.empty((m, 3))
    own = way.X.shape[1]
    p, v, a, drift = np.empty(3 + own), np.empty(6 + own), np.empty(6 + own), np.empty(6)
    J, A, inverse = np.empty((6, m)), np.empty((m, m)), np.empty((m, m))
    rows = equations.rows
    wanted, speed, bend = np.empty(m), np.empty(m), np.empty(m)
    here = start.copy()
    for s in range(len(times)):
        under[s] = tool_state(times[s], way, R_, p, v, a)
        if s > 0:
            dt = times[s] - times[s - 1]
            for j in range(n):
                here[j] = q[s - 1, j] + dt * qd[s - 1, j] + 0.5 * dt * dt * qdd[s - 1, j]
        ended = settle(chain, equations, R_, p[:3], p[3:], LEAST_GAIN, here)
        if ended != REACHED:
            return ended
        place(chain, here, R0, p0, z, o)
        matrix(chain, equations, p0, z, o, J, A)
        if invert(A, inverse) < LEAST_GAIN:
            return SINGULAR
        copy_row(v[:rows], wanted)
        copy_row(v[6:], wanted[rows:])
        apply(inverse, wanted, speed)
        unforced_acceleration(chain, p0, z, o, speed, drift)
        for i in range(rows):
            wanted[i] = a[i] - drift[i]
        copy_row(a[6:], wanted[rows:])
        apply(inverse, wanted, bend)
        copy_row(here, q[s])
        qd[s], qdd[s] = 0.0, 0.0
        for i in range(m):
            qd[s, chain.joint[i]] = speed[i]
            qdd[s, chain.joint[i]] = bend[i]
    return REACHED


@njit(cache=True, nogil=True)
def planned(
    chain: ChainArrays, equations: Equations, way: Program, pace: Pace, limits: tuple[Array, Array], start: Array, look: int
) -> tuple[int, float]:  # fmt: skip
    """Plans one program: laws and starts of its moves such that no joint exceeds its speed and acceleration, `limits` (n,).

    A move that asks too much of a joint is slowed down, with those that it blends with, as controllers do. `look`:
    samples on which that is judged. Returns how it ended and the duration [s]. Longer than 40 lines because a compiled
    loop pays for each scratch array that it cannot keep.
    """
    moves, n = len(way.turns), len(start)
    reach, slow = np.zeros(moves), np.ones((moves, 2))
    for k in range(moves):
        far = distance(way.P[k + 1], way.P[k])
        reach[k] = 0.0 if far <= 2.0 * pace.zone else 1.0 - pace.zone / far
    q, qd, qdd = np.empty((look, n)), np.empty((look, n)), np.empty((look, n))
    under, need = np.zeros(look, np.int64), np.empty((moves, 2))
    end = 0.0
    for turn in range(5):
        tool_laws(way, pace, slow)
        end = starts(way.T, reach, pace.fly, way.begin)
        if end <= 0.0:
            return NO_MOTION, 0.0
        ended = follow(chain, equations, way, np.linspace(0.0, end, look), start, q, qd, qdd, under)
        if ended != REACHED:
            return ended, end
        need[:] = 1.0
        for s in range(look):
            fast, hard = excess(qd[s], qdd[s], limits[0], limits[1])
            for k in range(max(0, under[s] - 1), under[s] + 1):
                if end * s / (look - 1) <= way.begin[k] + way.T[k, 0] + way.T[k, 1] + way.T[k, 2]:
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
    chain: ChainArrays, equations: Equations, P: Array, R: Array, X: Array, pace: Array, limits: tuple[Array, Array],
    posture: Array, look: int, time: Array, q: Array, qd: Array, qdd: Array, ended: Integers,
) -> None:  # fmt: skip
    """Plans and follows B programs of K via points: P (B, K, 3), R (B, K, 3, 3), X (B, K, own), pace (B, 6).

    `limits`: speed and acceleration (n,). time (B, S), q, qd, qdd (B, S, n): samples evenly over each program's own duration;
    `ended` (B,).
    """
    samples = time.shape[1]
    for b in range(len(P)):
        own = Pace(pace[b, 0], pace[b, 1], pace[b, 2], pace[b, 3], pace[b, 4], pace[b, 5])
        start, end = posture.copy(), 0.0
        ended[b] = travel(chain, equations, R[b, 0], P[b, 0], X[b, 0], LEAST_GAIN, start)
        if ended[b] != REACHED:
            continue
        way = program(P[b], R[b], X[b])
        ended[b], end = planned(chain, equations, way, own, limits, start, look)
        if ended[b] == REACHED:
            time[b] = np.linspace(0.0, end, samples)
            under = np.zeros(samples, np.int64)
            ended[b] = follow(chain, equations, way, time[b], start, q[b], qd[b], qdd[b], under)
            keep(time[b], qd[b], qdd[b], limits[0], limits[1])
