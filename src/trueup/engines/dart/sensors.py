# SPDX-License-Identifier: Apache-2.0
"""The sensors of a model file on a robot that DART moves.

What follows from positions and speeds, MuJoCo's own sensors tell of DART's state: gyros, frames, joints. Accelerations
and the drives' forces are DART's. Forces between bodies and on shapes are not offered.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from trueup.arrays import Array

_SENSOR, _STAGE = mujoco.mjtSensor, mujoco.mjtStage
_OWN = (int(_SENSOR.mjSENS_ACCELEROMETER), int(_SENSOR.mjSENS_ACTUATORFRC), int(_SENSOR.mjSENS_JOINTACTFRC))
_OF_MASSES = [int(getattr(_SENSOR, f"mjSENS_{n}")) for n in
              ("SUBTREECOM", "SUBTREELINVEL", "SUBTREEANGMOM", "E_POTENTIAL", "E_KINETIC")]  # fmt: skip
"""They would tell of the file's masses, not of those that a calibration writes."""
_AXES = ("x", "y", "z")


def offered(model: mujoco.MjModel) -> dict[str, tuple[str, ...]]:
    """Names of the sensors that can be had, each to its labels: its name, or 'name.x', or 'name[0]'."""
    found = {}
    for i in range(model.nsensor):
        name, kind, size = model.sensor(i).name, int(model.sensor_type[i]), int(model.sensor_dim[i])
        moving = int(model.sensor_needstage[i]) in (int(_STAGE.mjSTAGE_POS), int(_STAGE.mjSTAGE_VEL))
        if name and (kind in _OWN or (moving and kind not in _OF_MASSES)):
            parts = [f"{name}.{a}" for a in _AXES] if size == 3 else [f"{name}[{k}]" for k in range(size)]
            found[name] = (name,) if size == 1 else tuple(parts)
    return found


class Sensors:
    """Of robots of one model, `joints` in the order in which their states are told."""

    def __init__(self, model: mujoco.MjModel, joints: Sequence[str], robots: Sequence[Any]) -> None:
        self._model, self._robots = model.__copy__(), robots
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self._data = mujoco.MjData(self._model)
        ids = [model.joint(j).id for j in joints]
        self._places, self._dofs = model.jnt_qposadr[ids], model.jnt_dofadr[ids]
        self._joint_of = {number: column for column, number in enumerate(ids)}
        self.columns = {n: slice(a, a + d) for n in offered(model) for a, d in (self._place(n),)}
        """Sensor to its columns of what `read` gives."""

    def read(
        self, position: Array, velocity: Array, force: Array, gravity: Array, base: Mapping[str, Array] | None
    ) -> Array:
        """(b, all) of joints (b, k), gravity (b, 3) and a free base's 'qpos' (b, 7) and 'qvel' (b, 6)."""
        model, data = self._model, self._data
        seen = np.zeros((len(position), model.nsensordata))
        for row in range(len(position)):
            data.qpos[self._places], data.qvel[self._dofs] = position[row], velocity[row]
            if base is not None:
                data.qpos[:7], data.qvel[:6] = base["qpos"][row], base["qvel"][row]
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_sensorPos(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_sensorVel(model, data)
            seen[row] = data.sensordata
            for name, columns in self.columns.items():
                own = self._reading(name, row, force[row], gravity[row])
                if own is not None:
                    seen[row, columns] = own
        return seen

    def _reading(self, name: str, row: int, force: Array, gravity: Array) -> Array | float | None:
        """What DART says of a sensor, None where MuJoCo has said it."""
        model, sensor = self._model, self._model.sensor(name)
        kind, number = int(sensor.type[0]), int(sensor.objid[0])
        if kind == int(_SENSOR.mjSENS_ACCELEROMETER):
            node = self._robots[row].getBodyNode(model.body(int(model.site_bodyid[number])).name)
            felt = np.asarray(node.getLinearAcceleration(model.site_pos[number])) - gravity
            return self._data.site_xmat[number].reshape(3, 3).T @ felt
        if kind == int(_SENSOR.mjSENS_JOINTACTFRC):
            return force[self._joint_of[number]] if number in self._joint_of else 0.0
        if kind == int(_SENSOR.mjSENS_ACTUATORFRC):
            joint = self._joint_of.get(int(model.actuator_trnid[number, 0]))
            return 0.0 if joint is None else force[joint] / model.actuator_gear[number, 0]
        return None

    def _place(self, name: str) -> tuple[int, int]:
        sensor = self._model.sensor(name)
        return int(sensor.adr[0]), int(sensor.dim[0])
