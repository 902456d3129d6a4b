# SPDX-License-Identifier: Apache-2.0
"""Reads off a model what a walk must know of it: the geometry of its legs, and where their joints are."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.controllers.walk_engine.legs import AXES, JOINTS, SPARED, Biped, Legs, roles
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.humanoid import check_servos
from trueup.engines.mujoco.model import Model
from trueup.errors import ModelError


def biped_of(model: Model, left: Sequence[str], right: Sequence[str]) -> Biped:
    """The legs of a model with a free base, by the names of their joints; what each is for, its axis tells.

    Motors of other joints are to hold these where the model's reference pose has them. Raises UnknownNameError for a joint
    that is not there, and ModelError for legs of another build or driven by torque, naming the joint.
    """
    m = model.compiled
    base = free_joint(m)
    if base < 0:
        raise ModelError(f"model '{model.name}' has no free base: it cannot walk")
    check_servos(model, (*left, *right))
    sides = [_ordered(model, side) for side in (left, right)]
    axes, anchors = _lines(model, [j for side in sides for j in side], base)
    found = [roles(model.name, side, a) for side, a in zip(sides, (axes[: len(left)], axes[len(left) :]), strict=True)]
    if found[0] != found[1]:
        raise ModelError(f"the legs of model '{model.name}' differ: {', '.join(sides[0])}; {', '.join(sides[1])}")
    own = list(found[0])
    whole_axes, whole_anchors = np.tile(AXES, (2, 1, 1)), np.zeros((2, len(JOINTS), 3))
    whole_axes[:, own], whole_anchors[:, own] = axes.reshape(2, -1, 3), anchors.reshape(2, -1, 3)
    for lacked, at in ((JOINTS.index(lacked), JOINTS.index(at)) for lacked, at in SPARED.items()):
        if lacked not in own:
            whole_anchors[:, lacked] = whole_anchors[:, at]
    named = [[side[own.index(j)] if j in own else "" for j in range(len(JOINTS))] for side in sides]
    driven = model.actuator_of_joint()
    columns = np.array([[_column(model, driven, n) for n in side] for side in named])
    ids = np.array([[model.index("joint", n or side[own.index(2)]) for n in side] for side in named])
    limited = m.jnt_limited[ids].astype(bool)
    lower, upper = np.where(limited, m.jnt_range[ids, 0], -np.inf), np.where(limited, m.jnt_range[ids, 1], np.inf)
    order = np.tile([*own, *[-1] * (len(JOINTS) - len(own))], (2, 1))
    shared = 0 in own and bool((columns[:, 0] < 0).any())
    legs = Legs((tuple(named[0]), tuple(named[1])), order, whole_axes, whole_anchors, lower, upper, shared)
    rest = np.zeros(model.width)
    for joint in driven:
        rest[_column(model, driven, joint)] = m.qpos0[m.jnt_qposadr[model.index("joint", joint)]]
    return Biped(legs, columns, m.jnt_qposadr[ids].astype(np.int64), rest)


def inertial(model: Model) -> dict[str, tuple[str, Array]]:
    """'gyro' and 'accelerometer' to the sensor by which a free base is felt, and the turn (3, 3) of its frame in the base's.

    The one of this name, else the model's only one. Raises ModelError where there is none, or several.
    """
    m, data = model.compiled, mujoco.MjData(model.compiled)
    mujoco.mj_kinematics(m, data)
    base = data.xmat[int(m.jnt_bodyid[free_joint(m)])].reshape(3, 3)
    kinds = {"gyro": mujoco.mjtSensor.mjSENS_GYRO, "accelerometer": mujoco.mjtSensor.mjSENS_ACCELEROMETER}
    found = {}
    for kind, number in kinds.items():
        names = {n: i for i, n in enumerate(model.names("sensor")) if n and int(m.sensor_type[i]) == int(number)}
        if kind not in names and len(names) != 1:
            others = f"; of its {kind}s none is called so: {', '.join(names)}" if names else ""
            raise ModelError(
                f"model '{model.name}' has no sensor '{kind}', by which a walk feels its lean{others}; add "
                f'<{kind} name="{kind}" site="..."/>; its sensors are: {", ".join(model.names("sensor")) or "none"}'
            )
        name = kind if kind in names else next(iter(names))
        site = data.site_xmat[int(m.sensor_objid[names[name]])].reshape(3, 3)
        found[kind] = (name, np.round(base.T @ site, 12))
    return found


def _ordered(model: Model, joints: Sequence[str]) -> list[str]:
    """Joints from the hip down. Raises ModelError where they do not follow one another."""
    ids = sorted(model.index("joint", n) for n in joints)
    names, parents = model.names("joint"), model.compiled.body_parentid
    bodies = [int(model.compiled.jnt_bodyid[i]) for i in ids]
    for k in range(1, len(ids)):
        body = bodies[k]
        while body > bodies[k - 1]:
            body = int(parents[body])
        if body != bodies[k - 1]:
            raise ModelError(
                f"joint '{names[ids[k]]}' of model '{model.name}' is not below '{names[ids[k - 1]]}'; "
                "name the joints of one leg"
            )
    return [names[i] for i in ids]


def _lines(model: Model, joints: Sequence[str], base: int) -> tuple[Array, Array]:
    """(k, 3), (k, 3) axes of joints and points on them, at zero angles of them in the base's frame."""
    m, data = model.compiled, mujoco.MjData(model.compiled)
    ids = [model.index("joint", n) for n in joints]
    data.qpos[:] = m.qpos0
    data.qpos[m.jnt_qposadr[base] : m.jnt_qposadr[base] + 7] = (0, 0, 0, 1, 0, 0, 0)
    data.qpos[m.jnt_qposadr[ids]] = 0.0
    mujoco.mj_kinematics(m, data)
    torso = int(m.jnt_bodyid[base])
    turn, origin = data.xmat[torso].reshape(3, 3), data.xpos[torso]
    return data.xaxis[ids] @ turn, (data.xanchor[ids] - origin) @ turn


def _column(model: Model, driven: dict[str, int], joint: str) -> int:
    return int(model.compiled.actuator_ctrladr[driven[joint]]) if joint in driven else -1
