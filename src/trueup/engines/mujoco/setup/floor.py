# SPDX-License-Identifier: Apache-2.0
"""How low a robot reaches, from the shapes of its model: what the look for a floor needs to know."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np

from trueup.arrays import Array, Integers
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
        found = np.empty(len(poses))
        for i in self._posed(labels, poses, bases):
            found[i] = min(self._lowest_of(k)[0] for k in range(len(self.clouds)))
        return found - self._floor

    def steps(self, labels: Sequence[str], poses: Array, bases: Array) -> tuple[Array, Array, Integers]:
        """(T - 1, 3) in m, how the point of the robot that is lowest moves from each pose to the next (see `lowest`): the
        mean of where the one that was lowest goes, and of where the next one comes from. A foot that rolls does not move.
        (T,) its height, and (T,) the body that it is of.
        """
        geoms = [g for g, _, _ in self.clouds]
        places, frames = np.empty((len(poses), len(geoms), 3)), np.empty((len(poses), len(geoms), 3, 3))
        which, points, low = np.empty(len(poses), dtype=np.int64), np.empty((len(poses), 3)), np.empty(len(poses))
        for i in self._posed(labels, poses, bases):
            places[i], frames[i] = self._data.geom_xpos[geoms], self._data.geom_xmat[geoms].reshape(-1, 3, 3)
            each = [self._lowest_of(k) for k in range(len(geoms))]
            which[i] = np.argmin([height for height, _ in each])
            low[i], points[i] = each[which[i]]

        def at(rows: Integers, shapes: Integers, own: Array) -> Array:
            return places[rows, shapes] + np.einsum("tij,tj->ti", frames[rows, shapes], own)

        now, then = np.arange(len(poses) - 1), np.arange(1, len(poses))
        ahead = at(then, which[now], points[now]) - at(now, which[now], points[now])
        moved = 0.5 * (ahead + at(then, which[then], points[then]) - at(now, which[then], points[then]))
        return moved, low - self._floor, self.model.geom_bodyid[np.array(geoms)[which]]

    def _posed(self, labels: Sequence[str], poses: Array, bases: Array | None) -> Iterator[int]:
        """Each pose's number, with the robot in it."""
        data, address = self._data, [self._address[label] for label in labels]
        for i, pose in enumerate(poses):
            data.qpos[:] = self.model.qpos0
            data.qpos[address] = pose
            if bases is not None:
                data.qpos[self._base : self._base + 7] = bases[i]
            mujoco.mj_kinematics(self.model, data)
            yield i

    def _lowest_of(self, cloud: int) -> tuple[float, Array]:
        """Where along `up` a shape's lowest point is, in m, and that point (3,) in the shape's frame."""
        geom, points, radius = self.clouds[cloud]
        down = self._up @ self._data.geom_xmat[geom].reshape(3, 3)
        along = points @ down
        k = int(along.argmin())
        return float(along[k] + self._up @ self._data.geom_xpos[geom] - radius), points[k] - radius * down


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
