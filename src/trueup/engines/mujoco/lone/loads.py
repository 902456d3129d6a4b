# SPDX-License-Identifier: Apache-2.0
"""What each joint has to carry along a measured motion: inverse dynamics, without its own friction, armature and drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from trueup.arrays import Array, Integers
from trueup.articulated.assignments import Assignment, changes, write
from trueup.engines.mujoco.attributes import MujocoAttributes
from trueup.engines.mujoco.fields import SingleModel
from trueup.engines.mujoco.wiring import joint_id
from trueup.instant import moving_cubic, rate_noise, usual_step
from trueup.noise import estimate_noise
from trueup.recording import Channel

_STEP = float(np.sqrt(np.finfo(float).eps))
"""rad or m by which a joint is moved for the slope of its load: half of the digits are left of that."""


@dataclass(frozen=True)
class Motion:
    """A measured motion of a model's degrees of freedom, all (L, nv), at (L,) evenly spaced instants in s."""

    time: Array
    position: Array
    speed: Array
    acceleration: Array


@dataclass(frozen=True)
class Loads:
    """What the joints carry along a motion, all (L, nv): the inertia of each by itself, without armature, and the torque
    that all else asks of it.
    """

    position: Array
    inertia: Array
    torque: Array


class InverseDynamics:
    """A model whose joints, all hinges or slides, are moved as they were measured. What was computed is kept."""

    def __init__(self, compiled: mujoco.MjModel, quantities: Sequence[Assignment]) -> None:
        self._rigid = rigid(compiled)
        self._columns = [i for i, q in enumerate(quantities) if carried(q)]
        self._quantities = [quantities[i] for i in self._columns]
        self._motions: dict[int, tuple[Channel, Motion, Array]] = {}
        self._loads: dict[tuple[int, bytes], Loads] = {}
        self._references: dict[bytes, Array] = {}

    def sets(self, values: Array) -> tuple[Array, Integers]:
        """(g, k) values that load the joints differently, and (b,) which of them each row of values (b, n) has.

        Forgets what other sets gave.
        """
        sets, which = np.unique(values[:, self._columns], axis=0, return_inverse=True)
        known = {own.tobytes() for own in sets}
        self._loads = {key: loads for key, loads in self._loads.items() if key[1] in known}
        self._references = {key: inertia for key, inertia in self._references.items() if key in known}
        return sets, which.reshape(-1)

    def motion(self, measured: Channel, rest: Array) -> tuple[Motion, Array]:
        """A channel of positions as a motion, joints that it lacks at `rest` (nv,), and (L, nv) by how much the load of each
        joint grows with its own position.
        """
        if id(measured) not in self._motions:
            motion = measured_motion(self._rigid, measured, rest)
            # the channel is kept with it, so that its id stays its own
            self._motions[id(measured)] = measured, motion, _stiffness(self._rigid, motion)
        return self._motions[id(measured)][1:]

    def loads(self, measured: Channel, own: Array) -> Loads:
        """Along a channel whose `motion` is known, with one of the `sets` of values (k,)."""
        key = id(measured), own.tobytes()
        if key not in self._loads:
            motion = self._motions[id(measured)][1]
            position = motion.position - self._errors(own)
            inertia, torque = inverse_dynamics(self._written(own), position, motion.speed, motion.acceleration)
            self._loads[key] = Loads(position, inertia, torque - inertia * motion.acceleration)
        return self._loads[key]

    def reference(self, own: Array) -> Array:
        """(nv, nv) inertia matrix in the reference pose, without armature, with one of the `sets` of values (k,)."""
        if own.tobytes() not in self._references:
            model = self._written(own)
            data, inertia = mujoco.MjData(model), np.empty((model.nv, model.nv))
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, inertia)
            self._references[own.tobytes()] = inertia
        return self._references[own.tobytes()]

    def _written(self, own: Array) -> mujoco.MjModel:
        if not self._quantities:
            return self._rigid
        model = self._rigid.__copy__()
        write(self._quantities, own[None], MujocoAttributes(model, SingleModel(model)))
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def _errors(self, own: Array) -> Array:
        """(nv,) by how much each joint is measured too far."""
        errors = np.zeros(self._rigid.nv)
        for joint, (error,) in changes(self._quantities, own[None]).of("sensor").items():
            errors[joint_id(self._rigid, joint)] = error
        return errors


def carried(assignment: Assignment) -> bool:
    """Whether a parameter changes what joints carry: bodies, gravity, and where the joints are held to be."""
    quantity = assignment.quantity
    return "sensor" in quantity.signals or any(a.startswith(("body.", "world.gravity")) for a in quantity.attributes)


def rigid(compiled: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of the model without what its drives add, and without whatever it touches."""
    model = compiled.__copy__()
    model.dof_armature[:] = 0.0
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= int(off.mjDSBL_CONSTRAINT | off.mjDSBL_CONTACT | off.mjDSBL_DAMPER)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def measured_motion(compiled: mujoco.MjModel, measured: Channel, rest: Array) -> Motion:
    """Positions as a motion, joints that they lack at `rest` (nv,), by a moving cubic through the samples."""
    dt = usual_step(measured.time)
    count = int(np.floor((measured.time[-1] - measured.time[0]) / dt + 0.5)) + 1
    time = measured.time[0] + dt * np.arange(count)
    states = np.zeros((3, count, compiled.nv))
    states[0] = rest
    for label, column in zip(measured.labels, measured.values.T, strict=True):
        joint, good = joint_id(compiled, label), np.isfinite(column)
        if joint >= 0 and good.any():
            states[:, :, joint] = moving_cubic(np.interp(time, measured.time[good], column[good]), dt)
    return Motion(time, *states)


def speed_noise(measured: Channel) -> Array:
    """(k,) standard deviation of the speeds of a channel's labels in its `measured_motion`."""
    return rate_noise(usual_step(measured.time)) * estimate_noise(measured.values, measured.time)


def inverse_dynamics(model: mujoco.MjModel, places: Array, speeds: Array, rates: Array) -> tuple[Array, Array]:
    """(L, nv) diagonal of the inertia matrix, and torque, along a motion of positions, speeds and accelerations (L, nv)."""
    data = mujoco.MjData(model)
    inertia, torque = np.empty((2, len(places), model.nv))
    diagonal = model.M_rowadr + model.M_rownnz - 1
    for s in range(len(places)):
        data.qpos[:], data.qvel[:], data.qacc[:] = places[s], speeds[s], rates[s]
        mujoco.mj_inverse(model, data)
        torque[s], inertia[s] = data.qfrc_inverse, data.M[diagonal]
    return inertia, torque


def _stiffness(model: mujoco.MjModel, motion: Motion) -> Array:
    """(L, nv) by how much the torque of each joint grows with its own position."""
    _, torque = inverse_dynamics(model, motion.position, motion.speed, motion.acceleration)
    grown = np.empty_like(torque)
    for dof in range(model.nv):
        moved = motion.position.copy()
        moved[:, dof] += _STEP
        grown[:, dof] = inverse_dynamics(model, moved, motion.speed, motion.acceleration)[1][:, dof] - torque[:, dof]
    return grown / _STEP
