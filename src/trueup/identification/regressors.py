# SPDX-License-Identifier: Apache-2.0
"""Joint torque as a linear function of the links' inertial parameters: regressor, inverse dynamics."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array
from trueup.errors import ModelError
from trueup.identification import blocks
from trueup.identification.kinematic_tree import KinematicTree


def inverse_dynamics(tree: KinematicTree, inertial: ArrayLike, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
    """(S, n) torque (N m, or N) of rigid links `inertial` (n, 10) at samples q, qd, qdd (S, n); rotors not included."""
    q_, qd_, qdd_ = samples(tree, q, qd, qdd)
    torque = np.zeros(q_.shape)
    weighed = np.ascontiguousarray(np.asarray(inertial, dtype=float).reshape(tree.n, 10))
    blocks.torques(blocks.layout(tree), weighed, q_, qd_, qdd_, torque)
    return torque


def regressor(tree: KinematicTree, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
    """(S, n, 10 n) matrices Y with torque = Y @ inertial.ravel(), at samples q, qd, qdd (S, n).

    Row i depends only on the links that joint i carries: with u, w the angular and linear velocity of link j for a unit
    speed of joint i, the power of the link's Newton-Euler wrench is linear in its ten parameters. Atkeson, An &
    Hollerbach, "Estimation of inertial parameters of manipulator loads and links", IJRR 5(3), 1986. The memory runs
    along the samples, so that filtering and decimating are quick.
    """
    q_, qd_, qdd_ = samples(tree, q, qd, qdd)
    return filled(blocks.layout(tree), q_, qd_, qdd_)


def filled(tree: blocks.Layout, q: Array, qd: Array, qdd: Array) -> Array:
    """(S, n, p) regressor of all columns of a layout; see `regressor`."""
    n = len(tree.parent)
    p = 10 * n + len(tree.kind)
    out = np.zeros((n, p, len(q)))
    blocks.regressor_rows(tree, q, qd, qdd, np.arange(n * p).reshape(n, p), out.reshape(-1))
    return np.moveaxis(out, -1, 0)


def samples(tree: KinematicTree, *given: ArrayLike) -> list[Array]:
    """Each (S, n) in double precision. Raises ModelError where shapes do not fit the tree."""
    arrays = [np.ascontiguousarray(np.atleast_2d(np.asarray(values, dtype=float))) for values in given]
    for values in arrays:
        if values.shape != (len(arrays[0]), tree.n):
            raise ModelError(
                f"positions, velocities and accelerations of '{tree.name}' must be (samples, {tree.n}) for joints "
                f"{', '.join(tree.joints)}; got {', '.join(str(v.shape) for v in arrays)}"
            )
    return arrays
