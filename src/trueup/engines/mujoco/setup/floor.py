# SPDX-License-Identifier: Apache-2.0
"""How low a robot reaches, from the shapes of its model: what the look for a floor needs to know."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.engines.mujoco.floor_plane import plane_of
from trueup.engines.mujoco.model import Model


def reach_of(model: Model) -> Reach | None:
    """How low the robot reaches; None for a model that has a floor, that does not stand fixed, or has no shapes."""
    m = model.compiled
    if plane_of(m) >= 0 or np.any(m.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        return None
    reach = Reach(model)
    return reach if reach.clouds else None


class Reach:
    """Points that span the solid shapes on moving bodies, each with a radius (see `inspection.floor.Heights`)."""

    def __init__(self, model: Model) -> None:
        compiled = model.compiled
        self.model, self._data = compiled, mujoco.MjData(compiled)
        free = np.flatnonzero(compiled.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
        self._base = int(compiled.jnt_qposadr[free[0]]) if len(free) else 0
        plane = plane_of(compiled)
        mujoco.mj_kinematics(compiled, self._data)
        self._up = self._data.geom_xmat[plane, 2::3].copy() if plane >= 0 else np.array([0.0, 0.0, 1.0])
        self._floor = float(self._up @ self._data.geom_xpos[plane]) if plane >= 0 else 0.0
        self.joints = model.scalar_joints()
        self._address = {j: int(compiled.jnt_qposadr[model.index("joint", j)]) for j in self.joints}
        self.clouds = [
            (g, *_points(compiled, g))
            for g in range(compiled.ngeom)
            if (compiled.geom_contype[g] or compiled.geom_conaffinity[g])
            and compiled.body_weldid[compiled.geom_bodyid[g]] != 0
        ]

    def lowest(self, labels: Sequence[str], poses: Array, bases: Array | None = None) -> Array:
        """(T,) height of the lowest point in m, over the plane if there is one, at positions (T, k) of these joints, with a
        free base at `bases` (T, 7): x, y, z in m and a quaternion.
        """
        data, up, found = self._data, self._up, np.empty(len(poses))
        address = [self._address[label] for label in labels]
        for i, pose in enumerate(poses):
            data.qpos[:] = self.model.qpos0
            data.qpos[address] = pose
            if bases is not None:
                data.qpos[self._base : self._base + 7] = bases[i]
            mujoco.mj_kinematics(self.model, data)
            found[i] = min(
                float((points @ (up @ data.geom_xmat[g].reshape(3, 3))).min() + up @ data.geom_xpos[g] - radius)
                for g, points, radius in self.clouds
            )
        return found - self._floor


def _points(m: mujoco.MjModel, geom: int) -> tuple[Array, float]:
    """(n, 3) points in the geom's frame and a radius about each, which together hold its shape."""
    kind, size = int(m.geom_type[geom]), m.geom_size[geom]
    types = mujoco.mjtGeom
    if kind == types.mjGEOM_SPHERE:
        return np.zeros((1, 3)), float(size[0])
    if kind == types.mjGEOM_CAPSULE:
        return np.array([[0.0, 0.0, size[1]], [0.0, 0.0, -size[1]]]), float(size[0])
    if kind == types.mjGEOM_CYLINDER:
        angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
        ring = np.stack([size[0] * np.cos(angle), size[0] * np.sin(angle), np.full(16, size[1])], axis=1)
        return np.concatenate([ring, ring * [1.0, 1.0, -1.0]]), 0.0
    if kind == types.mjGEOM_MESH:
        mesh = int(m.geom_dataid[geom])
        vertices = m.mesh_vert[m.mesh_vertadr[mesh] : m.mesh_vertadr[mesh] + m.mesh_vertnum[mesh]]
        graph = int(m.mesh_graphadr[mesh])
        if graph >= 0:  # of a hull: its number of vertices, of faces, then offsets, then which vertices they are
            count = int(m.mesh_graph[graph])
            vertices = vertices[m.mesh_graph[graph + 2 + count : graph + 2 + 2 * count]]
        return np.asarray(vertices, dtype=np.float64), 0.0
    centre, half = m.geom_aabb[geom, :3], m.geom_aabb[geom, 3:]
    corners = np.array(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0])).reshape(3, -1).T
    return centre + corners * half, 0.0
