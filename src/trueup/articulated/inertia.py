# SPDX-License-Identifier: Apache-2.0
"""Inertias that stay physical: log-Cholesky coordinates of the pseudo-inertia matrix.

After C. Rucker and P. Wensing, "Smooth parameterization of rigid-body inertia", IEEE RA-L 7(2), 2022.
J = U U^T with U upper triangular; every real vector of ten numbers is a body that can exist.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array
from trueup.rounding import NEGLIGIBLE

COMPONENTS = ("alpha", "d1", "d2", "d3", "s12", "s23", "s13", "t1", "t2", "t3")
"""alpha = ln(mass) / 2; t = centre of mass [m]; d and s shape the spread of mass about it."""


def pseudo_inertia(mass: Array, com: Array, inertia: Array) -> Array:
    """(..., 4, 4) from mass (...), CoM (..., 3) [m] and rotational inertia about the CoM (..., 3, 3) [kg m2]."""
    trace = np.trace(inertia, axis1=-2, axis2=-1)[..., None, None]
    spread = 0.5 * trace * np.eye(3) - inertia
    moment = mass[..., None] * com
    pseudo = np.zeros((*np.shape(mass), 4, 4))
    pseudo[..., :3, :3] = spread + moment[..., :, None] * com[..., None, :]
    pseudo[..., :3, 3] = pseudo[..., 3, :3] = moment
    pseudo[..., 3, 3] = mass
    return pseudo


def log_cholesky(mass: ArrayLike, com: Array, inertia: Array) -> Array:
    """(..., 10) coordinates in the order of COMPONENTS, from mass (...), CoM (..., 3) and inertia about it (..., 3, 3)."""
    masses = np.asarray(mass, dtype=np.float64)
    spread = 0.5 * np.trace(inertia, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - inertia
    # A rod or plate has no spread across: a millionth of the largest keeps the logarithms finite.
    least = np.maximum(1e-6 * np.trace(spread, axis1=-2, axis2=-1), NEGLIGIBLE)[..., None, None]
    reverse = (spread + least * np.eye(3))[..., ::-1, ::-1]
    upper = np.linalg.cholesky(reverse)[..., ::-1, ::-1] / np.sqrt(masses)[..., None, None]
    d = np.log(np.diagonal(upper, axis1=-2, axis2=-1))
    scaled = np.stack([upper[..., 0, 1], upper[..., 1, 2], upper[..., 0, 2]], axis=-1)
    return np.concatenate([0.5 * np.log(masses)[..., None], d, scaled, com], axis=-1)


def from_log_cholesky(theta: Array) -> tuple[Array, Array, Array]:
    """Mass (...), CoM (..., 3) [m] and inertia about the CoM (..., 3, 3) [kg m2] of coordinates (..., 10)."""
    mass = np.exp(2.0 * theta[..., 0])
    upper = np.zeros((*theta.shape[:-1], 3, 3))
    for i in range(3):
        upper[..., i, i] = np.exp(theta[..., 1 + i])
    upper[..., 0, 1], upper[..., 1, 2], upper[..., 0, 2] = theta[..., 4], theta[..., 5], theta[..., 6]
    spread = mass[..., None, None] * (upper @ np.swapaxes(upper, -1, -2))
    trace = np.trace(spread, axis1=-2, axis2=-1)[..., None, None]
    return mass, theta[..., 7:10], trace * np.eye(3) - spread


def principal(inertia: Array) -> tuple[Array, Array]:
    """Principal moments (..., 3), largest first, and the rotation to them as quaternions w-x-y-z (..., 4)."""
    moments, axes = np.linalg.eigh(inertia)
    moments, axes = moments[..., ::-1], axes[..., ::-1]
    axes = axes * np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[..., None, None]
    return moments, _quaternion(axes)


def from_principal(moments: Array, quaternions: Array) -> Array:
    """(..., 3, 3) inertia of principal moments (..., 3) and the rotation to them, quaternions w-x-y-z (..., 4)."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    axes = np.moveaxis(turn, (0, 1), (-2, -1))
    return (axes * moments[..., None, :]) @ np.swapaxes(axes, -1, -2)


def _quaternion(rotation: Array) -> Array:
    """(..., 4) w-x-y-z of rotation matrices (..., 3, 3).

    Four q q^T is linear in the matrix; of its rows the one with the largest diagonal divides by nothing small (Shepperd,
    "Quaternion from rotation matrix", J. Guidance and Control 1(3), 1978).
    """
    m = np.moveaxis(rotation, (-2, -1), (0, 1))
    outer = np.array([
        [1 + m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
        [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1 - m[0, 0] + m[1, 1] - m[2, 2], m[1, 2] + m[2, 1]],
        [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1 - m[0, 0] - m[1, 1] + m[2, 2]],
    ])  # fmt: skip
    rows = np.moveaxis(outer, (0, 1), (-2, -1))
    largest = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(rows, largest[..., None, None], axis=-2)[..., 0, :]
    return row / np.linalg.norm(row, axis=-1, keepdims=True)
