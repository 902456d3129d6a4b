# SPDX-License-Identifier: Apache-2.0
"""Joint positions for a tool pose: Newton from a near posture keeps the branch, a search of many starts finds one.

Six joints of a chain follow the pose; what a chain has beyond six (or, where the orientation is free, beyond three)
is asked for as joint values of its own, so that the equations are always as many as the joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array, Integers
from trueup.compiled import njit
from trueup.errors import ModelError
from trueup.excitation.chain import Chain, ChainArrays, place, rotation_between, slopes, turned
from trueup.excitation.limits import JointLimits
from trueup.identification.poses import apply, copy_row, distance, largest, length, put_all
from trueup.rounding import NEGLIGIBLE, ROUNDED

REACHED, LOST, SINGULAR, OUT_OF_RANGE = 0, 1, 2, 3
"""How a solution ended: found; not found (out of reach); too near a singularity; a joint beyond its range."""
REASONS = ("reached", "out of reach", "too near a singularity", "beyond the range of a joint")
LEAST_GAIN = 0.02
"""The slowest tool motion (m/s, or rad/s) for unit joint speed that is not called singular."""


class Equations(NamedTuple):
    """What is asked of a chain of m joints: the pose (all six rows, or three of position) and some joints' own values."""

    rows: int
    """6 or 3."""
    prescribed: Integers
    """(m - rows,) places in the chain of the joints whose values are asked for."""
    lower: Array
    upper: Array
    """(m,) range of the chain's joints."""


@dataclass(frozen=True, eq=False)
class InverseKinematics:
    """Solves for the joints of a chain near a given posture; the tree's other joints stay where they are."""

    chain: Chain
    equations: Equations

    @classmethod
    def at(
        cls, chain: Chain, limits: JointLimits, posture: ArrayLike, *, free_orientation: bool = False
    ) -> InverseKinematics:
        """For use around `posture` (n,), which decides which joints are asked for by value.

        Raises ModelError where the chain has too few joints to place its tool.
        """
        joint = chain.arrays.joint
        rows = 3 if free_orientation or len(joint) < 6 else 6
        if len(joint) < rows:
            raise ModelError(
                f"the chain to '{chain.link}' has {len(joint)} joints; at least 3 are needed to place a tool"
            )
        J = chain.jacobian(posture)[:rows, joint]
        best = max(combinations(range(len(joint)), rows), key=lambda c: abs(np.linalg.det(J[:, list(c)])))
        own = np.array([k for k in range(len(joint)) if k not in best], dtype=np.int64)
        return cls(chain, Equations(rows, own, limits.lower[joint].copy(), limits.upper[joint].copy()))

    def solve(
        self, rotation: ArrayLike, position: ArrayLike, near: ArrayLike, own: ArrayLike | None = None
    ) -> tuple[Array, int]:
        """Q (n,) that places the tool at a pose, on the branch of `near` (n,), and how that ended (`REASONS`).

        The way from the pose at `near` is cut in short steps, each solved from the one before. `own`: values of the
        joints that are asked for by value (default: as in `near`).
        """
        q = np.array(near, dtype=np.float64)
        wanted = (
            q[self.chain.arrays.joint][self.equations.prescribed] if own is None else np.asarray(own, dtype=np.float64)
        )
        R, p = np.ascontiguousarray(rotation, dtype=np.float64), np.asarray(position, dtype=np.float64)
        return q, int(travel(self.chain.arrays, self.equations, R, p, wanted, LEAST_GAIN, q))

    def gain(self, q: ArrayLike) -> float:
        """The slowest motion of the tool (or of an own joint) for unit joint speed at q (n,); 0 at a singularity."""
        J = self.chain.jacobian(q)[: self.equations.rows, self.chain.arrays.joint]
        own = np.eye(J.shape[1])[self.equations.prescribed]
        return float(np.linalg.svd(np.vstack([J, own]), compute_uv=False)[-1])

    def search(
        self, rotation: ArrayLike | None, position: ArrayLike, rng: np.random.Generator, starts: int = 60
    ) -> list[Array]:
        """Postures (n,) that place the tool at a pose from random starts in the range, best (least singular) first.

        Where `rotation` is None any orientation will do.
        """
        joint, n = self.chain.arrays.joint, self.chain.tree.n
        found: list[tuple[float, Array]] = []
        for _ in range(starts):
            q = np.zeros(n)
            q[joint] = rng.uniform(self.equations.lower, self.equations.upper)
            R = self.chain.poses(q)[0] if rotation is None else np.asarray(rotation, dtype=np.float64)
            q, ended = self.solve(R, position, q)
            alike = any(np.abs(q - other).max() < 0.05 for _, other in found)
            if ended == REACHED and not alike:
                found.append((self.gain(q), q))
        return [q for _, q in sorted(found, key=lambda pair: -pair[0])]


@njit(cache=True, nogil=True)
def invert(A: Array, out: Array) -> float:
    """Out = A^-1 (n, n) by Gauss-Jordan; destroys A. Returns 1 / |A^-1| (Frobenius), at most the least singular value.

    Returns 0 where A is singular.
    """
    n = len(A)
    out[:] = 0.0
    for i in range(n):
        out[i, i] = 1.0
    for c in range(n):
        k = c
        for i in range(c + 1, n):
            if abs(A[i, c]) > abs(A[k, c]):
                k = i
        if abs(A[k, c]) < NEGLIGIBLE:
            return 0.0
        if k != c:
            for j in range(n):
                A[c, j], A[k, j] = A[k, j], A[c, j]
                out[c, j], out[k, j] = out[k, j], out[c, j]
        scale = 1.0 / A[c, c]
        for j in range(n):
            A[c, j] *= scale
            out[c, j] *= scale
        for i in range(n):
            f = A[i, c]
            if i != c and f != 0.0:
                for j in range(n):
                    A[i, j] -= f * A[c, j]
                    out[i, j] -= f * out[c, j]
    total = 0.0
    for i in range(n):
        for j in range(n):
            total += out[i, j] * out[i, j]
    return 1.0 / np.sqrt(total)


@njit(cache=True, nogil=True)
def matrix(chain: ChainArrays, equations: Equations, p: Array, z: Array, o: Array, J: Array, A: Array) -> None:
    """A (m, m): the rows of the pose, then a unit row for each joint asked for by value; J (6, m) is scratch."""
    slopes(chain, p, z, o, J)
    put_all(J[: equations.rows], A)
    A[equations.rows :] = 0.0
    for k in range(len(equations.prescribed)):
        A[equations.rows + k, equations.prescribed[k]] = 1.0


@njit(cache=True, nogil=True)
def settle(chain: ChainArrays, equations: Equations, R: Array, p: Array, own: Array, least: float, q: Array) -> int:
    """Newton's method from q (n,), in place, to a pose R (3, 3), p (3,) nearby. Returns how it ended."""
    m = len(chain.joint)
    R_, p_, z, o, turn = np.empty((3, 3)), np.empty(3), np.empty((m, 3)), np.empty((m, 3)), np.empty(3)
    J, A, inverse, error, step = np.empty((6, m)), np.empty((m, m)), np.empty((m, m)), np.empty(m), np.empty(m)
    for _ in range(12):
        place(chain, q, R_, p_, z, o)
        for a in range(3):
            error[a] = p[a] - p_[a]
        if equations.rows == 6:
            rotation_between(R_, R, turn)
            copy_row(turn, error[3:])
        for k in range(len(own)):
            error[equations.rows + k] = own[k] - q[chain.joint[equations.prescribed[k]]]
        size = largest(error)
        if size < 1e-11:
            return _in_range(chain, equations, q)
        matrix(chain, equations, p_, z, o, J, A)
        if invert(A, inverse) < least:
            return SINGULAR
        apply(inverse, error, step)
        shrink = min(1.0, 0.3 / max(largest(step), ROUNDED))
        for i in range(m):
            q[chain.joint[i]] += shrink * step[i]
        if size < 1e-7 and shrink == 1.0:  # Newton squares the error: the step just taken was the last
            return _in_range(chain, equations, q)
    return LOST


@njit(cache=True, nogil=True)
def travel(chain: ChainArrays, equations: Equations, R: Array, p: Array, own: Array, least: float, q: Array) -> int:
    """As `settle` for a pose further away: straight there in steps of at most 5 cm and 0.1 rad."""
    m = len(chain.joint)
    R0, p0, z, o, turn = np.empty((3, 3)), np.empty(3), np.empty((m, 3)), np.empty((m, 3)), np.empty(3)
    inside, between, here, values = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty(len(own))
    place(chain, q, R0, p0, z, o)
    own0 = np.empty(len(own))
    for k in range(len(own)):
        own0[k] = q[chain.joint[equations.prescribed[k]]]
    rotation_between(R0, R, turn)
    apply(R0.T, turn, inside)  # the vector in the tool's own frame
    far = distance(p, p0) / 0.05
    if equations.rows == 6:
        far = max(far, length(turn) / 0.1)
    for k in range(len(own)):
        far = max(far, abs(own[k] - own0[k]) / 0.2)
    steps = int(np.ceil(far)) + 1
    for step in range(1, steps + 1):
        share = step / steps
        turned(R0, inside, share, between)
        for a in range(3):
            here[a] = p0[a] + share * (p[a] - p0[a])
        for k in range(len(own)):
            values[k] = own0[k] + share * (own[k] - own0[k])
        ended = settle(chain, equations, between, here, values, least, q)
        if ended != REACHED:
            return ended
    return REACHED


@njit(cache=True, nogil=True)
def _in_range(chain: ChainArrays, equations: Equations, q: Array) -> int:
    for i in range(len(chain.joint)):
        value = q[chain.joint[i]]
        if value < equations.lower[i] - ROUNDED or value > equations.upper[i] + ROUNDED:
            return OUT_OF_RANGE
    return REACHED
