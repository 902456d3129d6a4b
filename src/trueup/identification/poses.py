# SPDX-License-Identifier: Apache-2.0
"""Where the links of a tree are: forward kinematics, compiled once for all that need it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array, Integers, Mask
from trueup.compiled import njit
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.regressors import samples


class TreeArrays(NamedTuple):
    """A tree of n joints as plain arrays, in the form that the kernels take; as in KinematicTree."""

    parent: Integers
    prismatic: Mask
    axis: Array
    rotation: Array
    offset: Array

    @classmethod
    def of(cls, tree: KinematicTree) -> TreeArrays:
        """Those of a tree, as copies: kernels are compiled anew for arrays that may not be written."""
        return cls(
            tree.parent.copy(), tree.prismatic.copy(), tree.axis.copy(), tree.rotation.copy(), tree.offset.copy()
        )


def link_poses(tree: KinematicTree, q: ArrayLike) -> tuple[Array, Array]:
    """Rotations (S, n, 3, 3) link to base, and positions (S, n, 3) of the link frames in the base frame, at q (S, n)."""
    (given,) = samples(tree, q)
    R, p = np.empty((*given.shape, 3, 3)), np.empty((*given.shape, 3))
    _place_all(TreeArrays.of(tree), given, R, p)
    return R, p


@njit(cache=True, nogil=True)
def _place_all(tree: TreeArrays, q: Array, R: Array, p: Array) -> None:
    for s in range(len(q)):
        place_links(tree, q[s], R[s], p[s])


@njit(cache=True, nogil=True)
def place_links(tree: TreeArrays, q: Array, R: Array, p: Array) -> None:
    """Poses R (n, 3, 3), p (n, 3) of all links in the base frame, at q (n,)."""
    base, origin = np.eye(3), np.zeros(3)
    for j in range(len(tree.parent)):
        k = tree.parent[j]
        up, at = (R[k], p[k]) if k >= 0 else (base, origin)
        joint_pose(up, at, tree.rotation[j], tree.offset[j], tree.axis[j], tree.prismatic[j], q[j], R[j], p[j])


@njit(cache=True, nogil=True)
def joint_pose(
    up: Array, at: Array, rotation: Array, offset: Array, axis: Array, slides: bool, q: float, R: Array, p: Array
) -> None:
    """Pose R (3, 3), p (3,) of a link whose parent stands at `up`, `at`, with its joint at q; may be written over those."""
    sine, cosine = (0.0, 1.0) if slides else (np.sin(q), np.cos(q))
    x, y, z = axis
    d, way = 1.0 - cosine, q if slides else 0.0
    # Row by row, which needs no scratch: row a of a product asks for row a of its first factor alone.
    for a in range(3):
        u0, u1, u2 = up[a]
        p[a] = at[a] + u0 * offset[0] + u1 * offset[1] + u2 * offset[2]
        h0 = u0 * rotation[0, 0] + u1 * rotation[1, 0] + u2 * rotation[2, 0]
        h1 = u0 * rotation[0, 1] + u1 * rotation[1, 1] + u2 * rotation[2, 1]
        h2 = u0 * rotation[0, 2] + u1 * rotation[1, 2] + u2 * rotation[2, 2]
        p[a] += way * (h0 * x + h1 * y + h2 * z)
        along = d * (h0 * x + h1 * y + h2 * z)
        R[a, 0] = cosine * h0 + along * x + sine * (h1 * z - h2 * y)
        R[a, 1] = cosine * h1 + along * y + sine * (h2 * x - h0 * z)
        R[a, 2] = cosine * h2 + along * z + sine * (h0 * y - h1 * x)


@njit(cache=True, nogil=True)
def copy_row(of: Array, to: Array) -> None:
    """Copies a row (n,) to the first n entries of another: so written it compiles in a quarter of the time of a slice."""
    for i in range(len(of)):
        to[i] = of[i]


@njit(cache=True, nogil=True)
def put_all(of: Array, to: Array) -> None:
    """Copies a matrix (n, m) to another."""
    for i in range(len(of)):
        for j in range(of.shape[1]):
            to[i, j] = of[i, j]


@njit(cache=True, nogil=True)
def apply(A: Array, vector: Array, out: Array) -> None:
    """Out (n,) = A vector, of A (n, m) and a vector (m,); `out` must not be that vector."""
    for a in range(len(out)):
        out[a] = 0.0
        for b in range(len(vector)):
            out[a] += A[a, b] * vector[b]


@njit(cache=True, nogil=True)
def length(vector: Array) -> float:
    """The length of a vector (n,)."""
    square = 0.0
    for x in vector:
        square += x * x
    return np.sqrt(square)


@njit(cache=True, nogil=True)
def distance(p: Array, other: Array) -> float:
    """The distance between two points (n,)."""
    square = 0.0
    for i in range(len(p)):
        square += (p[i] - other[i]) ** 2
    return np.sqrt(square)


@njit(cache=True, nogil=True)
def largest(vector: Array) -> float:
    """The largest absolute value in a vector (n,); NaN where one is, 0 where it is empty."""
    most = 0.0
    for x in vector:
        if np.isnan(x):
            return x
        most = max(most, abs(x))
    return most


@njit(cache=True, nogil=True)
def go(R: Array, p: Array, offset: Array) -> None:
    """Moves p (3,) by `offset` (3,), given in the frame R."""
    for a in range(3):
        p[a] += R[a, 0] * offset[0] + R[a, 1] * offset[1] + R[a, 2] * offset[2]


@njit(cache=True, nogil=True)
def multiply(A: Array, B: Array, out: Array) -> None:
    """Out = A B, all (3, 3); `out` must be neither of them."""
    for a in range(3):
        for b in range(3):
            out[a, b] = A[a, 0] * B[0, b] + A[a, 1] * B[1, b] + A[a, 2] * B[2, b]


@njit(cache=True, nogil=True)
def about(axis: Array, angle: float, out: Array) -> None:
    """The rotation (3, 3) about a unit axis (3,) by an angle [rad] into out."""
    s, c = np.sin(angle), np.cos(angle)
    x, y, z, d = axis[0], axis[1], axis[2], 1.0 - c
    out[0, 0], out[0, 1], out[0, 2] = c + x * x * d, x * y * d - z * s, x * z * d + y * s
    out[1, 0], out[1, 1], out[1, 2] = y * x * d + z * s, c + y * y * d, y * z * d - x * s
    out[2, 0], out[2, 1], out[2, 2] = z * x * d - y * s, z * y * d + x * s, c + z * z * d
