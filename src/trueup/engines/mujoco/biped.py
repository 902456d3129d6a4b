# SPDX-License-Identifier: Apache-2.0
"""Reads off a model what a walk must know of it: the geometry of its legs, and where their joints are."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from trueup.controllers.walk_engine.legs import JOINTS, Biped, Legs
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.model import Model
from trueup.errors import ModelError


def biped_of(model: Model, left: Sequence[str], right: Sequence[str]) -> Biped:
    """The legs of a model with a free base, by the names of their joints from the hip down (`legs.JOINTS`).

    Motors of other joints are to hold these where the model's reference pose has them. Raises UnknownNameError for a joint
    that is not there, and ModelError for legs of another build, naming the joint.
    """
    m = model.compiled
    base = free_joint(m)
    if base < 0:
        raise ModelError(f"model '{model.name}' has no free base: it cannot walk")
    data = mujoco.MjData(m)
    ids = np.array([[model.index("joint", n) for n in side] for side in (left, right)])
    if ids.shape != (2, len(JOINTS)):
        raise ModelError(f"legs of {len(left)} and {len(right)} joints; a leg has six: {', '.join(JOINTS)}")
    data.qpos[:] = m.qpos0
    data.qpos[m.jnt_qposadr[base] : m.jnt_qposadr[base] + 7] = (0, 0, 0, 1, 0, 0, 0)
    data.qpos[m.jnt_qposadr[ids]] = 0.0
    mujoco.mj_kinematics(m, data)
    torso = int(m.jnt_bodyid[base])
    turn, origin = data.xmat[torso].reshape(3, 3), data.xpos[torso]
    axes, anchors = data.xaxis[ids] @ turn, (data.xanchor[ids] - origin) @ turn
    driven = model.actuator_of_joint()
    columns = np.array([[_column(model, driven, n) for n in side] for side in (left, right)])
    limited = m.jnt_limited[ids].astype(bool)
    lower, upper = np.where(limited, m.jnt_range[ids, 0], -np.inf), np.where(limited, m.jnt_range[ids, 1], np.inf)
    shared = bool((columns[:, 0] < 0).any())
    legs = Legs.of((tuple(left), tuple(right)), axes, anchors, lower, upper, shared=shared, model=model.name)
    rest = np.zeros(model.width)
    for joint in driven:
        rest[_column(model, driven, joint)] = m.qpos0[m.jnt_qposadr[model.index("joint", joint)]]
    return Biped(legs, columns, m.jnt_qposadr[ids].astype(np.int64), rest)


def _column(model: Model, driven: dict[str, int], joint: str) -> int:
    return int(model.compiled.actuator_ctrladr[driven[joint]]) if joint in driven else -1
