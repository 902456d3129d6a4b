# SPDX-License-Identifier: Apache-2.0
"""Commands of servos without a unit (see `inspection.commanded_units`), by what the servos of a model follow."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.scales import ways
from trueup.inspection import commanded_units
from trueup.recording import Recording


def with_commands_told(
    model: Model, recordings: Sequence[Recording], refuse: Collection[str] = ()
) -> tuple[list[Recording], list[str]]:
    """See `inspection.commanded_units.in_units_of_positions`. Raises RecordingError for commands that are no rad all the
    same, unless it is refused to ask.
    """
    known = ways(model), _servos(model)
    told, notes = commanded_units.in_units_of_positions(*known, recordings, partial(_weights, model))
    if "commands" not in refuse:
        commanded_units.check_commanded(*known, told, partial(_weights, model))
    return told, notes


def _servos(model: Model) -> dict[str, str]:
    """Labels of commands to the joints whose positions they are: of servos that are told in the joint's own unit, by their
    names and their joints'; of a model without actuators all joints.
    """
    m, found = model.compiled, {}
    if not m.nactuator:
        return {joint: joint for joint in model.scalar_joints()}
    names = model.names("actuator")
    for joint, i in model.actuator_of_joint().items():
        if model.is_position_servo(i) and np.isclose(abs(m.actuator_gear[i, 0]), 1.0):
            found |= {joint: joint, names[i]: joint}
    return found


def _weights(model: Model, recording: Recording) -> Mapping[str, Array]:
    """By joint, (T,) torque with which the robot's weight pulls at measured positions; {} of one whose base is free."""
    position, m = recording.channel("position"), model.compiled
    joints = [x for x in position.labels if x in model.scalar_joints()]
    if free_joint(m) >= 0 or not joints:
        return {}
    data, ids = mujoco.MjData(m), [model.index("joint", x) for x in joints]
    values, pulls = position.select(joints).values, np.full((len(position.time), len(joints)), np.nan)
    for k in np.flatnonzero(np.isfinite(values).all(axis=1)):
        data.qpos[m.jnt_qposadr[ids]] = values[k]
        mujoco.mj_kinematics(m, data)
        mujoco.mj_comPos(m, data)
        mujoco.mj_crb(m, data)
        mujoco.mj_rne(m, data, 0, pull := np.zeros(m.nv))
        pulls[k] = pull[m.jnt_dofadr[ids]]
    return dict(zip(joints, pulls.T, strict=True))
