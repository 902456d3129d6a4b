# SPDX-License-Identifier: Apache-2.0
"""Inertias that stay physical: log-Cholesky coordinates of the pseudo-inertia matrix.

After C. Rucker and P. Wensing, "Smooth parameterization of rigid-body inertia", IEEE RA-L 7(2), 2022.
J = U U^T with U upper triangular; every real vector of ten numbers is a body that can exist.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array
from trueup.rounding import NEGLIGIBLE

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

COMPONENTS = ("alpha", "d1", "d2", "d3", "s12", "s23", "s13", "t1", "t2", "t3")
"""alpha = ln(mass) / 2; t = centre of mass [m]; d and s shape the spread of mass about it."""


def log_cholesky(mass: ArrayLike, com: Array, inertia: Array) -> Array:
    """(..., 10) coordinates in the order of COMPONENTS, from mass (...), CoM (..., 3) and inertia about it (..., 3, 3)."""
    masses = np.asarray(mass, dtype=np.float64)
    spread = second_moments(inertia)
    # A rod or plate has no spread across: a millionth of the largest keeps the logarithms finite.
    least = np.maximum(1e-6 * np.trace(spread, axis1=-2, axis2=-1), NEGLIGIBLE)[..., None, None]
    reverse = (spread + least * np.eye(3))[..., ::-1, ::-1]
    upper = np.linalg.cholesky(reverse)[..., ::-1, ::-1] / np.sqrt(masses)[..., None, None]
    d = np.log(np.diagonal(upper, axis1=-2, axis2=-1))
    scaled = np.stack([upper[..., 0, 1], upper[..., 1, 2], upper[..., 0, 2]], axis=-1)
    return np.concatenate([0.5 * np.log(masses)[..., None], d, scaled, com], axis=-1)


def second_moments(inertia: Array) -> Array:
    """(..., 3, 3) sums of mass times distance from the CoM along one axis and along another [kg m2], of inertia about it."""
    return 0.5 * np.trace(inertia, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - inertia


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
    turns = _rotations().from_matrix(axes.reshape(-1, 3, 3)).as_quat(scalar_first=True)
    return moments, turns.reshape(*axes.shape[:-2], 4)


def from_principal(moments: Array, quaternions: Array) -> Array:
    """(..., 3, 3) inertia of principal moments (..., 3) and the rotation to them, quaternions w-x-y-z (..., 4)."""
    turns = _rotations().from_quat(quaternions.reshape(-1, 4), scalar_first=True).as_matrix()
    axes = turns.reshape(*quaternions.shape[:-1], 3, 3)
    return (axes * moments[..., None, :]) @ np.swapaxes(axes, -1, -2)


def _rotations() -> type[Rotation]:
    from scipy.spatial.transform import Rotation  # a third of a second to load, and rarely needed

    return Rotation
