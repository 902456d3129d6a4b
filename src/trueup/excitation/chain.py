# SPDX-License-Identifier: Apache-2.0
"""The chain of joints from the base to a tool: pose, Jacobian and its rate, as compiled kernels."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array, Integers, Mask
from trueup.compiled import njit
from trueup.errors import unknown_name
from trueup.identification.poses import about, copy_row, go, joint_pose, multiply, put_all
from trueup.rounding import NEGLIGIBLE

if TYPE_CHECKING:
    from trueup.identification.kinematic_tree import KinematicTree


class ChainArrays(NamedTuple):
    """A chain of m joints as plain arrays, in the form that the kernels take."""

    joint: Integers
    """(m,) which column of q each is."""
    prismatic: Mask
    axis: Array
    rotation: Array
    offset: Array
    tool_rotation: Array
    tool_offset: Array


@dataclass(frozen=True, eq=False)
class Chain:
    """The joints that move one link, and where the tool sits on it."""

    tree: KinematicTree
    link: str
    arrays: ChainArrays = field(repr=False)

    @classmethod
    def of(
        cls, tree: KinematicTree, link: str | None = None, *, tool: ArrayLike = (0.0, 0.0, 0.0),
        tool_rotation: ArrayLike | None = None,
    ) -> Chain:  # fmt: skip
        """The chain to `link` (default: the one that most joints carry and a revolute joint moves: no finger of a hand).

        `tool` (3,) in m and `tool_rotation` (3, 3) are the tool's pose in the link's frame. Raises UnknownNameError.
        """
        if link is None:
            depth = tree.carries().sum(axis=0) - tree.n * np.array(tree.prismatic) * (not np.all(tree.prismatic))
            link = tree.links[int(len(depth) - 1 - np.argmax(depth[::-1]))]
        elif link not in tree.links:
            raise unknown_name("link", link, tree.links)
        path, at = [], tree.links.index(link)
        while at >= 0:
            path.append(at)
            at = int(tree.parent[at])
        joint = np.array(path[::-1], dtype=np.int64)
        turn = np.eye(3) if tool_rotation is None else np.asarray(tool_rotation, dtype=np.float64)
        arrays = ChainArrays(
            joint, np.array(tree.prismatic)[joint], np.array(tree.axis)[joint], np.array(tree.rotation)[joint],
            np.array(tree.offset)[joint], np.ascontiguousarray(turn), np.array(tool, dtype=np.float64),
        )  # fmt: skip
        return cls(tree, link, arrays)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints of the chain."""
        return tuple(self.tree.joints[j] for j in self.arrays.joint)

    def poses(self, q: ArrayLike) -> tuple[Array, Array]:
        """Rotations (..., 3, 3) tool to base and positions (..., 3) of the tool, at q (..., n)."""
        given = np.asarray(q, dtype=np.float64)
        flat = np.require(given.reshape(-1, given.shape[-1]), requirements=["C", "W"])
        R, p = np.empty((len(flat), 3, 3)), np.empty((len(flat), 3))
        _poses(self.arrays, flat, R, p)
        return R.reshape(*given.shape[:-1], 3, 3), p.reshape(*given.shape[:-1], 3)

    def jacobian(self, q: ArrayLike) -> Array:
        """(6, n) tool velocity (m/s, then rad/s, in the base frame) for unit speeds of all joints, at q (n,)."""
        arrays, m = self.arrays, len(self.arrays.joint)
        R, p, z, o = np.empty((3, 3)), np.empty(3), np.empty((m, 3)), np.empty((m, 3))
        place(arrays, np.require(q, np.float64, ["C", "W"]), R, p, z, o)
        J, whole = np.zeros((6, m)), np.zeros((6, self.tree.n))
        slopes(arrays, p, z, o, J)
        whole[:, arrays.joint] = J
        return whole


@njit(cache=True, nogil=True)
def place(chain: ChainArrays, q: Array, R: Array, p: Array, z: Array, o: Array) -> None:
    """Tool pose R (3, 3), p (3,), joint axes z (m, 3) and points on them o (m, 3), in the base frame, at q (n,)."""
    R[:] = 0.0
    p[:] = 0.0
    half = np.empty((3, 3))
    for a in range(3):
        R[a, a] = 1.0
    for i in range(len(chain.joint)):
        value = float(q[chain.joint[i]])
        joint_pose(R, p, chain.rotation[i], chain.offset[i], chain.axis[i], chain.prismatic[i], value, R, p)
        for a in range(3):
            z[i, a] = R[a, 0] * chain.axis[i, 0] + R[a, 1] * chain.axis[i, 1] + R[a, 2] * chain.axis[i, 2]
        copy_row(p, o[i])
    go(R, p, chain.tool_offset)
    put_all(R, half)
    multiply(half, chain.tool_rotation, R)


@njit(cache=True, nogil=True)
def slopes(chain: ChainArrays, p: Array, z: Array, o: Array, J: Array) -> None:
    """J (>= 6, m): linear velocity of the tool at p in rows 0-2, angular velocity in rows 3-5, for unit joint speeds."""
    for i in range(len(chain.joint)):
        if chain.prismatic[i]:
            for a in range(3):
                J[a, i], J[3 + a, i] = z[i, a], 0.0
        else:
            x, y, w = p[0] - o[i, 0], p[1] - o[i, 1], p[2] - o[i, 2]
            J[0, i] = z[i, 1] * w - z[i, 2] * y
            J[1, i] = z[i, 2] * x - z[i, 0] * w
            J[2, i] = z[i, 0] * y - z[i, 1] * x
            for a in range(3):
                J[3 + a, i] = z[i, a]


@njit(cache=True, nogil=True)
def unforced_acceleration(chain: ChainArrays, p: Array, z: Array, o: Array, qd: Array, out: Array) -> None:
    """dJ/dt qd into out (>= 6,): what the tool accelerates at joint speeds qd (m,) without joint acceleration."""
    omega, alpha, a, x, r = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for i in range(len(chain.joint)):
        for k in range(3):
            r[k] = o[i, k] - x[k]
        _carry(omega, alpha, r, a)
        c0 = (omega[1] * z[i, 2] - omega[2] * z[i, 1]) * qd[i]
        c1 = (omega[2] * z[i, 0] - omega[0] * z[i, 2]) * qd[i]
        c2 = (omega[0] * z[i, 1] - omega[1] * z[i, 0]) * qd[i]
        if chain.prismatic[i]:  # Coriolis
            a[0] += 2.0 * c0
            a[1] += 2.0 * c1
            a[2] += 2.0 * c2
        else:
            alpha[0] += c0
            alpha[1] += c1
            alpha[2] += c2
            for k in range(3):
                omega[k] += z[i, k] * qd[i]
        copy_row(o[i], x)
    for k in range(3):
        r[k] = p[k] - x[k]
    _carry(omega, alpha, r, a)
    copy_row(a, out)
    copy_row(alpha, out[3:])


@njit(cache=True, nogil=True)
def _carry(omega: Array, alpha: Array, r: Array, a: Array) -> None:
    """Acceleration a (3,) of a point moved by r on the same body: a += alpha x r + omega x (omega x r)."""
    along = omega[0] * r[0] + omega[1] * r[1] + omega[2] * r[2]
    square = omega[0] * omega[0] + omega[1] * omega[1] + omega[2] * omega[2]
    a[0] += alpha[1] * r[2] - alpha[2] * r[1] + omega[0] * along - r[0] * square
    a[1] += alpha[2] * r[0] - alpha[0] * r[2] + omega[1] * along - r[1] * square
    a[2] += alpha[0] * r[1] - alpha[1] * r[0] + omega[2] * along - r[2] * square


@njit(cache=True, nogil=True)
def turned(R: Array, vector: Array, share: float, out: Array) -> None:
    """Out (3, 3) = R Exp(share vector): `R` turned about a vector of its own frame by `share` of the vector's length."""
    angle = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if angle < 1e-14:
        put_all(R, out)
        return
    turn, axis = np.empty((3, 3)), np.empty(3)
    for a in range(3):
        axis[a] = vector[a] / angle
    about(axis, share * angle, turn)
    multiply(R, turn, out)


@njit(cache=True, nogil=True)
def rotation_between(A: Array, B: Array, out: Array) -> None:
    """Out (3,): the vector in the base frame about which A must turn to become B, of the angle's length (< pi)."""
    x = 0.5 * (_product(B[2], A[1]) - _product(B[1], A[2]))
    y = 0.5 * (_product(B[0], A[2]) - _product(B[2], A[0]))
    z = 0.5 * (_product(B[1], A[0]) - _product(B[0], A[1]))
    sine = np.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (_product(B[0], A[0]) + _product(B[1], A[1]) + _product(B[2], A[2]) - 1.0)
    scale = np.arctan2(sine, cosine) / sine if sine > NEGLIGIBLE else 1.0
    out[0], out[1], out[2] = x * scale, y * scale, z * scale


@njit(cache=True, nogil=True)
def _product(b: Array, a: Array) -> float:
    """Of two rows (3,): an entry of B A^T."""
    return b[0] * a[0] + b[1] * a[1] + b[2] * a[2]


@njit(cache=True, nogil=True)
def _poses(chain: ChainArrays, q: Array, R: Array, p: Array) -> None:
    m = len(chain.joint)
    z, o = np.empty((m, 3)), np.empty((m, 3))
    for s in range(len(q)):
        place(chain, q[s], R[s], p[s], z, o)
