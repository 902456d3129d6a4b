# SPDX-License-Identifier: Apache-2.0
"""Joints of which nothing is known: neither measured nor driven, they would dangle; they are held as the model has them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.wheels import rolling
from trueup.engines.mujoco.wiring import joint_id
from trueup.errors import listed
from trueup.recording import Recording


def with_still_joints(model: Model, recordings: Sequence[Recording]) -> Model:
    """The model with those joints held in simulations that the recordings neither name nor the model drives or ties.

    The legs of a humanoid whose arms were logged, the fingers of a hand that was not: in truth something holds them.
    Springs, tendons, closed chains and whatever a sensor looks at keep their joints, and so do wheels and casters: those that
    nothing drives are there to roll.
    """
    compiled = model.compiled
    logged = {label for r in recordings for c in r.channels.values() for label in c.labels}
    if not any(joint in logged for joint in model.scalar_joints()):
        return model
    tied = _tied(compiled) | rolling(compiled)
    still = tuple(
        joint for joint in model.scalar_joints()
        if joint not in logged and joint not in model.actuator_of_joint() and joint_id(compiled, joint) not in tied
        and not compiled.jnt_stiffness[joint_id(compiled, joint)] and _as_drawn(compiled, joint)
    )  # fmt: skip
    if not still:
        return model
    note = f"neither measured nor driven, and so held as the model has them: {listed(still)}"
    loose = carriers(model)
    if carried := [joint for joint in still if joint_id(compiled, joint) in loose]:
        note += (
            f". What the drives move hangs on {listed(carried)}, as on a stand: if it was free (a rail, a boom), name the "
            "column that says where it was in [channels.position] of the mapping"
        )
    return replace(model, notes=(*model.notes, note), still=still)


def carriers(model: Model) -> set[int]:
    """Joints that nothing drives, and no spring holds, on which driven ones hang: free bases, rails, booms."""
    m = model.compiled
    driven = {model.index("joint", joint) for joint in model.actuator_of_joint()}
    pulled = set(m.wrap_objid[m.wrap_type == int(mujoco.mjtWrap.mjWRAP_JOINT)].tolist())
    loose = {j for j in set(range(m.njnt)) - driven - pulled if not m.jnt_stiffness[j]}
    bodies, above = {int(m.jnt_bodyid[j]) for j in driven}, set[int]()
    while bodies := {int(m.body_parentid[b]) for b in bodies} - {0}:
        above |= bodies
    return {j for j in loose if int(m.jnt_bodyid[j]) in above}


def _as_drawn(compiled: mujoco.MjModel, joint: str) -> bool:
    """Whether a joint starts where the bodies are drawn, in every keyframe too: there it can be taken out."""
    address = int(compiled.jnt_qposadr[joint_id(compiled, joint)])
    return bool(np.all(compiled.key_qpos[:, address] == compiled.qpos0[address]))


def _tied(compiled: mujoco.MjModel) -> set[int]:
    """Joints that tendons, actuators of other kinds or sensors name, or any at all where bodies are tied together."""
    tied = {int(j) for j in compiled.wrap_objid[compiled.wrap_type == int(mujoco.mjtWrap.mjWRAP_JOINT)]}
    of_joints = compiled.sensor_objtype == int(mujoco.mjtObj.mjOBJ_JOINT)
    tied |= {int(j) for j in compiled.sensor_objid[of_joints]}
    by_joint = compiled.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)
    tied |= {int(j) for ids in (compiled.eq_obj1id, compiled.eq_obj2id) for j in ids[by_joint]}
    return set(range(compiled.njnt)) if bool(np.any(~by_joint)) else tied
