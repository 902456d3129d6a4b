# SPDX-License-Identifier: Apache-2.0
"""Shapes that a model lacks for collision: capsules for links without any, a floor; and all shapes as capsules and boxes."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.model_files.urdf import DENSITY
from trueup.rounding import ROUNDED

_THIN, _THICK = 0.025, 0.15
PLATE = (20.0, 20.0, 1.0)
"""m: half sides of the plate that stands for a plane."""


def with_capsules(spec: mujoco.MjSpec, compiled: mujoco.MjModel) -> list[str]:
    """Adds a capsule to each group of welded bodies without a shape; says which."""
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    roots = compiled.body_weldid
    shaped = {int(roots[compiled.geom_bodyid[g]]) for g in solid(compiled)}
    # The fixed part may have shapes (a wall, a table) and the arm's own base none.
    base = [b for b in range(1, compiled.nbody) if roots[b] == 0 and not compiled.body_geomnum[b]]
    estimated = []
    for root in sorted({int(r) for r in roots[1:]}):
        if root in shaped and root != 0:
            continue
        children = [b for b in range(1, compiled.nbody) if roots[b] == b and roots[compiled.body_parentid[b]] == root]
        members = np.flatnonzero(roots == root)
        holder = int(root) if root else (int(compiled.body_parentid[children[0]]) if children and base else -1)
        if holder < 0:
            continue
        mass = float(compiled.body_mass[members].sum()) if root else 0.0
        ends = _ends(data, compiled, holder, children, members, root)
        for end in ends:
            _add_capsule(spec, compiled.body(holder).name, end, mass / len(ends))
        if ends:
            estimated.append(compiled.body(holder).name)
    if not estimated:
        return []
    return [
        f"shapes of {', '.join(estimated)} are estimated as capsules from joint to joint: the clearance there is a "
        "guess, keep a larger margin"
    ]


def _ends(
    data: mujoco.MjData,
    compiled: mujoco.MjModel,
    holder: int,
    children: Iterable[int],
    members: NDArray[np.intp],
    root: int,
) -> list[Array]:
    """Where the capsules of a part end, in the frame of its holder, in which all begin: at the joints that it carries.

    The last part of an arm reaches as far past its centre of mass as that is from its joint.
    """
    turn, origin = data.xmat[holder].reshape(3, 3), data.xpos[holder]
    ends = [turn.T @ (data.xpos[b] - origin) for b in children]
    if not ends and root:
        weights = compiled.body_mass[members]
        centre = (weights[:, None] * data.xipos[members]).sum(axis=0) / max(float(weights.sum()), ROUNDED)
        ends = [2.0 * turn.T @ (centre - origin)]
    return ends


def _add_capsule(spec: mujoco.MjSpec, body: str, end: Array, mass: float) -> None:
    """A capsule from the body's origin to `end` (a sphere where that is no way), as thick as its mass makes it."""
    length, geom = float(np.linalg.norm(end)), spec.body(body).add_geom()
    volume = mass / DENSITY
    geom.mass = 0.0
    if length < 0.02:
        radius = (0.75 * volume / np.pi) ** (1.0 / 3.0) if volume else 0.04
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [float(np.clip(radius, _THIN, _THICK)), 0.0, 0.0]
        return
    radius = float(np.clip(np.sqrt(volume / (np.pi * length)) if volume else 0.12 * length, _THIN, _THICK))
    geom.type, geom.size = mujoco.mjtGeom.mjGEOM_CAPSULE, [radius, 0.0, 0.0]
    geom.fromto = [0.0, 0.0, 0.0, *end]


def with_floor(spec: mujoco.MjSpec, compiled: mujoco.MjModel, floor: float | str | None) -> list[str]:
    """Adds a floor as a thick plate, unless the model has a plane; says where."""
    if floor is None:
        return ["no floor"]
    if any(int(compiled.geom_type[g]) == int(mujoco.mjtGeom.mjGEOM_PLANE) for g in solid(compiled)):
        return []
    height = _underside(compiled) if isinstance(floor, str) else float(floor)
    plate = spec.worldbody.add_geom()
    plate.name, plate.type = "floor", mujoco.mjtGeom.mjGEOM_BOX
    plate.size, plate.pos = list(PLATE), [0.0, 0.0, height - PLATE[2]]
    return [f"floor at {height:.3g} m" + (" (assumed; give another with --floor)" if isinstance(floor, str) else "")]


def _underside(compiled: mujoco.MjModel) -> float:
    """The lowest point of what stands fixed, the origin of the base included."""
    data = mujoco.MjData(compiled)
    mujoco.mj_kinematics(compiled, data)
    lowest = [float(data.xpos[b][2]) for b in range(compiled.nbody) if compiled.body_weldid[b] == 0]
    for g in solid(compiled):
        if compiled.body_weldid[compiled.geom_bodyid[g]] == 0:
            centre, half = compiled.geom_aabb[g, :3], compiled.geom_aabb[g, 3:]
            turn = data.geom_xmat[g].reshape(3, 3)
            lowest.append(float(data.geom_xpos[g][2] + turn[2] @ centre - np.abs(turn[2]) @ half))
    return min(lowest)


def solid(compiled: mujoco.MjModel) -> list[int]:
    """Geoms that can touch something."""
    return [g for g in range(compiled.ngeom) if compiled.geom_contype[g] or compiled.geom_conaffinity[g]]


def capsule(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> tuple[Array, Array, float]:
    """Both ends (3,) in the world and the radius [m] of a capsule about a geom; exact for capsules and spheres.

    Of others it is as long as their longest side, and as thick as the longer of the other two.
    """
    kind, turn = int(model.geom_type[geom]), data.geom_xmat[geom].reshape(3, 3)
    if kind in (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER)):
        radius, half = (float(x) for x in model.geom_size[geom, :2])
        along, middle = turn[:, 2] * half, data.geom_xpos[geom]
    else:
        sides, middle = model.geom_aabb[geom, 3:], data.geom_xpos[geom] + turn @ model.geom_aabb[geom, :3]
        longest = int(np.argmax(sides))
        radius = float(np.delete(sides, longest).max())
        along = turn[:, longest] * max(float(sides[longest]) - radius, 0.0)
    return middle - along, middle + along, radius


def box(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> tuple[Array, Array, Array]:
    """Centre (3,), rotation (3, 3) and half sides (3,) of the box about a geom, in the world."""
    turn = data.geom_xmat[geom].reshape(3, 3)
    if int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_PLANE):  # a plate below it
        return data.geom_xpos[geom] - PLATE[2] * turn[:, 2], turn, np.array(PLATE)
    return data.geom_xpos[geom] + turn @ model.geom_aabb[geom, :3], turn, np.array(model.geom_aabb[geom, 3:])
