# SPDX-License-Identifier: Apache-2.0
"""Whether recordings show a floor or table that the model lacks: the robot stopped above where it was told to go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.engines.mujoco.floor_plane import plane_of
from trueup.engines.mujoco.model import Model
from trueup.recording import Recording
from trueup.trial import command_of

Array = NDArray[np.float64]

_POSES = 400  # of a recording that are looked at
_SHORT = 0.01  # m above the commanded height: more than friction and sag explain
_PLAINLY = 0.02  # m, reached at least once
_SLOW = 0.02  # m/s of the lowest point: not on its way any more
_NEAR = 0.04  # m above the lowest height ever reached
_SHARE = 0.01  # of all poses that must look stopped


@dataclass(frozen=True)
class Stopped:
    """What recordings show of something in the way below the robot."""

    height: float
    """In m, of the lowest points of the robot where they were stopped (median)."""
    recordings: tuple[str, ...]
    """Those in which it happens."""


def stopped_by_floor(model: Model, recordings: Sequence[Recording]) -> Stopped | None:
    """Whether the robot's lowest point stays well above where its commands would put it, near the lowest reach of all.

    Servos sag below their commands; one that rests above it was stopped. None for a model that has a plane, that does
    not stand fixed, or has no shapes; and where recordings do not show it.
    """
    m = model.compiled
    shapes = _Shapes(m)
    if plane_of(m) >= 0 or not shapes.clouds or np.any(m.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        return None
    looks = [(r.name, *seen) for r in recordings for seen in (_heights(model, shapes, r),) if seen is not None]
    if not looks:
        return None
    lowest = min(float(reached.min()) for _, reached, _, _ in looks)
    heights, names, poses = [], [], 0
    for name, reached, told, slow in looks:
        poses += len(reached)
        resting = slow & (reached - told > _SHORT) & (reached < lowest + _NEAR)
        if np.any(reached[resting] - told[resting] > _PLAINLY):
            heights.append(reached[resting])
            names.append(name)
    if not heights or sum(map(len, heights)) < _SHARE * poses:
        return None
    return Stopped(float(np.median(np.concatenate(heights))), tuple(names))


def _heights(model: Model, shapes: _Shapes, recording: Recording) -> tuple[Array, Array, NDArray[np.bool_]] | None:
    """(T,) lowest points of the robot as measured and as commanded, and whether it moves slowly up or down."""
    command = command_of(recording)
    if command is None or not recording.has("position") or command.unit != recording.channel("position").unit:
        return None
    position = recording.channel("position")
    joints = model.scalar_joints()
    shared = [label for label in position.labels if label in command.labels and label in joints]
    if not shared:
        return None
    every = max(1, len(position.time) // _POSES)
    time = position.time[::every]
    measured = position.select([label for label in position.labels if label in joints])
    address = [int(model.compiled.jnt_qposadr[model.index("joint", label)]) for label in measured.labels]
    own = measured.at(time)
    wanted = np.array(own)
    wanted[:, [measured.labels.index(label) for label in shared]] = command.select(shared).at(time, hold=True)
    good = np.isfinite(own).all(axis=1) & np.isfinite(wanted).all(axis=1)
    if good.sum() < 3:
        return None
    reached, told = shapes.lowest(address, own[good]), shapes.lowest(address, wanted[good])
    return reached, told, np.abs(np.gradient(reached, time[good])) < _SLOW


class _Shapes:
    """Points that span the solid shapes on moving bodies, each with a radius."""

    def __init__(self, compiled: mujoco.MjModel) -> None:
        self._model, self._data = compiled, mujoco.MjData(compiled)
        self.clouds = [
            (g, *_points(compiled, g))
            for g in range(compiled.ngeom)
            if (compiled.geom_contype[g] or compiled.geom_conaffinity[g])
            and compiled.body_weldid[compiled.geom_bodyid[g]] != 0
        ]

    def lowest(self, address: Sequence[int], poses: Array) -> Array:
        """(T,) height of the lowest point in m at poses (T, k) of the coordinates at `address`."""
        data, found = self._data, np.empty(len(poses))
        for i, pose in enumerate(poses):
            data.qpos[:] = self._model.qpos0
            data.qpos[address] = pose
            mujoco.mj_kinematics(self._model, data)
            found[i] = min(
                float((points @ data.geom_xmat[g, 6:9]).min() + data.geom_xpos[g, 2] - radius)
                for g, points, radius in self.clouds
            )
        return found


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
