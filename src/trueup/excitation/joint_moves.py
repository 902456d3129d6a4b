# SPDX-License-Identifier: Apache-2.0
"""Blended joint moves as compiled kernels: each joint goes its share of the same law, in the time of the slowest."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array, Integers
from trueup.compiled import njit
from trueup.excitation.following import NO_MOTION, excess, keep
from trueup.excitation.inverse_kinematics import REACHED
from trueup.excitation.profiles import advance, law
from trueup.excitation.tool_path import law_of, slow_down, starts
from trueup.identification.poses import copy_row


@njit(cache=True, nogil=True)
def joint_state(t: float, begin: Array, T: Array, Q: Array, q: Array, qd: Array, qdd: Array) -> None:
    """q, qd, qdd (n,) at t [s] of joint moves through postures Q (K, n)."""
    copy_row(Q[0], q)
    qd[:] = 0.0
    qdd[:] = 0.0
    for k in range(len(T)):
        if t <= begin[k]:
            return
        s, rate, bend = law(t - begin[k], T[k, 0], T[k, 1], T[k, 2])
        if s >= 1.0:
            copy_row(Q[k + 1], q)
            continue
        advance(Q[k], Q[k + 1], s, rate, bend, q, qd, qdd)


@njit(cache=True, nogil=True)
def joint_laws(Q: Array, share: float, ramp: float, rounding: float, speed: Array, slow: Array, T: Array) -> None:
    """T (K - 1, 3): rectangles of the law of each move; the slowest joint goes at `share` of its speed (n,)."""
    for k in range(len(T)):
        seconds = 0.0
        for j in range(Q.shape[1]):
            seconds = max(seconds, abs(Q[k + 1, j] - Q[k, j]) / (share * speed[j]))
        law_of(seconds, ramp, rounding, slow[k], T[k])


@njit(cache=True, nogil=True)
def joint_programs(
    Q: Array, pace: Array, speed: Array, acceleration: Array, time: Array, q: Array, qd: Array, qdd: Array,
    ended: Integers,
) -> None:  # fmt: skip
    """Plans B programs of joint moves through Q (B, K, n); pace (B, 4) is share, ramp, rounding, fly.

    time (B, S), q, qd, qdd (B, S, n): samples evenly over each program's own duration; `ended` (B,).
    """
    count, moves, samples = len(Q), Q.shape[1] - 1, time.shape[1]
    for b in range(count):
        slow, begin, T = np.ones((moves, 2)), np.empty(moves), np.empty((moves, 3))
        reach, need = np.zeros(moves), np.empty((moves, 2))
        x, v, a = np.empty(Q.shape[2]), np.empty(Q.shape[2]), np.empty(Q.shape[2])
        ended[b] = NO_MOTION
        end = 0.0
        for turn in range(5):
            joint_laws(Q[b], pace[b, 0], pace[b, 1], pace[b, 2], speed, slow, T)
            end = starts(T, reach, pace[b, 3], begin)
            if end <= 0.0:
                break
            ended[b] = REACHED
            need[:] = 1.0
            look = 60 * moves
            for s in range(look):
                t = end * s / (look - 1)
                joint_state(t, begin, T, Q[b], x, v, a)
                fast, hard = excess(v, a, speed, acceleration)
                for k in range(moves):
                    if begin[k] <= t <= begin[k] + T[k, 0] + T[k, 1] + T[k, 2]:
                        need[k, 0], need[k, 1] = max(need[k, 0], fast), max(need[k, 1], hard)
            if turn == 4 or slow_down(need, turn, slow) <= 1.01:
                break
        if ended[b] == REACHED:
            for s in range(samples):
                time[b, s] = end * s / (samples - 1)
                joint_state(time[b, s], begin, T, Q[b], q[b, s], qd[b, s], qdd[b, s])
            keep(time[b], qd[b], qdd[b], speed, acceleration)
