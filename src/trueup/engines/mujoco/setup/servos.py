# SPDX-License-Identifier: Apache-2.0
"""Position servos for joints whose model has none: where to start when nobody knows the controller inside the robot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.articulated.quantities.joints import BANDWIDTH
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.gears import OWN
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.wiring import is_motor, joint_id
from trueup.instant import STILL
from trueup.recording import Recording
from trueup.rounding import ROUNDED

_SMALLEST = 0.1  # share of the largest inertia below which none is believed: drives of one robot are alike


def add_servos(spec: mujoco.MjSpec, model: Model, joints: Sequence[str], recordings: Sequence[Recording]) -> None:
    """Position servos for `joints` of a spec made from `model`, in place of their motors where they have some.

    Stiffness such that the joint follows at 5 Hz and stays (`STILL`) under the robot's own weight, damping such that it does
    not overshoot: a start for a calibration, which finds the rest. Where force is limited the damping is the servo's, within
    that limit as in a real one; else it is the joint's, which is the same.
    """
    inertia, weight = loads(model, joints, recordings)
    for name, moved, held in zip(joints, inertia, weight, strict=True):
        joint = spec.joint(name)
        force = _strongest(model, name)
        if joint.armature == 0.0:
            joint.armature = OWN * moved
            moved *= 1.0 + OWN
        stiffness = max(moved * BANDWIDTH**2, held / STILL)
        damping = 2.0 * float(np.sqrt(stiffness * moved))
        joint.actfrclimited, joint.actfrcrange = mujoco.mjtLimited.mjLIMITED_FALSE, [0.0, 0.0]  # the servo has it now
        _servo(spec, model, name, stiffness, damping if np.isfinite(force) else 0.0, force)
        if (
            not np.isfinite(force) and joint.damping[0] < damping
        ):  # a file's own is friction, beside which it would swing
            joint.damping = [damping, *joint.damping[1:]]


def add_speed_servos(spec: mujoco.MjSpec, model: Model, joints: Sequence[str], recordings: Sequence[Recording]) -> None:
    """Servos of speed for `joints` of a spec made from `model`, in place of other drives where they have some.

    They begin as stiff as position servos would be damped: they follow at 5 Hz, and give way to the robot's weight by the
    speed with which such a servo would sag.
    """
    inertia, weight = loads(model, joints, recordings)
    for name, moved, held in zip(joints, inertia, weight, strict=True):
        joint = spec.joint(name)
        if joint.armature == 0.0:
            joint.armature = OWN * moved
        joint.actfrclimited, joint.actfrcrange = mujoco.mjtLimited.mjLIMITED_FALSE, [0.0, 0.0]
        damping = max(moved * BANDWIDTH, held / (STILL * BANDWIDTH))
        _servo(spec, model, name, 0.0, damping, _strongest(model, name))


def postures(compiled: mujoco.MjModel, recordings: Sequence[Recording], count: int) -> Iterator[Array]:
    """(nq,) `count` measured postures of each recording; what is not measured as in the model's first keyframe."""
    rest = np.array(compiled.key_qpos[0] if compiled.nkey else compiled.qpos0)
    for recording in recordings:
        channel = recording.channels.get("position")
        known = [(i, joint_id(compiled, label)) for i, label in enumerate(channel.labels)] if channel else []
        known = [(i, j) for i, j in known if j >= 0]
        if channel is None or not known:
            continue
        every = channel.values[:, [i for i, _ in known]]
        good = np.flatnonzero(np.isfinite(every).all(axis=1))
        for row in good[np.unique(np.linspace(0, len(good) - 1, count).astype(int))] if len(good) else ():
            qpos = rest.copy()
            qpos[compiled.jnt_qposadr[[j for _, j in known]]] = every[row]
            yield qpos


def _servo(
    spec: mujoco.MjSpec, model: Model, joint: str, stiffness: float, damping: float, force: float
) -> None:  # fmt: skip
    """Adds the servo, or makes it of the joint's drive; one of speed without `stiffness`. `force`: its limit in N m, infinite
    for none.
    """
    index = model.actuator_of_joint().get(joint, -1)
    if index >= 0:
        actuator = spec.actuators[index]
        actuator.gear = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
        actuator.ctrlrange = [0.0, 0.0]
        actuator.dyntype, actuator.actlimited = mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtLimited.mjLIMITED_FALSE
        actuator.actrange = [0.0, 0.0]
    else:
        actuator = spec.add_actuator()
        actuator.name, actuator.target, actuator.trntype = joint, joint, mujoco.mjtTrn.mjTRN_JOINT
    if stiffness:
        actuator.set_to_position(kp=stiffness, kv=damping)
    else:
        actuator.set_to_velocity(kv=damping)
    if np.isfinite(force):
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = [-force, force]


def _strongest(model: Model, joint: str) -> float:
    """Largest torque at a joint in N m, by the limits of its motor's control and force and of its own; infinite without."""
    compiled, motor, j = model.compiled, model.actuator_of_joint().get(joint, -1), joint_id(model.compiled, joint)
    own = float(np.abs(compiled.jnt_actfrcrange[j]).max()) if compiled.jnt_actfrclimited[j] else np.inf
    if motor < 0:
        return own
    limits = [np.inf]
    if is_motor(compiled, motor) and compiled.actuator_ctrllimited[motor]:
        limits.append(float(np.abs(compiled.actuator_ctrlrange[motor]).max() * compiled.actuator_gainprm[motor, 0]))
    if compiled.actuator_forcelimited[motor]:
        limits.append(float(np.abs(compiled.actuator_forcerange[motor]).max()))
    return min(own, min(limits) * abs(float(compiled.actuator_gear[motor, 0])))


def loads(model: Model, joints: Sequence[str], recordings: Sequence[Recording]) -> tuple[Array, Array]:
    """(k,) inertia that each joint moves and (k,) torque by which it holds the robot, the largest at measured postures."""
    compiled = model.compiled
    data = mujoco.MjData(compiled)
    dofs = compiled.jnt_dofadr[[joint_id(compiled, j) for j in joints]]
    inertia, weight = np.zeros(len(dofs)), np.zeros(len(dofs))
    rest = np.array(compiled.key_qpos[0] if compiled.nkey else compiled.qpos0)
    for qpos in [rest, *postures(compiled, recordings, 5)]:
        data.qpos[:] = qpos
        mujoco.mj_forward(compiled, data)
        weight = np.maximum(weight, np.abs(data.qfrc_bias[dofs]))
        inertia = np.maximum(inertia, [_felt(compiled, data, int(d)) for d in dofs])
    return np.maximum(inertia, _SMALLEST * inertia.max(initial=ROUNDED)), np.maximum(weight, _stood_on(compiled, dofs))


def _stood_on(compiled: mujoco.MjModel, dofs: NDArray[np.int32]) -> Array:
    """(k,) torque of joints that carry a free base on legs: its weight shared by the limbs, at half a limb's length.

    Legs give way more than arms sag, so 0.4 of it counts; too soft would fall.
    """
    joint = free_joint(compiled)
    if joint < 0:
        return np.zeros(len(dofs))
    base = int(compiled.jnt_bodyid[joint])
    hung = compiled.body_weldid[compiled.body_parentid[compiled.jnt_bodyid]]
    limbs = max(int(np.sum(hung == compiled.body_weldid[base])), 1)
    weight = float(compiled.body_subtreemass[base] * np.linalg.norm(compiled.opt.gravity))
    length = 2.0 * np.linalg.norm(compiled.body_ipos, axis=1)  # a last link reaches beyond its own centre of mass
    for body in range(compiled.nbody - 1, 0, -1):  # children come after their parents
        parent = int(compiled.body_parentid[body])
        length[parent] = max(length[parent], length[body] + float(np.linalg.norm(compiled.body_pos[body])))
    reach = np.maximum(length[compiled.dof_bodyid[dofs]], 0.5 * length[compiled.dof_bodyid[dofs]].max(initial=0.0))
    return 0.4 * 0.5 * reach * weight / limbs


def _felt(compiled: mujoco.MjModel, data: mujoco.MjData, dof: int) -> float:
    unit, out = np.zeros(compiled.nv), np.zeros(compiled.nv)
    unit[dof] = 1.0
    mujoco.mj_mulM(compiled, data, out, unit)
    return float(out[dof])
