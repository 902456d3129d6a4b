# SPDX-License-Identifier: Apache-2.0
"""Which command drives which actuator, and which channel is read from where: a trial's names tied to a model's."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.articulated.pose import ANGLES, AXES, ORIENTATION, POSITION
from trueup.articulated.starts import slope_knows_better, starting_point
from trueup.engines.mujoco.base import columns_of, place
from trueup.engines.mujoco.model import Model
from trueup.errors import ModelError, unknown_name
from trueup.recording import Channel
from trueup.trial import Trial

Array = NDArray[np.float64]

JOINT_CHANNELS = {"position": "qpos", "velocity": "qvel", "torque": "qfrc_actuator"}
"""Channels whose labels are joints, and the field that holds them."""
_AXES = {"x": 0, "y": 1, "z": 2, "0": 0, "1": 1, "2": 2, "3": 3, "w": 0}


@dataclass(frozen=True, eq=False)
class Source:
    """Where a channel's columns are read: `field[:, columns] + field[:, second]` (second: the gap of a slack joint)."""

    field: str
    columns: NDArray[np.int64]
    second: NDArray[np.int64] | None
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

    Raises UnknownNameError for a label that is no joint of the model.
    """
    if channel in JOINT_CHANNELS:
        joints = [_joint(model, compiled, channel, label) for label in labels]
        field = JOINT_CHANNELS[channel]
        address = compiled.jnt_qposadr if field == "qpos" else compiled.jnt_dofadr
        columns = np.array([address[j] for j in joints], dtype=np.int64)
        slack = [joint_id(compiled, f"{label}/slack") for label in labels]
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


def _joint(model: Model, compiled: mujoco.MjModel, channel: str, label: str) -> int:
    found = joint_id(compiled, label)
    if found < 0 or label not in model.scalar_joints():
        raise unknown_name(
            "joint", label, model.scalar_joints(),
            f"the model (channel '{channel}'; rename the recording's joints in the mapping's [joints] table)",
        )  # fmt: skip
    return found


def _sensor_column(compiled: mujoco.MjModel, label: str) -> int | None:
    """A sensor's value by 'name' (one number) or 'name.x', 'name_x', 'name[0]'."""
    found = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_SENSOR, label)
    if found >= 0:
        return int(compiled.sensor_adr[found]) if compiled.sensor_dim[found] == 1 else None
    for separator in (".", "_", "["):
        name, _, axis = label.rstrip("]").rpartition(separator)
        found = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_SENSOR, name) if name else -1
        if found >= 0 and axis in _AXES and _AXES[axis] < compiled.sensor_dim[found]:
            return int(compiled.sensor_adr[found]) + _AXES[axis]
    return None


def actuators_of(model: Model, command: Channel) -> list[int]:
    """The actuator of each command label: its own name, or the joint that it drives. Raises UnknownNameError."""
    by_joint = model.actuator_of_joint()
    names = model.names("actuator")
    if not any(names) and not by_joint:
        raise ModelError(
            f"model '{model.path.name}' has no actuators, so the commands of '{', '.join(command.labels)}' drive "
            "nothing; add <position> or <motor> actuators to it"
        )
    found = []
    for label in command.labels:
        if label in by_joint:
            found.append(by_joint[label])
        elif label in names:
            found.append(names.index(label))
        else:
            raise unknown_name(
                "actuator", label, {*(n for n in names if n), *by_joint},
                "the model (rename the recording's joints in the mapping's [joints] table)",
            )  # fmt: skip
    return found


def is_motor(compiled: mujoco.MjModel, actuator: int) -> bool:
    """True where the actuator's force is a constant times its control: a torque command, by its gear and gain."""
    plain = int(compiled.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_NONE)
    fixed = int(compiled.actuator_gaintype[actuator]) == int(mujoco.mjtGain.mjGAIN_FIXED)
    return plain and fixed and int(compiled.actuator_dyntype[actuator]) == int(mujoco.mjtDyn.mjDYN_NONE)


def control_of(compiled: mujoco.MjModel, actuator: int, unit: str) -> float:
    """What a command in `unit` is multiplied by to become the control of an actuator: a motor's gear and gain taken out
    of a torque, 1 for anything else.
    """
    if unit not in ("N m", "N") or not is_motor(compiled, actuator):
        return 1.0
    whole = float(compiled.actuator_gear[actuator, 0] * compiled.actuator_gainprm[actuator, 0])
    return 1.0 / whole if whole else 1.0


def start_state(model: Model, compiled: mujoco.MjModel, trial: Trial) -> tuple[Array, Array]:
    """(nq,), (nv,) at the trial's start.

    Measured joints come from the recording, the rest from the model's first keyframe (or its reference pose).
    """
    qpos = np.array(compiled.key_qpos[0] if compiled.nkey else compiled.qpos0, dtype=np.float64)
    qvel = np.array(compiled.key_qvel[0] if compiled.nkey else np.zeros(compiled.nv), dtype=np.float64)
    _place_base(compiled, qpos, qvel, trial)
    position, velocity = trial.initial.get("position"), trial.initial.get("velocity")
    if position is not None:
        value, slope = starting_point(position, trial.start)
        for label, q, v in zip(position.labels, value, slope, strict=True):
            joint = joint_id(compiled, label)
            if joint >= 0 and np.isfinite(q):
                qpos[compiled.jnt_qposadr[joint]] = q
                qvel[compiled.jnt_dofadr[joint]] = v if np.isfinite(v) else 0.0
    if velocity is not None and velocity.unit:
        value, _ = starting_point(velocity, trial.start)
        for label, v in zip(velocity.labels, value, strict=True):
            joint = joint_id(compiled, label)
            if joint >= 0 and np.isfinite(v) and not slope_knows_better(position, velocity, label, trial.start):
                qvel[compiled.jnt_dofadr[joint]] = v
    return qpos, qvel


def _place_base(compiled: mujoco.MjModel, qpos: Array, qvel: Array, trial: Trial) -> None:
    """The pose of a free base, where it was measured as `base.in_angles` has it."""
    position, orientation = trial.initial.get(POSITION), trial.initial.get(ORIENTATION)
    if position is not None and orientation is not None and orientation.labels == ANGLES:
        at = position.select(AXES)
        place(compiled, qpos, qvel, (*starting_point(at, trial.start), *starting_point(orientation, trial.start)))
