# SPDX-License-Identifier: Apache-2.0
"""Where the tool is along straight moves that blend into each other, as compiled kernels.

Blending is what industrial controllers call fly-by: the next move starts while the last one slows down, and both add
up. The tool leaves the straight line only there, its speed hardly falls, and position, speed and (with rounded ramps)
acceleration stay continuous.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trueup.arrays import Array
from trueup.compiled import njit
from trueup.excitation.chain import rotation_between, turned
from trueup.excitation.profiles import advance, law, ramps, time_of_share
from trueup.identification.poses import apply, copy_row, distance, length, put_all


class Pace(NamedTuple):
    """How fast a program of tool moves is driven; one number each, the same for all its moves."""

    speed: float
    """m/s along a straight move."""
    turn: float
    """rad/s of the orientation; joints asked for by value go at this speed too."""
    ramp: float
    """s from rest to full speed: the smaller, the more abrupt."""
    rounding: float
    """s in which an acceleration builds up; 0 for trapezoidal profiles."""
    fly: float
    """Share of the ramp during which a move is blended with the next; 0 stops at each via point."""
    zone: float
    """m: blending does not begin further than this from a via point; may be infinite."""


class Program(NamedTuple):
    """Straight tool moves through K via points and the laws by which they are made."""

    P: Array
    """(K, 3) positions in m."""
    R: Array
    """(K, 3, 3) orientations."""
    X: Array
    """(K, own) values of joints that are asked for by value."""
    turns: Array
    """(K - 1, 3) rotation from each via point to the next, in the frame of the first."""
    T: Array
    """(K - 1, 3) rectangles of the law of each move."""
    begin: Array
    """(K - 1,) when each move starts, in s."""


@njit(cache=True, nogil=True)
def program(P: Array, R: Array, X: Array) -> Program:
    """A program with its turns; laws and starts are still to be planned."""
    moves, turn = len(P) - 1, np.empty(3)
    turns = np.empty((moves, 3))
    for k in range(moves):
        rotation_between(R[k], R[k + 1], turn)
        apply(R[k].T, turn, turns[k])
    return Program(P, R, X, turns, np.empty((moves, 3)), np.empty(moves))


@njit(cache=True, nogil=True)
def tool_laws(way: Program, pace: Pace, slow: Array) -> None:
    """Fills T of a program; `slow` (K - 1, 2) as in `law_of`."""
    for k in range(len(way.turns)):
        seconds = distance(way.P[k + 1], way.P[k]) / pace.speed
        seconds = max(seconds, length(way.turns[k]) / pace.turn)
        for i in range(way.X.shape[1]):
            seconds = max(seconds, abs(way.X[k + 1, i] - way.X[k, i]) / pace.turn)
        law_of(seconds, pace.ramp, pace.rounding, slow[k], way.T[k])


@njit(cache=True, nogil=True)
def law_of(seconds: float, ramp: float, rounding: float, slow: Array, T: Array) -> None:
    """T (3,): rectangles of a move of `seconds` at full speed; slow (2,) >= 1 divides its speed and its acceleration."""
    acceleration = 1.0 / (ramp * slow[0] * slow[1])
    jerk = np.inf if rounding <= 0.0 else acceleration / (rounding * slow[0] * np.sqrt(slow[1]))
    T[0], T[1], T[2] = ramps(seconds, 1.0 / slow[0], acceleration, jerk)


@njit(cache=True, nogil=True)
def slow_down(need: Array, turn: int, slow: Array) -> float:
    """Slows moves (K, 2) by what was exceeded: need (K, 2) by speed and by acceleration. Returns the largest excess.

    Accelerations are first taken out of the ramps; what then remains comes from the way itself, and speed must fall.
    """
    most = 1.0
    for k in range(len(slow)):
        most = max(most, need[k, 0], np.sqrt(need[k, 1]))
        slow[k, 0] *= need[k, 0] if turn < 2 else max(need[k, 0], np.sqrt(need[k, 1]))
        if turn < 2:
            slow[k, 1] *= need[k, 1]
    return most


@njit(cache=True, nogil=True)
def starts(T: Array, reach: Array, fly: float, begin: Array) -> float:
    """Begin (K - 1,): when each move starts [s]. Returns when the last one ends.

    `reach` (K - 1,): share of each move from which on, or up to which, it may be blended (at least a half).
    """
    end = 0.0
    before = 0.0  # how long the last move may blend
    for k in range(len(T)):
        total = T[k, 0] + T[k, 1] + T[k, 2]
        mine = min(T[k, 1] + T[k, 2], 0.5 * total)
        if reach[k] > 0.5 and total > 0.0:
            mine = min(mine, total - time_of_share(reach[k], T[k, 0], T[k, 1], T[k, 2]))
        begin[k] = end - (fly * min(before, mine) if k > 0 else 0.0)
        end, before = begin[k] + total, mine
    return end


@njit(cache=True, nogil=True)
def tool_state(t: float, way: Program, R_: Array, p: Array, v: Array, a: Array) -> int:
    """Pose R_ (3, 3), p (3,) and rates v, a (6 + own,) of the program at t; own joint values go to v, a's tail and p's.

    p has 3 + own entries. Returns the move that is under way (the later one where two blend).
    """
    P, R, X, turns, T, begin = way
    copy_row(P[0], p)
    copy_row(X[0], p[3:])
    v[:] = 0.0
    a[:] = 0.0
    put_all(R[0], R_)
    now = 0
    axis, spin, next_ = np.empty(3), np.empty(3), np.empty((3, 3))
    for k in range(len(T)):
        if t <= begin[k]:
            break
        now = k
        s, rate, bend = law(t - begin[k], T[k, 0], T[k, 1], T[k, 2])
        if s >= 1.0:
            copy_row(P[k + 1], p)
            copy_row(X[k + 1], p[3:])
            put_all(R[k + 1], R_)
            continue
        advance(P[k], P[k + 1], s, rate, bend, p[:3], v[:3], a[:3])
        advance(X[k], X[k + 1], s, rate, bend, p[3:], v[6:], a[6:])
        apply(R_, turns[k], axis)  # in the base frame, carried by what still turns of the move before
        copy_row(v[3:6], spin)
        a[3] += axis[0] * bend + (spin[1] * axis[2] - spin[2] * axis[1]) * rate
        a[4] += axis[1] * bend + (spin[2] * axis[0] - spin[0] * axis[2]) * rate
        a[5] += axis[2] * bend + (spin[0] * axis[1] - spin[1] * axis[0]) * rate
        for i in range(3):
            v[3 + i] = spin[i] + axis[i] * rate
        turned(R_, turns[k], s, next_)
        put_all(next_, R_)
    return now
