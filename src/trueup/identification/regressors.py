# SPDX-License-Identifier: Apache-2.0
"""Joint torque as a linear function of the links' inertial parameters: regressor, inverse dynamics, link poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueup.errors import ModelError
from trueup.identification.kinematic_tree import KinematicTree, about

Array = NDArray[np.float64]


def inverse_dynamics(tree: KinematicTree, inertial: Array, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
    """(S, n) torque (N m, or N) of rigid links `inertial` (n, 10) at samples q, qd, qdd (S, n); rotors not included."""
    return regressor(tree, q, qd, qdd) @ np.asarray(inertial, dtype=float).ravel()


def link_poses(tree: KinematicTree, q: ArrayLike) -> tuple[Array, Array]:
    """Rotations (S, n, 3, 3) link to base, and positions (S, n, 3) of the link frames in the base frame, at q (S, n)."""
    (q_,) = _samples(tree, q)
    R, p = _joint_poses(tree, q_)
    for j, k in enumerate(tree.parent):
        if k >= 0:
            p[:, j] = p[:, k] + np.einsum("sij,sj->si", R[:, k], p[:, j])
            R[:, j] = R[:, k] @ R[:, j]
    return R, p


def regressor(tree: KinematicTree, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
    """(S, n, 10 n) matrices Y with torque = Y @ inertial.ravel(), at samples q, qd, qdd (S, n).

    Row i depends only on the links that joint i carries: with u, w the angular and linear velocity of link j for a unit
    speed of joint i, the power of the link's Newton-Euler wrench is linear in its ten parameters. Atkeson, An &
    Hollerbach, "Estimation of inertial parameters of manipulator loads and links", IJRR 5(3), 1986. The memory runs
    along the samples, so that filtering and decimating are quick.
    """
    q_, qd_, qdd_ = _samples(tree, q, qd, qdd)
    S, n = q_.shape
    R, p = _joint_poses(tree, q_)
    Y = np.zeros((n, n, 10, S))
    u, w = np.zeros((S, n, n, 3)), np.zeros((S, n, n, 3))
    omega, alpha, a = np.zeros((S, n, 3)), np.zeros((S, n, 3)), np.zeros((S, n, 3))
    for j, k in enumerate(tree.parent):
        back = np.swapaxes(R[:, j], -1, -2)
        axis, r = tree.axis[j], p[:, j]
        if k >= 0:
            o, al = omega[:, k], alpha[:, k]
            omega[:, j] = _turn(back, o)
            alpha[:, j] = _turn(back, al)
            a[:, j] = _turn(back, a[:, k] + np.cross(al, r) + np.cross(o, np.cross(o, r)))
            u[:, :, j] = np.einsum("sij,snj->sni", back, u[:, :, k])
            w[:, :, j] = np.einsum("sij,snj->sni", back, w[:, :, k] + np.cross(u[:, :, k], r[:, None]))
        else:
            a[:, j] = _turn(back, np.broadcast_to(-tree.gravity, (S, 3)))
        speed = axis * qd_[:, j, None]
        if tree.prismatic[j]:
            a[:, j] += axis * qdd_[:, j, None] + 2.0 * np.cross(omega[:, j], speed)
            w[:, j, j] = axis
        else:
            alpha[:, j] += axis * qdd_[:, j, None] + np.cross(omega[:, j], speed)
            omega[:, j] += speed
            u[:, j, j] = axis
        for i in range(j + 1):
            if np.any(u[:, i, j]) or np.any(w[:, i, j]):
                Y[i, j] = _power(u[:, i, j], w[:, i, j], omega[:, j], alpha[:, j], a[:, j])
    return np.moveaxis(Y.reshape(n, 10 * n, S), -1, 0)


def _power(u: Array, w: Array, omega: Array, alpha: Array, a: Array) -> Array:
    """(10, S) coefficients of a link's parameters in the power of its wrench for velocities u, w."""
    dot = lambda x, y: np.einsum("si,si->s", x, y)  # noqa: E731
    first = np.cross(w, alpha) + dot(w, omega)[:, None] * omega - dot(omega, omega)[:, None] * w + np.cross(a, u)
    P = np.einsum("si,sj->sij", u, alpha) + np.einsum("si,sj->sij", np.cross(u, omega), omega)
    P += np.swapaxes(P, -1, -2)
    second = [P[:, 0, 0] / 2, P[:, 0, 1], P[:, 1, 1] / 2, P[:, 0, 2], P[:, 1, 2], P[:, 2, 2] / 2]
    return np.stack([dot(w, a), *first.T, *second])


def _turn(R: Array, v: Array) -> Array:
    return np.einsum("sij,sj->si", R, v)


def _joint_poses(tree: KinematicTree, q: Array) -> tuple[Array, Array]:
    """Rotations (S, n, 3, 3) and offsets (S, n, 3) of each link in its parent's frame."""
    R, p = np.empty((*q.shape, 3, 3)), np.empty((*q.shape, 3))
    for j in range(tree.n):
        R[:, j], p[:, j] = tree.rotation[j], tree.offset[j]
        if tree.prismatic[j]:
            p[:, j] += q[:, j, None] * (tree.rotation[j] @ tree.axis[j])
        else:
            R[:, j] = tree.rotation[j] @ about(tree.axis[j], q[:, j])
    return R, p


def _samples(tree: KinematicTree, *given: ArrayLike) -> list[Array]:
    """Each (S, n) in double precision. Raises ModelError where shapes do not fit the tree."""
    arrays = [np.atleast_2d(np.asarray(values, dtype=float)) for values in given]
    for values in arrays:
        if values.shape != (len(arrays[0]), tree.n):
            raise ModelError(
                f"positions, velocities and accelerations of '{tree.name}' must be (samples, {tree.n}) for joints "
                f"{', '.join(tree.joints)}; got {', '.join(str(v.shape) for v in arrays)}"
            )
    return arrays
