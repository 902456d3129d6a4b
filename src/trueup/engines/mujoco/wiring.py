# SPDX-License-Identifier: Apache-2.0
"""Which channel is read from where, and where runs start: a trial's names tied to a compiled model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from trueup.arrays import Array, Integers
from trueup.articulated.pose import ORIENTATION, POSITION
from trueup.articulated.starts import measured_base
from trueup.articulated.wiring import actuators_named, commanded
from trueup.engines.mujoco.attributes import is_motor as is_motor
from trueup.engines.mujoco.base import columns_of, free_joint, place
from trueup.engines.mujoco.gears import SECOND, SLACK
from trueup.engines.mujoco.model import Model
from trueup.errors import unknown_name
from trueup.recording import Channel
from trueup.trial import Trial

JOINT_CHANNELS = {"position": "qpos", "velocity": "qvel", "torque": "qfrc_actuator"}
"""Channels whose labels are joints, and the field that holds them."""
_SETTLES = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))


@dataclass(frozen=True, eq=False)
class Source:
    """Where a channel's columns are read: `field[:, columns] + field[:, second]` (second: the gap of a slack joint)."""

    field: str
    columns: Integers
    second: Integers | None
    derived: bool
    """Derived fields describe the state before the step, states the one after it."""
    turned: bool = False
    """Whether the columns are a quaternion, of which angles are compared."""

    def read(self, history: Array) -> Array:
        """(b, m, k) of the recorded field (b, m, size)."""
        picked = history[:, :, self.columns]
        if self.second is not None:
            has = self.second >= 0
            picked[:, :, has] += history[:, :, self.second[has]]
        return picked


def joint_id(compiled: mujoco.MjModel, name: str) -> int:
    """Id of a joint in a compiled model, -1 if there is none."""
    return int(mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_JOINT, name))


def source_of(model: Model, compiled: mujoco.MjModel, channel: str, labels: tuple[str, ...]) -> Source | None:
    """Where `channel` is found, or None where the simulator has no such signal.

    Raises UnknownNameError for a label that is no joint, or no actuator, of the model.
    """
    if channel == "command":  # as it arrives at the drives, in the actuators' own units
        columns = [model.columns()[name] for name in actuators_named(model, labels)]
        return Source("ctrl", np.array(columns, dtype=np.int64), None, derived=True)
    if channel in JOINT_CHANNELS:
        joints = [_joint(model, compiled, channel, label) for label in labels]
        field = JOINT_CHANNELS[channel]
        address = compiled.jnt_qposadr if field == "qpos" else compiled.jnt_dofadr
        columns = np.array([address[j] for j in joints], dtype=np.int64)
        slack = [joint_id(compiled, label + SLACK) for label in labels]
        second = np.array([address[j] if j >= 0 else -1 for j in slack], dtype=np.int64)
        with_slack = bool((second >= 0).any()) and field != "qfrc_actuator"
        return Source(field, columns, second if with_slack else None, derived=field == "qfrc_actuator")
    pose = columns_of(compiled, channel, labels)
    if pose is not None:
        return Source("qpos", np.array(pose, dtype=np.int64), None, derived=False, turned=channel == ORIENTATION)
    found = [_sensor_column(compiled, label) for label in labels]
    if any(c is None for c in found):
        return None
    return Source("sensordata", np.array(found, dtype=np.int64), None, derived=True)


def known_signals(model: Model) -> list[str]:
    """Names of all channels that the simulator has."""
    base = [POSITION, ORIENTATION] if free_joint(model.compiled) >= 0 else []
    return [*JOINT_CHANNELS, *base, *filter(None, model.names("sensor"))]


def _joint(model: Model, compiled: mujoco.MjModel, channel: str, label: str) -> int:
    found = joint_id(compiled, label)
    if found < 0 or label not in model.scalar_joints():
        raise unknown_name(
            "joint", label, model.scalar_joints(),
            f"the model (channel '{channel}'; rename the recording's joints in the mapping's [joints] table)",
        )  # fmt: skip
    return found


def _sensor_column(compiled: mujoco.MjModel, label: str) -> int | None:
    """A sensor's value by 'name' (one number) or 'name.x', 'name_x', 'name[0]'; a quaternion's are w, x, y, z."""
    found = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_SENSOR, label)
    if found >= 0:
        return int(compiled.sensor_adr[found]) if compiled.sensor_dim[found] == 1 else None
    for separator in (".", "_", "["):
        name, _, axis = label.rstrip("]").rpartition(separator)
        found = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_SENSOR, name) if name else -1
        if found >= 0 and axis:
            width = int(compiled.sensor_dim[found])
            names = (*("wxyz" if width == len("wxyz") else "xyz"),)
            place = int(axis) if axis.isdecimal() else names.index(axis) if axis in names else width
            if place < width:
                return int(compiled.sensor_adr[found]) + place
    return None


def actuators_of(model: Model, command: Channel) -> list[int]:
    """The actuator of each command label: its own name, or the joint that it drives. Raises UnknownNameError."""
    return [model.index("actuator", name) for name in commanded(model, command)]


def is_speed_servo(m: mujoco.MjModel, actuator: int) -> bool:
    """True where an actuator is a servo of speed: force = kv (command - velocity)."""
    affine = int(m.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
    gain, (_, stiffness, damping) = m.actuator_gainprm[actuator, 0], m.actuator_biasprm[actuator, :3]
    plain = int(m.actuator_dyntype[actuator]) == int(mujoco.mjtDyn.mjDYN_NONE)
    return bool(affine and plain and stiffness == 0.0 and gain > 0.0 and np.isclose(gain, -damping))


def takes(m: mujoco.MjModel, actuator: int, *, speeds: bool) -> bool:
    """Whether what a drive is told may be a speed, or a position: its force then hangs on how far the joint is from there,
    and a set point that an integrator makes of speeds (<intvelocity>) is none that may be told. Torques, pressures,
    excitations of muscles and coefficients of dampers are neither. Plugins take what they will.
    """
    if m.actuator_plugin[actuator] >= 0 or int(m.actuator_gaintype[actuator]) == int(mujoco.mjtGain.mjGAIN_PID):
        return True
    fixed = int(m.actuator_gaintype[actuator]) == int(mujoco.mjtGain.mjGAIN_FIXED)
    affine = int(m.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
    towards = bool(fixed and affine and m.actuator_biasprm[actuator, 1] != 0.0)
    integrates = int(m.actuator_dyntype[actuator]) == int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
    return is_speed_servo(m, actuator) or (towards and integrates) if speeds else towards and not integrates


def rest(compiled: mujoco.MjModel) -> tuple[Array, Array]:
    """(nq,), (nv,) from which a run begins where nothing was measured: the first keyframe, or the reference pose."""
    if compiled.nkey:
        return np.array(compiled.key_qpos[0], dtype=np.float64), np.array(compiled.key_qvel[0], dtype=np.float64)
    return np.array(compiled.qpos0, dtype=np.float64), np.zeros(compiled.nv)


def start_state(compiled: mujoco.MjModel, trial: Trial) -> tuple[Array, Array]:
    """(nq,), (nv,) at the trial's start but for its joints."""
    qpos, qvel = rest(compiled)
    base = measured_base(trial)
    if base is not None:
        place(compiled, qpos, qvel, base)
    return qpos, qvel


def addresses(compiled: mujoco.MjModel, joints: Sequence[str]) -> tuple[Integers, Integers]:
    """Where joints have their positions and their speeds."""
    ids = [joint_id(compiled, j) for j in joints]
    return compiled.jnt_qposadr[ids], compiled.jnt_dofadr[ids]


def placed_joints(compiled: mujoco.MjModel, trial: Trial, joints: Sequence[str]) -> list[int]:
    """Numbers of the joints that begin a trial where they were measured, and of those that are a gear's play or twist."""
    position = trial.initial.get("position")
    measured = () if position is None else [j for j in joints if j in position.labels]
    inner = [name + suffix for name in joints for suffix in SECOND.values()]
    return [j for name in (*measured, *inner) if (j := joint_id(compiled, name)) >= 0]


def activations(model: Model, first: Array, start: Array) -> Array:
    """(b, na) at the start: filters have settled at the first command (b, nu), integrators where the joint is (b, k)."""
    m, act = model.compiled, np.zeros((len(first), model.compiled.na))
    actuators = model.actuator_of_joint()
    for k, joint in enumerate(model.drives()):
        i = actuators.get(joint, -1)
        if i < 0 or m.actuator_actnum[i] != 1:
            continue
        if int(m.actuator_dyntype[i]) in _SETTLES:
            act[:, m.actuator_actadr[i]] = first[:, m.actuator_ctrladr[i]]
        elif int(m.actuator_dyntype[i]) == int(mujoco.mjtDyn.mjDYN_INTEGRATOR):
            act[:, m.actuator_actadr[i]] = start[:, k]
    return act
