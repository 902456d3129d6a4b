# SPDX-License-Identifier: Apache-2.0
"""Starts that keep a model's equality constraints: joints that nobody measured are put where loops close and mimics follow.

A log has the joints with encoders. Left at the model's rest, the passive joints of a four-bar linkage, or the second finger
of a gripper, would be torn to where they belong in the first steps, with a blow that no robot feels.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from math import ceil

import mujoco
import numpy as np

from trueup.arrays import Array, Integers
from trueup.rounding import ROUNDED

_STRIDE = 0.1
"""rad or m that measured joints go at a time on their way from the reference pose, where loops are closed: a linkage that
is taken there at once may close the other way round."""


class Linkages:
    """Puts the joints of one compiled model that were not measured where its constraints have them."""

    def __init__(self, compiled: mujoco.MjModel) -> None:
        self._model = copy.copy(compiled)
        self._model.opt.jacobian = int(mujoco.mjtJacobian.mjJAC_DENSE)
        self._data = mujoco.MjData(self._model)
        self._kept: dict[bytes, Array] = {}

    def close(self, rest: Array, qpos: Array, qvel: Array, placed: Sequence[int]) -> None:
        """States (b, nq) and (b, nv) changed in place, where a way leads there from `rest` (nq,); the joints `placed` stay.

        Rows that cannot be closed stay as they are: the simulator shows what becomes of them.
        """
        m = self._model
        fixed = np.isin(m.dof_jntid, list(placed))
        fixed |= m.jnt_type[m.dof_jntid] == int(mujoco.mjtJoint.mjJNT_FREE)
        own = np.flatnonzero(~fixed)
        if not m.neq or not own.size:
            return
        states, again = np.unique(np.concatenate([qpos, qvel], axis=1), axis=0, return_inverse=True)
        begin = self._walked(rest, states[0, : m.nq], own)
        for k, state in enumerate(states):  # rows hardly differ: from where the first one is closed it is one step
            rows = again.reshape(-1) == k
            qpos[rows], qvel[rows] = self._closed(begin, state[: m.nq], state[m.nq :], own)

    def _walked(self, rest: Array, qpos: Array, own: Integers) -> Array:
        """(nq,) where strides from the rest to the neighbourhood of a state lead; remembered, as many runs begin there."""
        way = _STRIDE * np.round(self._way(rest, qpos, own) / _STRIDE)
        key = way.tobytes() + own.tobytes()
        if key not in self._kept:
            at, strides = np.array(rest), ceil(float(np.max(np.abs(way), initial=0.0)) / _STRIDE)
            for _ in range(strides):
                mujoco.mj_integratePos(self._model, at, way, 1.0 / strides)
                self._newton(at, own)
            self._kept[key] = at
        return self._kept[key]

    def _closed(self, begin: Array, qpos: Array, qvel: Array, own: Integers) -> tuple[Array, Array]:
        at, speed = np.array(begin), np.array(qvel)
        mujoco.mj_integratePos(self._model, at, self._way(begin, qpos, own), 1.0)
        open_, slopes = self._newton(at, own)
        if not open_.size or np.max(np.abs(open_)) > ROUNDED:  # m or rad: what Newton's method comes to
            return qpos, qvel
        speed[own] -= _least(slopes[:, own], slopes @ speed)
        return at, speed

    def _way(self, begin: Array, qpos: Array, own: Integers) -> Array:
        """(nv,) from one state to another, but for the joints `own`."""
        way = np.empty(self._model.nv)
        mujoco.mj_differentiatePos(self._model, way, 1.0, begin, qpos)
        way[own] = 0.0
        return way

    def _newton(self, qpos: Array, own: Integers) -> tuple[Array, Array]:
        """How far constraints are open (c,), and their slopes (c, nv), once the joints `own` have closed them as far as steps
        lead on; in place.
        """
        move = np.zeros(self._model.nv)
        open_, slopes = self._constraints(qpos)
        before = np.inf
        while 1e-3 * ROUNDED <= (now := float(np.max(np.abs(open_), initial=0.0))) < before:
            move[own] = -_least(slopes[:, own], open_)
            mujoco.mj_integratePos(self._model, qpos, move, 1.0)
            before, (open_, slopes) = now, self._constraints(qpos)
        return open_, slopes

    def _constraints(self, qpos: Array) -> tuple[Array, Array]:
        m, d = self._model, self._data
        d.qpos[:] = qpos
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_tendon(m, d)
        mujoco.mj_makeConstraint(m, d)
        rows = d.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        return np.array(d.efc_pos[rows]), np.array(d.efc_J).reshape(-1, m.nv)[rows]


def _least(slopes: Array, change: Array) -> Array:
    """The least movement that changes constraints so: joints in no constraint stay."""
    return np.linalg.pinv(slopes, rcond=1e-9) @ change
