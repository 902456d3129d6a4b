# SPDX-License-Identifier: Apache-2.0
"""Reads off a model what a walk must know of it: the geometry of its legs, and where their joints are."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.controllers.walk_engine.legs import JOINTS, Biped, Legs
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.model import Model
from trueup.errors import ModelError

_AXES = (None, 0, 1, 1, 1, 0)  # of the joints of a leg, after the first: x for rolls, y for pitches
_APART = 0.01  # m: axes of a hip or an ankle that lie closer count as meeting in one point
_LEAN = 0.02  # how far an axis may be off its own direction


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
    _check(model, (left, right), axes, anchors)
    driven = model.actuator_of_joint()
    columns = np.array([[_column(model, driven, n) for n in side] for side in (left, right)])
    signs = np.ones((2, 6))
    signs[:, 1:] = [[np.sign(axes[s, j, _AXES[j]]) for j in range(1, 6)] for s in range(2)]
    limited = m.jnt_limited[ids].astype(bool)
    legs = Legs(
        joints=(tuple(left), tuple(right)), hips=anchors[:, 2], yaw=axes[:, 0], signs=signs,
        thigh=(anchors[:, 3] - anchors[:, 2])[:, [0, 2]], shank=(anchors[:, 4] - anchors[:, 3])[:, [0, 2]],
        lower=np.where(limited, m.jnt_range[ids, 0], -np.inf), upper=np.where(limited, m.jnt_range[ids, 1], np.inf),
        shared=bool((columns[:, 0] < 0).any()),
    )  # fmt: skip
    rest = np.zeros(model.width)
    for joint in driven:
        rest[_column(model, driven, joint)] = m.qpos0[m.jnt_qposadr[model.index("joint", joint)]]
    return Biped(legs, columns, m.jnt_qposadr[ids].astype(np.int64), rest)


def _column(model: Model, driven: dict[str, int], joint: str) -> int:
    return int(model.compiled.actuator_ctrladr[driven[joint]]) if joint in driven else -1


def _check(model: Model, names: Sequence[Sequence[str]], axes: Array, anchors: Array) -> None:
    for side in range(2):
        for j, axis in enumerate(_AXES):
            if axis is not None and abs(abs(axes[side, j, axis]) - 1.0) > _LEAN:
                raise ModelError(
                    f"joint '{names[side][j]}' of model '{model.name}' turns about {axes[side, j].round(3)}; a leg's "
                    f"{JOINTS[j]} turns about {'xyz'[axis]} at zero angles"
                )
        for a, b in ((0, 2), (1, 2), (4, 5)):
            apart = float(np.linalg.norm(anchors[side, a] - anchors[side, b]))
            if apart > _APART:
                raise ModelError(
                    f"joints '{names[side][a]}' and '{names[side][b]}' of model '{model.name}' lie {1e3 * apart:.0f} mm "
                    f"apart; the axes of a hip or an ankle must meet within {1e3 * _APART:.0f} mm"
                )
        aside = float(np.ptp(anchors[side, 2:5, 1]))
        if aside > _APART:
            raise ModelError(
                f"the leg of '{names[side][2]}' in model '{model.name}' is {1e3 * aside:.0f} mm out of its own plane"
            )
