# SPDX-License-Identifier: Apache-2.0
"""Compiled: joint angles of legs whose axes follow in another order, do not meet, or are fewer than six, by least squares."""

from __future__ import annotations

import math

import numpy as np

from trueup.arrays import Array, Integers
from trueup.compiled import njit
from trueup.controllers.walk_engine.kernel import turned

_ROUNDS, _ENOUGH, _LARGEST, _DAMPED = (
    8,
    1e-6,
    0.5,
    1e-9,
)  # steps and their ends in rad; damping beside squares of about 1


@njit(cache=True, nogil=True)
def refine(
    wanted: tuple[Array, Array, Array, Array, Array, Array], turns: Array, hips: Array, ankles: Array, scales: Array,
    order: Integers, axes: Array, anchors: Array, out: Array,
) -> None:  # fmt: skip
    """Takes `out` (b, 2, 6), joint angles of a leg alike, to those of the leg that there is: ankle and sole as wanted.

    `wanted` (b, 2) as in `Legs.angles`, whose yaw turns the leg by `turns` (2,) rad for each rad of the first joint; `hips`
    and `ankles` (2, 3) where a leg begins and ends, `scales` (2,) its length, in m; `order` (2, 6) of its joints from the hip
    down, -1 after the last; `axes` and `anchors` (2, 6, 3) at zero angles. A leg without a yaw is not asked for a heading,
    one without an ankle roll not for its sole's. Gauss and Newton's steps, damped where joints line up (Levenberg 1944).
    """
    yaws, rolls, pitches, lengths, foot_rolls, foot_pitches = wanted
    rows, errors, normal, step = np.empty((6, 6)), np.empty(6), np.empty((6, 6)), np.empty(6)
    places, goal = np.empty((len(axes[0]) + 2, 2, 3)), np.empty((3, 3))
    for side in range(2):
        joints = order[side][order[side] >= 0]
        heading, tilting = np.any(joints == 0), np.any(joints == 5)
        for row in range(len(out)):
            psi, length = yaws[row, side] * turns[side], lengths[row, side]
            _pointing(psi, rolls[row, side], -pitches[row, side], goal[0])  # from ankle to hip
            for i in range(3):
                goal[0, i] = hips[side, i] - length * goal[0, i]
            _pointing(psi, foot_rolls[row, side], foot_pitches[row, side], goal[1])
            goal[2] = math.cos(psi), math.sin(psi), 0.0
            for _ in range(_ROUNDS):
                _linearised(joints, axes[side], anchors[side], ankles[side], out[row, side], places, goal, rows, errors)
                for k in range(3):
                    errors[k] /= scales[side]
                    for i in range(len(joints)):
                        rows[k, i] /= scales[side]
                for k, asked in ((3, tilting), (5, heading)):
                    if not asked:
                        rows[k], errors[k] = 0.0, 0.0
                if _least_squares(rows, errors, len(joints), normal, step) < _ENOUGH:
                    break
                for k in range(len(joints)):
                    out[row, side, joints[k]] += step[k]


@njit(cache=True, nogil=True)
def _pointing(psi: float, roll: float, pitch: float, out: Array) -> None:
    """Fills `out` (3,) with what points up, turned by `pitch` about y, then `roll` about x, then `psi` about z."""
    x, y, z = math.sin(pitch), -math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch)
    out[:] = math.cos(psi) * x - math.sin(psi) * y, math.sin(psi) * x + math.cos(psi) * y, z


@njit(cache=True, nogil=True)
def _linearised(
    joints: Integers, axes: Array, anchors: Array, ankle: Array, angles: Array, places: Array, goal: Array, rows: Array,
    errors: Array,
) -> None:  # fmt: skip
    """Fills `rows` (6, n ...) and `errors` (6,): how ankle and sole answer to the joints, and what they are off by.

    Rows are the ankle's x, y, z, and the foot's turns about its heading, to its side, and upward. `places` (n + 2, 2, 3) is
    room for points and directions: of the joints, of ankle and sole's normal, of ankle and the foot's x.
    """
    n = len(joints)
    for k in range(n):
        places[k, 0], places[k, 1] = anchors[joints[k]], axes[joints[k]]
    places[n, 0], places[n + 1, 0] = ankle, ankle
    places[n, 1], places[n + 1, 1] = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    for k in range(n - 1, -1, -1):  # what a joint carries turns about where it is while all above it stand at zero
        j = joints[k]
        axis, angle = (axes[j, 0], axes[j, 1], axes[j, 2]), float(angles[j])
        px, py, pz = anchors[j]
        for i in range(k + 1, n + 2):
            x, y, z = turned(axis, angle, (places[i, 0, 0] - px, places[i, 0, 1] - py, places[i, 0, 2] - pz))
            places[i, 0] = x + px, y + py, z + pz
            places[i, 1] = turned(axis, angle, (places[i, 1, 0], places[i, 1, 1], places[i, 1, 2]))
    end, up, ahead = places[n, 0], places[n, 1], places[n + 1, 1]
    # The foot's own directions as wanted: its normal, its heading within the sole, and the third.
    nx, ny, nz = goal[1]
    along = goal[2, 0] * nx + goal[2, 1] * ny + goal[2, 2] * nz
    hx, hy, hz = goal[2, 0] - along * nx, goal[2, 1] - along * ny, goal[2, 2] - along * nz
    size = math.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hy, hz = hx / size, hy / size, hz / size
    sx, sy, sz = ny * hz - nz * hy, nz * hx - nx * hz, nx * hy - ny * hx
    for i in range(3):
        errors[i] = goal[0, i] - end[i]
    errors[3] = sx * up[0] + sy * up[1] + sz * up[2]
    errors[4] = -(hx * up[0] + hy * up[1] + hz * up[2])
    errors[5] = -(sx * ahead[0] + sy * ahead[1] + sz * ahead[2])
    for k in range(n):
        (ax, ay, az), point = places[k, 1], places[k, 0]
        lx, ly, lz = end[0] - point[0], end[1] - point[1], end[2] - point[2]
        rows[0, k], rows[1, k], rows[2, k] = ay * lz - az * ly, az * lx - ax * lz, ax * ly - ay * lx
        rows[3, k] = ax * hx + ay * hy + az * hz
        rows[4, k] = ax * sx + ay * sy + az * sz
        rows[5, k] = ax * nx + ay * ny + az * nz


@njit(cache=True, nogil=True)
def _least_squares(rows: Array, errors: Array, n: int, normal: Array, step: Array) -> float:
    """Fills `step` (n ...) with what lessens the errors most (by Cholesky); returns the largest of it, in rad."""
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(6):
                total += rows[k, i] * rows[k, j]
            if i == j:
                total += _DAMPED
            for k in range(j):
                total -= normal[i, k] * normal[j, k]
            normal[i, j] = math.sqrt(max(total, _DAMPED)) if i == j else total / normal[j, j]
    for i in range(n):
        total = 0.0
        for k in range(6):
            total += rows[k, i] * errors[k]
        for k in range(i):
            total -= normal[i, k] * step[k]
        step[i] = total / normal[i, i]
    largest = 0.0
    for i in range(n - 1, -1, -1):
        total = step[i]
        for k in range(i + 1, n):
            total -= normal[k, i] * step[k]
        step[i] = total / normal[i, i]
        largest = max(largest, abs(step[i]))
    if largest > _LARGEST:
        for i in range(n):
            step[i] *= _LARGEST / largest
    return largest
