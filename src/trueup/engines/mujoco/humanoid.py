# SPDX-License-Identifier: Apache-2.0
"""What a whole-body motion must know of a model: its named poses, which joints mirror one another, ranges, overlaps."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.articulated.mirror import Mirrored, Posture, mirrored_at_best
from trueup.articulated.pose import angles_of
from trueup.engines.mujoco.attributes import follows_position
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.model import Model
from trueup.errors import ModelError, unknown_name


def posture(model: Model, name: str) -> Posture:
    """A keyframe by name. Raises UnknownNameError for one that the file does not have, ModelError for a base that is held."""
    compiled, joint = model.compiled, free_joint(model.compiled)
    if joint < 0:
        raise ModelError(f"the base of model '{model.path.name}' is held: a transition needs one with a free joint")
    keys = [compiled.key(i).name for i in range(compiled.nkey)]
    if name not in keys:
        raise unknown_name("keyframe", name, [k for k in keys if k], f"'{model.path.name}'")
    qpos, start = compiled.key_qpos[keys.index(name)], int(compiled.jnt_qposadr[joint])
    angles = qpos[[compiled.jnt_qposadr[model.index("joint", j)] for j in commanded(model)]]
    return Posture(name, np.array(angles), np.array(qpos[start : start + 3]), angles_of(qpos[start + 3 : start + 7]))


def commanded(model: Model) -> tuple[str, ...]:
    """The joints that actuators drive, in the order of the controls. Raises ModelError where none is, or one by torque."""
    driven = {actuator: joint for joint, actuator in model.drives().items() if actuator}
    joints = tuple(driven[a] for a in model.names("actuator") if a in driven)
    if not joints:
        raise ModelError(f"no actuator of model '{model.path.name}' drives a joint: give its servos as <position>")
    check_servos(model, joints)
    return joints


def check_servos(model: Model, joints: Sequence[str]) -> None:
    """Raises ModelError where the drive of one of these joints does not take angles: it would push by as many N m as rad."""
    driven = model.actuator_of_joint()
    others = [j for j in joints if j in driven and not follows_position(model.compiled, driven[j])]
    if others:
        raise ModelError(
            f"the drives of {', '.join(others)} of '{model.path.name}' take torques or speeds, a motion is angles: give each "
            f'the servo that the robot has in its place, <position joint="{others[0]}" kp="..." kv="..." forcerange="..."/>, '
            "with the gains of its own control loop (N m/rad, N m s/rad)"
        )


def ranges(model: Model) -> tuple[Array, Array]:
    """(k,), (k,) of the commanded joints in rad; without limits where a joint has none."""
    ids = [model.index("joint", j) for j in commanded(model)]
    limited = np.array(model.compiled.jnt_limited[ids], dtype=bool)
    low, high = np.array(model.compiled.jnt_range[ids], dtype=np.float64).T
    return np.where(limited, low, -np.pi), np.where(limited, high, np.pi)


def mirrored(model: Model) -> tuple[Mirrored, ...]:
    """Which joints mirror one another, by where their axes lie at zero angles; of several the one named alike.

    The plane is the one through the base, along its x or y axis, at which most joints find a partner. Raises ModelError
    where no two do.
    """
    compiled, joints = model.compiled, commanded(model)
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    ids = [model.index("joint", j) for j in joints]
    base = int(compiled.jnt_bodyid[free_joint(compiled)])
    turn = data.xmat[base].reshape(3, 3)
    anchors, axes = (data.xanchor[ids] - data.xpos[base]) @ turn, data.xaxis[ids] @ turn
    found = mirrored_at_best(joints, anchors, axes)
    if not any(len(m.joints) == 2 for m in found):
        raise ModelError(
            f"no two joints of model '{model.path.name}' mirror one another at its base's x-z or y-z plane: is it a "
            "humanoid, and are all angles zero where both sides are alike?"
        )
    return found


def overlap(model: Model, posture: Posture) -> str:
    """The two parts that lie deepest in one another in a posture, and by how much; '' where none do."""
    compiled, joint = model.compiled, free_joint(model.compiled)
    data = mujoco.MjData(compiled)
    key = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_KEY, posture.name)
    if joint < 0 or key < 0:
        return ""
    data.qpos[:] = compiled.key_qpos[key]
    mujoco.mj_forward(compiled, data)
    if not data.ncon or float(np.min(data.contact.dist)) >= 0.0:
        return ""
    worst = int(np.argmin(data.contact.dist))
    names = [_part(compiled, int(g)) for g in data.contact.geom[worst]]
    return f"{names[1]} is {-1e3 * float(data.contact.dist[worst]):.1f} mm inside {names[0]}"


def _part(compiled: mujoco.MjModel, geom: int) -> str:
    own, body = compiled.geom(geom).name, compiled.body(compiled.geom_bodyid[geom]).name
    return f"'{own}'" if own else f"a part of '{body}'"
