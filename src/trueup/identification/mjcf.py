# SPDX-License-Identifier: Apache-2.0
"""Reads the kinematic tree of an MJCF file, as MuJoCo compiles it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from trueup.arrays import Array, Integers
from trueup.errors import ModelError
from trueup.identification.inertial import from_com, moved
from trueup.identification.kinematic_tree import KinematicTree, about, of_quaternion

if TYPE_CHECKING:
    import mujoco


def tree_from_mjcf(path: str | Path, *, fix_base: bool = False) -> KinematicTree:
    """The tree of an MJCF file; bodies without joints are merged, a body with k joints gets k - 1 massless links before.

    Raises ModelError where it does not compile, for ball joints, and unless `fix_base` for free ones.
    """
    from trueup.engines.mujoco.model import load

    model = load(path)
    return tree_of(model.compiled, model.name, fix_base=fix_base, notes=model.notes)


def tree_of(model: mujoco.MjModel, name: str, *, fix_base: bool = False, notes: tuple[str, ...] = ()) -> KinematicTree:
    """The tree of a compiled model. Raises ModelError for joints that are neither hinge nor slide, see `fix_base`."""
    _check_joints(model, name, fix_base)
    parent: list[int] = []
    of_joint: list[int] = []  # MuJoCo's id of each joint of the tree
    rotation, offset, mass = [], [], []
    where: dict[int, tuple[int, Array, Array]] = {0: (-1, np.eye(3), np.zeros(3))}  # body -> carrier, pose in its frame
    for body in range(1, model.nbody):
        carrier, R, p = where[int(model.body_parentid[body])]
        R, p = R @ of_quaternion(model.body_quat[body]), p + R @ model.body_pos[body]
        for j in range(model.body_jntadr[body], model.body_jntadr[body] + max(int(model.body_jntnum[body]), 0)):
            if int(model.jnt_type[j]) == 0:  # a free joint, welded
                continue
            at = np.array(model.jnt_pos[j])
            R_zero, p_zero = _at_zero(model, j, R, p + R @ at)
            parent.append(carrier)
            of_joint.append(j)
            rotation.append(R_zero)
            offset.append(p_zero)
            mass.append(np.zeros(10))
            carrier, R, p = len(of_joint) - 1, np.eye(3), -at  # the body's frame, seen from the link's
        where[body] = (carrier, R, p)
        if carrier >= 0:
            mass[carrier] = mass[carrier] + moved(_inertial(model, body), R, p)
    if not of_joint:
        raise ModelError(f"model '{name}' has no hinge or slide joint")
    return _tree(model, name, notes, np.array(of_joint), parent, rotation, offset, mass)


def _tree(
    model: mujoco.MjModel, name: str, notes: tuple[str, ...], ids: Integers, parent: list[int],
    rotation: list[Array], offset: list[Array], mass: list[Array],
) -> KinematicTree:  # fmt: skip
    limited = model.jnt_limited[ids].astype(bool)
    bounds = np.where(limited[:, None], model.jnt_range[ids], np.nan)
    effort = np.array([_effort(model, int(j)) for j in ids])
    if model.neq:
        notes = (*notes, f"{model.neq} equality constraints are left out: each joint moves on its own")
    loops = _loops(model)
    if loops:
        closed = "; ".join(", ".join(loop) for loop in loops)
        notes = (
            *notes,
            f"a loop is closed over {closed}: as a tree, what is found of joints that it moves is not theirs alone",
        )
    return KinematicTree(
        name=name, joints=tuple(model.joint(i).name for i in ids),
        links=tuple(model.body(int(model.jnt_bodyid[i])).name for i in ids),
        parent=np.array(parent), prismatic=model.jnt_type[ids] == 2, axis=model.jnt_axis[ids],
        rotation=np.array(rotation), offset=np.array(offset), gravity=np.array(model.opt.gravity),
        lower=bounds[:, 0], upper=bounds[:, 1], speed=np.full(len(ids), np.nan), effort=effort, inertial=np.array(mass),
        armature=model.dof_armature[model.jnt_dofadr[ids]], damping=model.dof_damping[model.jnt_dofadr[ids]],
        friction=model.dof_frictionloss[model.jnt_dofadr[ids]], loops=loops, stiffness=model.jnt_stiffness[ids],
        slack=model.qpos_spring[model.jnt_qposadr[ids]], notes=notes,
    )  # fmt: skip


def _loops(model: mujoco.MjModel) -> tuple[tuple[str, ...], ...]:
    """Joints between the two bodies of each constraint that holds a point or a body to another (<connect>, <weld>)."""
    import mujoco

    kinds = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
    found = []
    for i in range(model.neq):
        if int(model.eq_type[i]) not in kinds or not model.eq_active0[i]:
            continue
        ends = (int(model.eq_obj1id[i]), int(model.eq_obj2id[i]))
        if int(model.eq_objtype[i]) == int(mujoco.mjtObj.mjOBJ_SITE):
            ends = (int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]]))
        between = set.symmetric_difference(*(_joints_to(model, body) for body in ends))
        if between:
            found.append(tuple(model.joint(j).name for j in sorted(between)))
    return tuple(found)


def _joints_to(model: mujoco.MjModel, body: int) -> set[int]:
    """The joints between the world and a body."""
    joints = set[int]()
    while body > 0:
        first = int(model.body_jntadr[body])
        joints |= set(range(first, first + int(model.body_jntnum[body])))
        body = int(model.body_parentid[body])
    return joints


def _effort(model: mujoco.MjModel, joint: int) -> float:
    """What the drives of a joint give at most, in N m (N): as the joint limits it, or else they; NaN where nothing does."""
    import mujoco  # only where there is such a model: what identifies arms from URDF needs no simulator

    if model.jnt_actfrclimited[joint]:
        return float(model.jnt_actfrcrange[joint, 1])
    on_it = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_trnid[:, 0] == joint)
    limits = [_strength(model, int(i)) for i in np.flatnonzero(on_it)]
    return sum(limits) if limits else np.nan


def _strength(model: mujoco.MjModel, i: int) -> float:
    """What an actuator gives its joint at most: its force, or a motor's control, by its gear; NaN where neither is limited.

    A control of -1 ... 1 that no gear multiplies is a share of what nobody says.
    """
    gear, limits = abs(float(model.actuator_gear[i, 0])), list[float]()
    if model.actuator_forcelimited[i]:
        limits.append(gear * float(min(-model.actuator_forcerange[i, 0], model.actuator_forcerange[i, 1])))
    motor = not (model.actuator_dyntype[i] or model.actuator_gaintype[i] or model.actuator_biastype[i])
    if motor and model.actuator_ctrllimited[i]:
        control = float(min(-model.actuator_ctrlrange[i, 0], model.actuator_ctrlrange[i, 1]))
        times = gear * float(model.actuator_gainprm[i, 0])
        limits += [] if control == times == 1.0 else [times * control]
    return min((limit for limit in limits if limit > 0.0), default=np.nan)


def _check_joints(model: mujoco.MjModel, name: str, fix_base: bool) -> None:
    for j in range(model.njnt):
        kind = ("free", "ball", "slide", "hinge")[int(model.jnt_type[j])]
        if kind == "ball" or (kind == "free" and not fix_base):
            hint = "; the base can be welded with fix_base=True" if kind == "free" else ""
            raise ModelError(
                f"joint '{model.joint(j).name}' of '{name}' is {kind}; only hinge and slide joints on a fixed base "
                f"can be used{hint}"
            )


def _at_zero(model: mujoco.MjModel, j: int, R: Array, p: Array) -> tuple[Array, Array]:
    """The pose at q = 0: the file shows the body at q = ref."""
    ref, axis = float(model.qpos0[model.jnt_qposadr[j]]), np.array(model.jnt_axis[j])
    if int(model.jnt_type[j]) == 2:
        return R, p - R @ axis * ref
    return R @ about(axis, -ref), p


def _inertial(model: mujoco.MjModel, body: int) -> Array:
    R = of_quaternion(model.body_iquat[body])
    return from_com(float(model.body_mass[body]), model.body_ipos[body], R @ np.diag(model.body_inertia[body]) @ R.T)
