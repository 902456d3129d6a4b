# SPDX-License-Identifier: Apache-2.0
"""The inertia of a compiled body in the body's own frame."""

from __future__ import annotations

import mujoco

from trueup.arrays import Array
from trueup.articulated.inertia import from_principal


def body_inertia(model: mujoco.MjModel, body: int) -> Array:
    """(3, 3) rotational inertia about the CoM in the body frame [kg m2]."""
    return from_principal(model.body_inertia[body], model.body_iquat[body])
