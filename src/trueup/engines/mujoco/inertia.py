# SPDX-License-Identifier: Apache-2.0
"""The inertia of a compiled body in the body's own frame."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.articulated.inertia import log_cholesky

Array = NDArray[np.float64]


def body_inertia(model: mujoco.MjModel, body: int) -> Array:
    """(3, 3) rotational inertia about the CoM in the body frame [kg m2]."""
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    turn = rotation.reshape(3, 3)
    return turn @ np.diag(model.body_inertia[body]) @ turn.T


def log_cholesky_of_body(model: mujoco.MjModel, body: int) -> Array:
    """(10,) log-Cholesky coordinates of a body of a compiled model."""
    return log_cholesky(float(model.body_mass[body]), model.body_ipos[body], body_inertia(model, body))
