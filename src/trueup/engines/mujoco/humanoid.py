# SPDX-License-Identifier: Apache-2.0
"""What a whole-body motion must know of a model: its named poses, which joints mirror one another, ranges, overlaps.

A rotation about an axis a, mirrored at a plane with normal n, is the same rotation about 2 (a.n) n - a: axes are
pseudovectors.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.articulated.pose import angles_of
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.model import Model
from trueup.errors import ModelError, unknown_name

_AS_GOOD = 0.02  # share of the robot's size by which mirrored joints may miss one another
_ALONG = 0.98  # cosine: axes that point the same way
_SIDES = re.compile(
    r"(^|[_.\-])(left|right|l|r)(?=[_.\-]|$)|(?<=[a-z0-9])(Left|Right|L|R)$|^(left|right|Left|Right|[lrLR](?=[A-Z]))"
)


@dataclass(frozen=True, eq=False)
class Posture:
    """A named keyframe of a model."""

    name: str
    joints: Array
    """(k,) of the commanded joints, in rad."""
    position: Array
    """(3,) of the base, in m."""
    angles: Array
    """(3,) roll, pitch, yaw of the base, in rad."""

    @property
    def inverted(self) -> bool:
        """Whether the base's z axis points down."""
        return bool(np.cos(self.angles[0]) * np.cos(self.angles[1]) < 0.0)


@dataclass(frozen=True)
class Mirrored:
    """Joints that move as one in a symmetric motion: a pair with its signs, or one joint in the middle."""

    name: str
    joints: tuple[str, ...]
    signs: tuple[float, ...]
    sagittal: bool
    """Whether it turns about the axis from one side to the other, as hips, knees and ankles do when one rises."""


def posture(model: Model, name: str) -> Posture:
    """A keyframe by name. Raises UnknownNameError for one that the file does not have, ModelError for a base that is held."""
    compiled, joint = model.compiled, free_joint(model.compiled)
    if joint < 0:
        raise ModelError(f"the base of model '{model.path.name}' is held: a transition needs one with a free joint")
    keys = [mujoco.mj_id2name(compiled, mujoco.mjtObj.mjOBJ_KEY, i) or "" for i in range(compiled.nkey)]
    if name not in keys:
        raise unknown_name("keyframe", name, [k for k in keys if k], f"'{model.path.name}'")
    qpos, start = compiled.key_qpos[keys.index(name)], int(compiled.jnt_qposadr[joint])
    angles = qpos[[compiled.jnt_qposadr[model.index("joint", j)] for j in commanded(model)]]
    return Posture(name, np.array(angles), np.array(qpos[start : start + 3]), angles_of(qpos[start + 3 : start + 7]))


def commanded(model: Model) -> tuple[str, ...]:
    """The joints that actuators drive, in the order of the controls. Raises ModelError where there is none."""
    driven = {actuator: joint for joint, actuator in model.drives().items() if actuator}
    joints = tuple(driven[a] for a in model.names("actuator") if a in driven)
    if not joints:
        raise ModelError(f"no actuator of model '{model.path.name}' drives a joint: give its servos as <position>")
    return joints


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
    planes = (_pairs(joints, anchors, axes, normal) for normal in np.eye(3)[[1, 0]])
    found = max(planes, key=lambda plane: sum(len(m.joints) == 2 for m in plane))
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
    own = mujoco.mj_id2name(compiled, mujoco.mjtObj.mjOBJ_GEOM, geom)
    body = mujoco.mj_id2name(compiled, mujoco.mjtObj.mjOBJ_BODY, int(compiled.geom_bodyid[geom]))
    return f"'{own}'" if own else f"a part of '{body}'"


def _pairs(joints: tuple[str, ...], anchors: Array, axes: Array, normal: Array) -> tuple[Mirrored, ...]:
    """Joints mirrored at the plane through the base with a normal, each pair once, in the order of the joints."""
    size = float(np.ptp(anchors, axis=0).max()) or 1.0
    flipped = anchors - 2.0 * (anchors @ normal)[:, None] * normal
    wanted = 2.0 * (axes @ normal)[:, None] * normal - axes
    taken: set[int] = set()
    found = []
    for i, joint in enumerate(joints):
        if i in taken:
            continue
        apart = np.linalg.norm(anchors - flipped[i], axis=1) / size
        along = axes @ wanted[i]
        partners = [j for j in np.flatnonzero((apart < _AS_GOOD) & (np.abs(along) > _ALONG)).tolist() if j not in taken]
        others = [j for j in partners if j != i]
        sagittal = bool(abs(axes[i] @ normal) > _ALONG)
        alike = [j for j in others if _bare(joints[j]) == _bare(joint)]
        if others and abs(anchors[i] @ normal) / size > _AS_GOOD / 2:
            j = (alike or others)[0]
            taken |= {i, j}
            found.append(Mirrored(_bare(joint), (joint, joints[j]), (1.0, float(np.sign(along[j]))), sagittal))
        elif abs(anchors[i] @ normal) / size <= _AS_GOOD / 2:
            taken.add(i)
            found.append(Mirrored(joint, (joint,), (1.0,), sagittal))
    return tuple(found)


def _bare(name: str) -> str:
    """A joint's name without its side: 'l_knee', 'knee_right' and 'LKnee' are 'knee'."""
    return _SIDES.sub("", name).strip("_.- ") or name
