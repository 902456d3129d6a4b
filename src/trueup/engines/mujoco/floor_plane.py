# SPDX-License-Identifier: Apache-2.0
"""The plane that a robot stands on or works above: the model's own, or one that is added; moved, turned, slid on."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.articulated.pose import product

FLOOR = "calibrated_floor"
"""Name of the plane that is added to a model without one, and of a model's own that has no name."""
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


class Contact(NamedTuple):
    """What MuJoCo makes of two shapes that touch."""

    friction: Array
    """(3,) sliding, torsional, rolling."""
    condim: int
    solref: Array
    solimp: Array


def contact_with(compiled: mujoco.MjModel, plane: int) -> Contact:
    """The contact of a plane with what stands on it; its own where nothing does.

    Of two priorities the higher one rules; of equal ones the larger friction counts, and stiffness is between both
    (MuJoCo's documentation, Contact parameters).
    """
    m, foot = compiled, _standing(compiled, plane)
    first, second = int(m.geom_priority[plane]), int(m.geom_priority[foot]) if foot >= 0 else -1
    if foot < 0 or first != second:
        g = plane if foot < 0 or first > second else foot
        return Contact(m.geom_friction[g], int(m.geom_condim[g]), m.geom_solref[g], m.geom_solimp[g])
    both = [plane, foot]
    weights = m.geom_solmix[both] / m.geom_solmix[both].sum() if m.geom_solmix[both].any() else np.array([0.5, 0.5])
    direct = bool((m.geom_solref[both, 0] <= 0.0).any())
    solref = m.geom_solref[both].min(axis=0) if direct else weights @ m.geom_solref[both]
    friction, condim = m.geom_friction[both].max(axis=0), int(m.geom_condim[both].max())
    return Contact(friction, condim, solref, weights @ m.geom_solimp[both])


def rule(spec: mujoco.MjSpec, compiled: mujoco.MjModel) -> None:
    """Has the friction of the plane count in its contacts, which stay as they were: where the feet have some of their own, as
    much as the plane or more, a smaller one of the plane would change nothing. A plane without a name gets one.
    """
    plane = plane_of(compiled)
    if rules(compiled, plane):
        return
    geom, contact = next(g for g in spec.geoms if g.id == plane), contact_with(compiled, plane)
    highest = max(int(compiled.geom_priority[g]) for g in _touching(compiled, plane))
    geom.priority, geom.friction, geom.condim = highest + 1, contact.friction, contact.condim
    geom.solref, geom.solimp = contact.solref, contact.solimp
    geom.name = geom.name or FLOOR


def rules(m: mujoco.MjModel, plane: int) -> bool:
    """Whether all contacts of a plane have its own friction."""
    return all(m.geom_priority[plane] > m.geom_priority[g] for g in _touching(m, plane))


def _touching(m: mujoco.MjModel, plane: int) -> list[int]:
    """Shapes on moving bodies that a plane stops."""
    meets = (m.geom_contype & m.geom_conaffinity[plane]) | (m.geom_contype[plane] & m.geom_conaffinity)
    return np.flatnonzero((meets != 0) & (m.body_weldid[m.geom_bodyid] != 0)).tolist()


def _standing(m: mujoco.MjModel, plane: int) -> int:
    """The shape that a robot stands on: as it starts, the lowest of those on bodies that carry no others; -1 without any."""
    touching = _touching(m, plane)
    ends = [g for g in touching if not np.any(m.body_parentid[1:] == m.geom_bodyid[g])] or touching
    if not ends:
        return -1
    data = mujoco.MjData(m)
    if m.nkey:
        mujoco.mj_resetDataKeyframe(m, data, 0)
    mujoco.mj_kinematics(m, data)
    up = data.geom_xmat[plane].reshape(3, 3)[:, 2]
    return ends[int(np.argmin(data.geom_xpos[ends] @ up))]


def turned(own: Array, roll: Array, pitch: Array) -> Array:
    """(b, 4) quaternions of a plane that lies as `own` (4,) says, turned about the world's x, then about its y."""
    (cr, sr), (cp, sp) = ((np.cos(0.5 * a), np.sin(0.5 * a)) for a in (roll, pitch))
    return product(np.stack([cp * cr, cp * sr, sp * cr, -sp * sr], axis=-1), np.tile(own, (len(roll), 1)))
