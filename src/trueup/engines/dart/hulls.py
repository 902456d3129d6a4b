# SPDX-License-Identifier: Apache-2.0
"""Meshes as DART has them: the convex hulls with which MuJoCo lets meshes touch."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import dartpy
import mujoco
import numpy as np

from trueup.arrays import Array, Integers
from trueup.errors import ModelError

_ROBOT = (
    '<robot name="hull"><link name="hull"><inertial><mass value="1"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    '<collision><geometry><mesh filename="hull.obj"/></geometry></collision></link></robot>'
)
"""dartpy makes meshes for the robots that it reads only."""


def hulls(model: mujoco.MjModel) -> dict[int, Any]:
    """Mesh number to its convex hull, a shape of DART, for the meshes of all shapes that can touch.

    Raises ModelError for a mesh of which MuJoCo made no hull.
    """
    touching = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    meshes = model.geom_dataid[touching & (model.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH))]
    return {int(mesh): _shape(*hull(model, int(mesh))) for mesh in np.unique(meshes)}


def hull(model: mujoco.MjModel, mesh: int) -> tuple[Array, Integers]:
    """(n, 3) corners in m and (m, 3) triangles of a mesh's convex hull, seen from outside against the clock.

    Raises ModelError where MuJoCo made none.
    """
    first = int(model.mesh_graphadr[mesh])
    if first < 0:
        name = model.mesh(mesh).name or str(mesh)
        raise ModelError(f"mesh '{name}' has no convex hull, so nothing can touch it in DART")
    # Counts, where each corner's edges begin, the corners' numbers in the mesh, edges, and triangles of mesh numbers.
    corners, faces = (int(n) for n in model.mesh_graph[first : first + 2])
    numbers = model.mesh_graph[first + 2 + corners : first + 2 + 2 * corners]
    start = first + 2 + 3 * corners + 3 * faces
    triangles = model.mesh_graph[start : start + 3 * faces].reshape(faces, 3)
    order = np.argsort(numbers)
    places = model.mesh_vert[int(model.mesh_vertadr[mesh]) + numbers].astype(np.float64)
    local = order[np.searchsorted(numbers, triangles, sorter=order)]
    return places, _outwards(places, local)


def _outwards(places: Array, triangles: Integers) -> Integers:
    a, b, c = (places[triangles[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a - places.mean(axis=0)) < 0.0
    return np.where(inwards[:, None], triangles[:, ::-1], triangles)


def _shape(places: Array, triangles: Integers) -> Any:
    """A `dartpy.dynamics.MeshShape`."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in places.tolist()]
    lines += [f"f {i} {j} {k}" for i, j, k in (triangles + 1).tolist()]
    with tempfile.TemporaryDirectory() as made:
        (Path(made) / "hull.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
        (Path(made) / "hull.urdf").write_text(_ROBOT, encoding="utf-8")
        robot = dartpy.utils.DartLoader().parseSkeleton(str(Path(made) / "hull.urdf"))
        return robot.getBodyNode("hull").getShapeNodes()[0].getShape()
