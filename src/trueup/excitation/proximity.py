# SPDX-License-Identifier: Apache-2.0
"""How much many motions at once come too near to something: capsules and boxes for the shapes, compiled.

It guides a search, at two microseconds a posture; whether a motion is clear is decided on the real shapes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trueup.arrays import Array, Integers
from trueup.compiled import njit
from trueup.cores import in_threads
from trueup.excitation.cell import Cell
from trueup.excitation.trajectories import Motions
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.poses import TreeArrays, link_poses, place_links
from trueup.rounding import NEGLIGIBLE

SOFT = 0.02
"""m; coming this much nearer than the margin counts 1."""


class Proxies(NamedTuple):
    """Shapes as capsules and boxes, in the base frame with all joints at 0."""

    joint: Integers
    """(c,) the joint that carries each capsule, -1 for what stands fixed."""
    start: Array
    """(c, 3) m."""
    end: Array
    radius: Array
    """(c,) m."""
    box_centre: Array
    """(k, 3) boxes that stand fixed, as `box_rotation` (k, 3, 3) and `box_half` (k, 3)."""
    box_rotation: Array
    box_half: Array
    pairs: Integers
    """(m, 2) capsules that must not meet."""
    box_pairs: Integers
    """(l, 2) capsules that must not meet boxes."""


@dataclass(frozen=True, eq=False)
class Proximity:
    """The penalty of motions for coming nearer than `margin` m, and of the tool for leaving a region's box."""

    tree: KinematicTree
    shapes: Proxies
    margin: float
    weight: float = 30.0
    cell: Cell | None = None
    inside: float = 0.0
    """m that the tool must stay inside the box."""

    def __call__(self, motions: Motions, threads: int = 1) -> Array:
        """(B,) penalties, 0 for motions that keep their distance at all samples."""
        total = np.zeros(len(motions.q))
        tree, shapes = TreeArrays.of(self.tree), self._in_links()

        def some(rows: slice) -> None:
            _nearness(tree, motions.q[rows], shapes, self.margin, total[rows])

        in_threads(some, len(total), threads)
        if self.cell is not None:
            box = self.cell.region
            away = np.abs(self.cell.chain.poses(motions.q)[1] - box.centre) - 0.5 * box.size + self.inside
            total += (np.maximum(away / SOFT, 0.0) ** 2).sum(axis=(1, 2))
        return self.weight * total / motions.q.shape[1]

    def _in_links(self) -> Proxies:
        """The capsules in the frames of the links that carry them."""
        R, p = link_poses(self.tree, np.zeros((1, self.tree.n)))
        start, end = self.shapes.start.copy(), self.shapes.end.copy()
        for c, j in enumerate(self.shapes.joint):
            if j >= 0:
                start[c], end[c] = R[0, j].T @ (start[c] - p[0, j]), R[0, j].T @ (end[c] - p[0, j])
        return self.shapes._replace(start=start, end=end)


@njit(cache=True, nogil=True)
def _nearness(tree: TreeArrays, q: Array, shapes: Proxies, margin: float, total: Array) -> None:
    n, count = len(tree.parent), len(shapes.joint)
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    A, B = shapes.start.copy(), shapes.end.copy()
    for b in range(len(q)):
        for s in range(q.shape[1]):
            place_links(tree, q[b, s], R, p)
            for c in range(count):
                j = shapes.joint[c]
                if j >= 0:
                    for a in range(3):
                        A[c, a], B[c, a] = p[j, a], p[j, a]
                        for k in range(3):
                            A[c, a] += R[j, a, k] * shapes.start[c, k]
                            B[c, a] += R[j, a, k] * shapes.end[c, k]
            for k in range(len(shapes.pairs)):
                i, j = shapes.pairs[k, 0], shapes.pairs[k, 1]
                short = margin + shapes.radius[i] + shapes.radius[j] - _between(A[i], B[i], A[j], B[j])
                if short > 0.0:
                    total[b] += (short / SOFT) ** 2
            for k in range(len(shapes.box_pairs)):
                i, j = shapes.box_pairs[k, 0], shapes.box_pairs[k, 1]
                far = _to_box(A[i], B[i], shapes.box_centre[j], shapes.box_rotation[j], shapes.box_half[j])
                short = margin + shapes.radius[i] - far
                if short > 0.0:
                    total[b] += (short / SOFT) ** 2


@njit(cache=True, nogil=True)
def _between(a: Array, b: Array, c: Array, d: Array) -> float:
    """Distance of the segments ab and cd (C. Ericson, Real-Time Collision Detection, 2005, section 5.1.9)."""
    u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    v0, v1, v2 = d[0] - c[0], d[1] - c[1], d[2] - c[2]
    w0, w1, w2 = a[0] - c[0], a[1] - c[1], a[2] - c[2]
    uu, vv = u0 * u0 + u1 * u1 + u2 * u2 + NEGLIGIBLE, v0 * v0 + v1 * v1 + v2 * v2 + NEGLIGIBLE
    uv, uw, vw = u0 * v0 + u1 * v1 + u2 * v2, u0 * w0 + u1 * w1 + u2 * w2, v0 * w0 + v1 * w1 + v2 * w2
    apart = uu * vv - uv * uv
    s = min(1.0, max(0.0, (uv * vw - uw * vv) / apart)) if apart > NEGLIGIBLE * uu * vv else 0.0
    t = (uv * s + vw) / vv
    if t < 0.0:
        t, s = 0.0, min(1.0, max(0.0, -uw / uu))
    elif t > 1.0:
        t, s = 1.0, min(1.0, max(0.0, (uv - uw) / uu))
    x, y, z = w0 + s * u0 - t * v0, w1 + s * u1 - t * v1, w2 + s * u2 - t * v2
    return np.sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True)
def _to_box(a: Array, b: Array, centre: Array, rotation: Array, half: Array) -> float:
    """Least signed distance of points along the segment ab from a box, negative inside."""
    best = np.inf
    for k in range(5):
        outside, inside = 0.0, -np.inf
        for i in range(3):
            x = 0.0
            for m in range(3):
                x += rotation[m, i] * (a[m] + k * (b[m] - a[m]) / 4 - centre[m])
            over = abs(x) - half[i]
            inside = max(inside, over)
            if over > 0.0:
                outside += over * over
        best = min(best, np.sqrt(outside) if outside > 0.0 else inside)
    return best
