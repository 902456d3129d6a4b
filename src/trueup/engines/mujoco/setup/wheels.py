# SPDX-License-Identifier: Apache-2.0
"""Wheels and casters that nothing drives, told by their shape: they roll with the robot, though no recording has them."""

from __future__ import annotations

import mujoco
import numpy as np

_ROUND = 0.05
"""Share of its radius by which a wheel is no circle: as polygons of twelve corners, of which meshes often are, 3 %."""


def rolling(compiled: mujoco.MjModel) -> set[int]:
    """Joints of wheels, and of the forks of casters: hinges without limits that turn what is round about them and may touch
    something, or that carry such a hinge.
    """
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    free = (compiled.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE)) & (compiled.jnt_limited == 0)
    hinges = {int(j) for j in np.flatnonzero(free)}
    wheels = {j for j in hinges if _turns_a_wheel(compiled, data, j)}
    return wheels | {j for j in hinges if any(_carries(compiled, j, int(compiled.jnt_bodyid[w])) for w in wheels)}


def _carries(compiled: mujoco.MjModel, joint: int, body: int) -> bool:
    """Whether a joint is between a body and the one that carries it, with nothing else that moves between them."""
    below = compiled.body_parentid[compiled.body_weldid[body]]
    return int(compiled.body_weldid[below]) == int(compiled.jnt_bodyid[joint])


def _turns_a_wheel(compiled: mujoco.MjModel, data: mujoco.MjData, joint: int) -> bool:
    """Whether all that may touch something on the body of a hinge is round about its axis, and nothing hangs on that."""
    if any(_carries(compiled, joint, int(body)) for body in compiled.jnt_bodyid):
        return False
    on = compiled.body_weldid[compiled.geom_bodyid] == compiled.jnt_bodyid[joint]
    shapes = np.flatnonzero(on & ((compiled.geom_contype != 0) | (compiled.geom_conaffinity != 0)))
    return len(shapes) > 0 and all(_is_round(compiled, data, joint, int(geom)) for geom in shapes)


def _is_round(compiled: mujoco.MjModel, data: mujoco.MjData, joint: int, geom: int) -> bool:
    """Whether a shape stays as it is when it turns about a joint's axis, by the box around it."""
    kind, frame = int(compiled.geom_type[geom]), data.geom_xmat[geom].reshape(3, 3)
    axis = frame.T @ data.xaxis[joint]
    along = int(np.argmax(np.abs(axis)))
    first, second = np.delete(compiled.geom_aabb[geom, 3:], along)
    offset = data.geom_xpos[geom] + frame @ compiled.geom_aabb[geom, :3] - data.xanchor[joint]
    beside = float(np.linalg.norm(np.cross(data.xaxis[joint], offset)))
    if kind == int(mujoco.mjtGeom.mjGEOM_SPHERE):
        aligned = True
    else:
        aligned = kind != int(mujoco.mjtGeom.mjGEOM_BOX) and abs(axis[along]) > 1.0 - _ROUND
    return bool(aligned and max(beside, abs(first - second)) < _ROUND * max(first, second))
