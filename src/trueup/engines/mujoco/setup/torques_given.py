# SPDX-License-Identifier: Apache-2.0
"""The torque at each joint of an arm whose motors are commanded, as a log that measured it would have it."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from trueup.articulated.wiring import commanded, control_of
from trueup.engines.mujoco.attributes import is_motor
from trueup.engines.mujoco.lone.drives import alone
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.motors import given
from trueup.engines.mujoco.wiring import joint_id
from trueup.errors import ModelError
from trueup.identification.kinematic_tree import KinematicTree
from trueup.instant import LOOKS
from trueup.recording import Recording
from trueup.trial import command_of


def torques_given(model: Model, recordings: Sequence[Recording]) -> tuple[KinematicTree | None, list[Recording]]:
    """The tree of an arm, and recordings with a channel of joint torques in place of commands. None and [] unless they tell
    those of all joints that they measure, of a model that is such a tree, and where it has contacts or stops of its own along
    what was measured: what pushes there it knows.
    """
    from trueup.identification.mjcf import tree_of  # which reads models by this package

    known = [told for r in recordings if (told := _given_in(model, r)) is not None] if alone(model.compiled, ()) else []
    if not known or len(known) < len(recordings) or any(_touches(model.compiled, r) for r in known):
        return None, []
    try:
        return tree_of(model.compiled, model.name), known
    except ModelError:
        return None, []


def _given_in(model: Model, recording: Recording) -> Recording | None:
    command, measured = command_of(recording), recording.channels.get("position")
    if command is None or measured is None:
        return None
    joints, columns = [], []
    for column, name in enumerate(commanded(model, command)):
        actuator, unit = model.index("actuator", name), command.unit_of(command.labels[column])
        if not is_motor(model.compiled, actuator) or unit not in ("N m", "N", ""):
            return None
        told = command.values[:, column]
        # Half of what a motor gave around an instant was told it before: a command is held until the next.
        around = np.stack([told, np.concatenate([told[:1], told[:-1]])])
        joints.append(model.names("joint")[model.compiled.actuator_trnid[actuator, 0]])
        columns.append(given(model.compiled, actuator, around * control_of(model, name, unit)).mean(axis=0))
    if set(measured.labels) != set(joints):
        return None
    slides = model.compiled.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    units = tuple("N" if slides[joint_id(model.compiled, j)] else "N m" for j in joints)
    torque = command.replace(
        name="torque", labels=tuple(joints), values=np.stack(columns, axis=1), unit="N m", units=units
    )
    return recording.without(command.name).with_channel(torque)


def _touches(compiled: mujoco.MjModel, recording: Recording) -> bool:
    """Whether the model meets anything, or an end of a joint, where the robot was."""
    data, measured = mujoco.MjData(compiled), recording.channel("position")
    places = [compiled.jnt_qposadr[joint_id(compiled, j)] for j in measured.labels]
    good = measured.values[np.isfinite(measured.values).all(axis=1)]
    met = (mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT, mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS,
           mujoco.mjtConstraint.mjCNSTR_CONTACT_PYRAMIDAL, mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC)  # fmt: skip
    for row in good[:: max(1, len(good) // LOOKS)]:
        data.qpos[places] = row
        mujoco.mj_fwdPosition(compiled, data)
        if np.isin(data.efc_type, met).any():
            return True
    return False
