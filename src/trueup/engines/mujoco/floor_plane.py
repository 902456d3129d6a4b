# SPDX-License-Identifier: Apache-2.0
"""The plane that a robot stands on or works above: the model's own, or one that is added; moved and turned."""

from __future__ import annotations

import mujoco
import numpy as np

from trueup.arrays import Array

FLOOR = "calibrated_floor"
"""Name of the plane that is added to a model without one."""
FLOOR_FRICTION = 0.3
"""Sliding friction of an added floor before it is calibrated: plastic on wood or lacquer."""


def plane_of(compiled: mujoco.MjModel) -> int:
    """The first plane fixed to the world that things can touch; -1 if there is none."""
    for g in range(compiled.ngeom):
        solid = compiled.geom_contype[g] or compiled.geom_conaffinity[g]
        if solid and compiled.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE and compiled.geom_bodyid[g] == 0:
            return g
    return -1


def add_floor(spec: mujoco.MjSpec) -> None:
    """Adds a plane at the origin's height, whose own friction counts in its contacts."""
    plane = spec.worldbody.add_geom()
    plane.name, plane.type = FLOOR, mujoco.mjtGeom.mjGEOM_PLANE
    plane.size, plane.priority, plane.group = [0.0, 0.0, 0.1], 1, 0
    plane.friction = [FLOOR_FRICTION, 0.005, 0.0001]
    plane.contype, plane.conaffinity, plane.condim = 1, 1, 3


def turned(own: Array, roll: Array, pitch: Array) -> Array:
    """(b, 4) quaternions of a plane that lies as `own` (4,) says, turned about the world's x, then about its y."""
    (cr, sr), (cp, sp) = ((np.cos(0.5 * a), np.sin(0.5 * a)) for a in (roll, pitch))
    out = np.empty((len(roll), 4))
    for row, turn in zip(out, np.stack([cp * cr, cp * sr, sp * cr, -sp * sr], axis=-1), strict=True):
        mujoco.mju_mulQuat(row, turn, own)
    return out
