# SPDX-License-Identifier: Apache-2.0
"""Compiled loops over blocks of samples: regressor rows, torques and Gram matrices of a whole model."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.compiled import njit
from trueup.identification.effects import of_state
from trueup.identification.kernels import ROWS, TILE, W, carried, motion, pose, power, sines
from trueup.identification.kinematic_tree import KinematicTree

LONG = 256  # samples for which regressor rows are gathered before they are multiplied: they stay in the second cache
_FUSED = {"contract"}


class Layout(NamedTuple):
    """A tree as the kernels want it; n joints, m further columns (rotors, friction, couplings)."""

    parent: Integers
    turns: Array
    """(n,) 1 for a revolute joint, 0 for a prismatic one."""
    axis: Array
    fixed: Array
    """(n, 3, 9) rotation link to parent = fixed[0] + sin(q) fixed[1] + cos(q) fixed[2], row by row."""
    slide: Array
    """(n, 2, 3) offset in the parent = slide[0] + q slide[1]."""
    gravity: Array
    carries: Mask
    kind: Integers
    """(m,) what a further column is a function of: the number of its effect among all kinds, by which `effects.of_state`
    knows it.
    """
    drive: Integers
    scale: Array
    drives: Array
    """(n, n) speeds of the drives for speeds of the joints."""
    single: Mask
    """(n,) drives that turn with their own joint alone, one to one."""
    rest: float


def layout(
    tree: KinematicTree, further: tuple[tuple[int, int, float], ...] = (), drives: Array | None = None, rest: float = 0.0
) -> Layout:  # fmt: skip
    """The arrays of a tree; `further` are rows of kind, drive, scale."""
    turns = (~tree.prismatic).astype(float)
    x, y, z = tree.axis.T
    zero = np.zeros_like(x)
    K = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), -1, 0)
    fixed = np.stack([tree.rotation @ (np.eye(3) + K @ K), tree.rotation @ K, -tree.rotation @ K @ K], axis=1)
    fixed[tree.prismatic] = np.stack([tree.rotation, 0 * tree.rotation, 0 * tree.rotation], axis=1)[tree.prismatic]
    along = np.einsum("nij,nj->ni", tree.rotation, tree.axis) * (1.0 - turns)[:, None]
    rows = np.array(further, dtype=float).reshape(-1, 3)
    kind, drive = (np.ascontiguousarray(rows[:, k]).astype(np.int64) for k in range(2))
    turning = np.eye(tree.n) if drives is None else np.array(drives, dtype=float)
    return Layout(
        np.array(tree.parent), turns, np.array(tree.axis), np.ascontiguousarray(fixed.reshape(-1, 3, 9)),
        np.ascontiguousarray(np.stack([tree.offset, along], axis=1)), np.array(tree.gravity), tree.carries(),
        kind, drive, np.ascontiguousarray(rows[:, 2]), turning, (turning == np.eye(tree.n)).all(axis=1), float(rest),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def workspace(n: int) -> Array:
    """Room for the base's and n links' rows, then 27 rows of scratch."""
    return np.zeros(((n + 1) * (ROWS + 6 * n) + 27) * W)


@njit(cache=True, nogil=True, fastmath=_FUSED)
def kinematics(tree: Layout, q: Array, qd: Array, qdd: Array, first: int, count: int, work: Array) -> None:
    """Fills the rows of all links for samples first ... first + count - 1; a short block repeats its last sample."""
    n = len(tree.parent)
    size = (ROWS + 6 * n) * W
    rest = work[(n + 1) * size :]
    T, x, v, acc, sine, cosine = rest[: 12 * W], rest[12 * W : 13 * W], rest[13 * W : 14 * W], rest[14 * W : 15 * W], rest[15 * W : 16 * W], rest[16 * W : 17 * W]  # fmt: skip  # noqa: E501
    for c in range(3):
        work[(6 + c) * W : (7 + c) * W] = -tree.gravity[c]
    for j in range(n):
        for s in range(W):
            t = first + min(s, count - 1)
            x[s], v[s], acc[s] = q[t, j], qd[t, j], qdd[t, j]
        sines(x, sine, cosine)
        pose(tree.fixed[j], tree.slide[j], x, sine, cosine, T)
        up = work[(tree.parent[j] + 1) * size : (tree.parent[j] + 2) * size]
        own = work[(j + 1) * size : (j + 2) * size]
        motion(T, up, v, acc, tree.axis[j], tree.turns[j], own)
        for i in range(j):
            if tree.carries[i, j]:
                at = (ROWS + 6 * i) * W
                carried(T, up[at : at + 6 * W], own[at : at + 6 * W])
        for c in range(3):
            at = (ROWS + 6 * j + c) * W
            own[at : at + W] = tree.turns[j] * tree.axis[j, c]
            own[at + 3 * W : at + 4 * W] = (1.0 - tree.turns[j]) * tree.axis[j, c]


@njit(cache=True, nogil=True, fastmath=_FUSED)
def inertial_rows(tree: Layout, work: Array, count: int, place: Integers, out: Array, stride: int, at: int) -> None:
    """Writes each wanted regressor entry (joint i, column k) of a block to row place[i, k] of `out`, from `at` on."""
    n = len(tree.parent)
    size = (ROWS + 6 * n) * W
    y = work[(n + 1) * size + 17 * W :]
    for j in range(n):
        own = work[(j + 1) * size : (j + 2) * size]
        for i in range(j + 1):
            last = -1  # no row of this joint and link is wanted
            for c in range(10):
                last = max(last, place[i, 10 * j + c])
            if last < 0 or not tree.carries[i, j]:
                continue
            power(own[: ROWS * W], own[(ROWS + 6 * i) * W : (ROWS + 6 * i + 6) * W], y)
            for c in range(10):
                row = place[i, 10 * j + c]
                if row >= 0:
                    to = out[row * stride + at : row * stride + at + count]
                    of = y[c * W : (c + 1) * W]
                    for s in range(count):
                        to[s] = of[s]


@njit(cache=True, nogil=True, fastmath=_FUSED)
def further_rows(
    tree: Layout,
    q: Array,
    qd: Array,
    qdd: Array,
    first: int,
    count: int,
    place: Integers,
    out: Array,
    stride: int,
    at: int,
) -> None:
    """As `inertial_rows` for what drives add; the papers' four effects as loops without a branch."""
    n = len(tree.parent)
    for k in range(len(tree.kind)):
        d, kind = tree.drive[k], tree.kind[k]
        row = place[d, 10 * n + k]
        if not tree.single[d]:
            coupled_rows(tree, q, qd, qdd, first, count, place, out, stride, at, k)
        elif row >= 0:
            to = out[row * stride + at : row * stride + at + count]
            if kind == 0:  # rotor
                for s in range(count):
                    to[s] = qdd[first + s, d]
            elif kind == 2:  # viscous
                for s in range(count):
                    to[s] = qd[first + s, d]
            elif kind == 1 and tree.rest == 0.0:  # Coulomb
                for s in range(count):
                    to[s] = np.sign(qd[first + s, d])
            elif kind == 3 and tree.rest == 0.0:  # quadratic
                for s in range(count):
                    to[s] = qd[first + s, d] * abs(qd[first + s, d])
            else:
                for s in range(count):
                    t = first + s
                    to[s] = of_state(kind, q[t, d], qd[t, d], qdd[t, d], tree.scale[k], tree.rest)


@njit(cache=True, nogil=True, fastmath=_FUSED)
def coupled_rows(
    tree: Layout, q: Array, qd: Array, qdd: Array, first: int, count: int, place: Integers, out: Array, stride: int, at: int,
    k: int,
) -> None:  # fmt: skip
    """The rows of further column k, whose drive turns with several joints."""
    n, turns = len(tree.parent), tree.drives[tree.drive[k]]
    for s in range(count):
        x, v, a = 0.0, 0.0, 0.0
        for i in range(n):
            x += turns[i] * q[first + s, i]
            v += turns[i] * qd[first + s, i]
            a += turns[i] * qdd[first + s, i]
        torque = of_state(tree.kind[k], x, v, a, tree.scale[k], tree.rest)
        for j in range(n):
            row = place[j, 10 * n + k]
            if row >= 0 and turns[j] != 0.0:
                out[row * stride + at + s] = turns[j] * torque


@njit(cache=True, nogil=True)
def regressor_rows(tree: Layout, q: Array, qd: Array, qdd: Array, place: Integers, out: Array) -> None:
    """All samples (S, n) into `out` (rows S,), row place[i, k] for joint i and column k; rows not placed stay as they are."""
    S = len(q)
    work = workspace(len(tree.parent))
    for first in range(0, S, W):
        count = min(W, S - first)
        kinematics(tree, q, qd, qdd, first, count, work)
        inertial_rows(tree, work, count, place, out, S, first)
        further_rows(tree, q, qd, qdd, first, count, place, out, S, first)


@njit(cache=True, nogil=True, fastmath=_FUSED)
def torques(tree: Layout, inertial: Array, q: Array, qd: Array, qdd: Array, out: Array) -> None:
    """Torque out (S, n) of rigid links `inertial` (n, 10), from the same rows as the regressor."""
    S, n = q.shape
    work = workspace(n)
    size = (ROWS + 6 * n) * W
    y = work[(n + 1) * size + 17 * W :]
    for first in range(0, S, W):
        count = min(W, S - first)
        kinematics(tree, q, qd, qdd, first, count, work)
        for j in range(n):
            own = work[(j + 1) * size : (j + 2) * size]
            for i in range(j + 1):
                if tree.carries[i, j]:
                    power(own[: ROWS * W], own[(ROWS + 6 * i) * W : (ROWS + 6 * i + 6) * W], y)
                    for s in range(count):
                        for c in range(10):
                            out[first + s, i] += y[c * W + s] * inertial[j, c]


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"})
def tile(Z: Array, r: int, c: int, G: Array, width: int) -> None:
    """Adds the products of rows r ... r + 3 with rows c ... c + 3 of Z (rows of LONG) to G (width, width)."""
    a, b = Z[r * LONG : (r + TILE) * LONG], Z[c * LONG : (c + TILE) * LONG]
    g00 = g01 = g02 = g03 = g10 = g11 = g12 = g13 = 0.0
    g20 = g21 = g22 = g23 = g30 = g31 = g32 = g33 = 0.0
    for s in range(LONG):
        a0, a1, a2, a3 = a[s], a[LONG + s], a[2 * LONG + s], a[3 * LONG + s]
        b0, b1, b2, b3 = b[s], b[LONG + s], b[2 * LONG + s], b[3 * LONG + s]
        g00, g01, g02, g03 = g00 + a0 * b0, g01 + a0 * b1, g02 + a0 * b2, g03 + a0 * b3
        g10, g11, g12, g13 = g10 + a1 * b0, g11 + a1 * b1, g12 + a1 * b2, g13 + a1 * b3
        g20, g21, g22, g23 = g20 + a2 * b0, g21 + a2 * b1, g22 + a2 * b2, g23 + a2 * b3
        g30, g31, g32, g33 = g30 + a3 * b0, g31 + a3 * b1, g32 + a3 * b2, g33 + a3 * b3
    sums = ((g00, g01, g02, g03), (g10, g11, g12, g13), (g20, g21, g22, g23), (g30, g31, g32, g33))
    for k in range(TILE):
        for m in range(TILE):
            G[(r + k) * width + c + m] += sums[k][m]


@njit(cache=True, nogil=True)
def gram(
    tree: Layout, q: Array, qd: Array, qdd: Array, place: Integers, start: Integers, width: Integers, Z: Array, G: Array
) -> None:
    """Upper tiles of the Gram matrix of each joint's regressor columns, added to G.

    Joint i has width[i] packed columns (a multiple of TILE), from row start[i] of Z; its matrix follows that of
    joint i - 1 in G. No more of the regressor exists at a time than LONG samples.
    """
    S, n = q.shape
    stride: Any = np.int64(LONG)  # a literal would have the rows compiled once more
    work = workspace(n)
    for begin in range(0, S, LONG):
        end = min(begin + LONG, S)
        if end - begin < LONG:
            Z[:] = 0.0
        for first in range(begin, end, W):
            count = min(W, end - first)
            kinematics(tree, q, qd, qdd, first, count, work)
            inertial_rows(tree, work, count, place, Z, stride, first - begin)
            further_rows(tree, q, qd, qdd, first, count, place, Z, stride, first - begin)
        at = 0
        for i in range(n):
            mine = Z[start[i] * LONG :]
            for r in range(0, width[i], TILE):
                for c in range(r, width[i], TILE):
                    tile(mine, r, c, G[at:], width[i])
            at += width[i] * width[i]
