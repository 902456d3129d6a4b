# SPDX-License-Identifier: Apache-2.0
"""Inertial parameters of rigid bodies as ten numbers: (m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz), linear in torque.

Mass in kg, first moments in kg m, second moments in kg m^2 about the frame's origin in the frame's axes. Products of
inertia are matrix entries (Ixy = -integral of x y dm). The order is Pinocchio's.
"""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array

NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
UNITS = ("kg", "kg m", "kg m", "kg m", "kg m^2", "kg m^2", "kg m^2", "kg m^2", "kg m^2", "kg m^2")
_ROWS, _COLUMNS = (0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)
_NUMBERED = ("m{}", "mc{}x", "mc{}y", "mc{}z", "I{}xx", "I{}xy", "I{}yy", "I{}xz", "I{}yz", "I{}zz")


def link_names(n: int) -> tuple[str, ...]:
    """Names of the 10 n parameters of n links, link by link: m1, mc1x, ..., I1zz, m2, ..."""
    return tuple(name.format(j + 1) for j in range(n) for name in _NUMBERED)


def from_com(mass: float, com: Array, inertia: Array) -> Array:
    """(10,) parameters of a body with `inertia` (3, 3) about its centre of mass `com` (3,), both in the frame's axes."""
    c = np.asarray(com, dtype=float)
    about_origin = np.asarray(inertia, dtype=float) + mass * (c @ c * np.eye(3) - np.outer(c, c))
    return np.concatenate([[mass], mass * c, about_origin[_ROWS, _COLUMNS]])


def about_com(inertial: Array) -> tuple[float, Array, Array]:
    """Mass, centre of mass (3,) and inertia (3, 3) about it of parameters (10,); the inverse of `from_com`."""
    mass = float(inertial[0])
    com = inertial[1:4] / mass
    return mass, com, tensor(inertial) - mass * (com @ com * np.eye(3) - np.outer(com, com))


def tensor(inertial: Array) -> Array:
    """(..., 3, 3) inertia about the frame's origin of parameters (..., 10)."""
    full = np.empty((*inertial.shape[:-1], 3, 3))
    full[..., _ROWS, _COLUMNS] = inertial[..., 4:]
    full[..., _COLUMNS, _ROWS] = inertial[..., 4:]
    return full


def pseudo_inertia(inertial: Array) -> Array:
    """(..., 4, 4) second moments of the mass distribution; a body is physical if and only if this is >= 0.

    Wensing, Kim & Slotine, "Linear matrix inequalities for physically consistent inertial parameter identification",
    IEEE RA-L 3(1), 2018, eq. 12.
    """
    inertia = tensor(inertial)
    full = np.empty((*inertial.shape[:-1], 4, 4))
    full[..., :3, :3] = 0.5 * np.trace(inertia, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - inertia
    full[..., :3, 3] = full[..., 3, :3] = inertial[..., 1:4]
    full[..., 3, 3] = inertial[..., 0]
    return full


def from_pseudo_inertia(pseudo: Array) -> Array:
    """(..., 10) parameters of pseudo-inertia matrices (..., 4, 4); the inverse of `pseudo_inertia`."""
    moments = pseudo[..., :3, :3]
    inertia = np.trace(moments, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - moments
    return np.concatenate([pseudo[..., 3, 3:], pseudo[..., 3, :3], inertia[..., _ROWS, _COLUMNS]], axis=-1)


def moved(inertial: Array, rotation: Array, offset: Array) -> Array:
    """(..., 10) the same bodies seen from a frame in which the old one is rotated by `rotation` and lies at `offset`."""
    shape = np.broadcast_shapes(inertial.shape[:-1], rotation.shape[:-2], offset.shape[:-1])
    pose = np.zeros((*shape, 4, 4))
    pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = rotation, offset, 1.0
    return from_pseudo_inertia(pose @ pseudo_inertia(inertial) @ np.swapaxes(pose, -1, -2))
