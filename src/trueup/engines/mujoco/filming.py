# SPDX-License-Identifier: Apache-2.0
"""Films of runs: recordings of a robot or its simulation, shown by the robot's MuJoCo model; no physics is computed."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.articulated.pose import ANGLES, AXES, ORIENTATION, POSITION, headed, in_angles, quaternion_of
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.floor_plane import plane_of
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.wiring import rest
from trueup.errors import RecordingError, RenderingError
from trueup.film import Film, Shape
from trueup.recording import Recording

Pictures = NDArray[np.uint8]

_SHOWN = mujoco.MjvOption().geomgroup.astype(bool)  # groups of geoms that MuJoCo's own viewer shows
_LIBRARIES = ("egl", "osmesa") if sys.platform.startswith("linux") else ("cgl", "glfw")


def postures(model: Model, recording: Recording, time: Array) -> Array:
    """(T, nq) of a recording's measured 'position', 'base_position' and 'base_orientation' at `time` (T,) since its start.

    What was not measured stays as the model has it; after its end a recording keeps its last values. Raises RecordingError
    where no joint of the model was measured, UnknownNameError for joints that it does not have.
    """
    compiled, recording = model.compiled, in_angles(recording)
    out = np.tile(rest(compiled)[0], (len(time), 1))
    if not recording.has("position"):
        raise RecordingError(f"recording '{recording.name}' shows no 'position' of joints: there is nothing to film")
    joints = recording.channel("position")
    for column, label in enumerate(joints.labels):
        out[:, compiled.jnt_qposadr[model.index("joint", label)]] = _known(
            joints.time, joints.values[:, column], recording, time
        )
    joint = free_joint(compiled)
    if joint < 0:
        return out
    start = int(compiled.jnt_qposadr[joint])
    if recording.has(POSITION):
        place = recording.channel(POSITION).select(AXES)
        for i, values in enumerate(place.values.T):
            out[:, start + i] = _known(place.time, values, recording, time)
    if recording.has(ORIENTATION):
        turn = recording.channel(ORIENTATION).select(ANGLES)
        angles = np.stack(
            [_known(turn.time, v, recording, time) for v in np.unwrap(headed(turn.values), axis=0).T], axis=1
        )
        out[:, start + 3 : start + 7] = [quaternion_of(a) for a in angles]
    return out


def filmed(
    model: Model, recording: Recording, *, name: str = "", rate: float = 25.0, lasting: float | None = None
) -> Film:
    """A recording as a Film of `rate` instants a second, of its whole length or `lasting` s. Needs no graphics.

    Raises what `postures` raises.
    """
    compiled = model.compiled
    time = np.arange(round((lasting or recording.duration) * rate) + 1) / rate
    data = mujoco.MjData(compiled)
    places, turns = np.empty((len(time), compiled.nbody, 3)), np.empty((len(time), compiled.nbody, 4))
    for k, qpos in enumerate(postures(model, recording, time)):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(compiled, data)
        places[k], turns[k] = data.xpos, data.xquat
    plane, joint = plane_of(compiled), free_joint(compiled)
    floor = float(compiled.geom_pos[plane, 2]) if plane >= 0 else None
    followed = int(compiled.jnt_bodyid[joint]) if joint >= 0 else 0
    return Film(name or recording.name, _shapes(compiled), time, places, turns, floor, followed)


def pictures(
    model: Model, recording: Recording, time: Sequence[float], *, width: int = 180, height: int = 220, azimuth: float = 90.0,
    distance: float | None = None,
) -> Pictures:  # fmt: skip
    """(n, height, width, 3) a recording at some instants since its start, rendered off screen by MuJoCo.

    `azimuth` of the camera in degrees (90: the robot's x axis points to the right), `distance` in m from the
    robot's middle (None: by the model's size). Raises RenderingError where the machine has no off-screen graphics.
    """
    compiled, data, camera = model.compiled, mujoco.MjData(model.compiled), mujoco.MjvCamera()
    reach = _reach(compiled)
    camera.azimuth, camera.elevation, camera.distance = azimuth, -8.0, distance or 2.2 * reach
    states = postures(model, recording, np.asarray(time, dtype=np.float64))
    out = np.empty((len(states), height, width, 3), dtype=np.uint8)
    scene, view = mujoco.MjvScene(compiled, maxgeom=10000), mujoco.MjrRect(0, 0, width, height)
    with _off_screen(compiled, width, height) as context:
        for k, qpos in enumerate(states):
            data.qpos[:] = qpos
            mujoco.mj_forward(compiled, data)
            camera.lookat[:2], camera.lookat[2] = data.subtree_com[_root(compiled), :2], 0.45 * reach
            mujoco.mjv_updateScene(
                compiled, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, scene
            )
            mujoco.mjr_render(view, scene, context)
            mujoco.mjr_readPixels(out[k], None, view, context)
    if not np.any(compiled.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX):  # the sky is black: no ink for it
        out[(out == 0).all(axis=3)] = 255
    return out[:, ::-1]


@contextmanager
def _off_screen(compiled: mujoco.MjModel, width: int, height: int) -> Iterator[mujoco.MjrContext]:
    """Graphics without a window: what MUJOCO_GL names, else EGL or OSMesa. Raises RenderingError where there are none."""
    named = os.environ.get("MUJOCO_GL", "").lower()
    failed: list[str] = []
    for library in [named] if named in _LIBRARIES else list(_LIBRARIES):
        try:
            graphics = importlib.import_module(f"mujoco.{library}").GLContext(width, height)
        except Exception as error:  # each library has exceptions of its own
            os.environ.pop("PYOPENGL_PLATFORM", None)  # which the next one wants otherwise
            failed.append(
                f"{library}: {str(error).strip().splitlines()[0][:90] if str(error).strip() else type(error).__name__}"
            )
            continue
        graphics.make_current()
        try:
            own = compiled.__copy__()
            own.vis.global_.offwidth, own.vis.global_.offheight = width, height
            context = mujoco.MjrContext(own, mujoco.mjtFontScale.mjFONTSCALE_100.value)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, context)
            yield context
        finally:
            graphics.free()
        return
    raise RenderingError(
        f"this machine cannot render off screen ({'; '.join(failed)}). Install EGL or OSMesa (Debian: libegl1, libosmesa6), "
        "or name one in MUJOCO_GL; the replay that can be scrubbed needs neither"
    )


def _known(time: Array, values: Array, recording: Recording, wanted: Array) -> Array:
    """Values at instants since the recording's start, from the samples that there are; the last one after its end."""
    good = np.isfinite(values)
    if not good.any():
        raise RecordingError(f"recording '{recording.name}' holds no sample of a channel that is to be filmed")
    return np.interp(wanted + recording.start, time[good], values[good])


def _root(compiled: mujoco.MjModel) -> int:
    joint = free_joint(compiled)
    return int(compiled.jnt_bodyid[joint]) if joint >= 0 else 0


def _reach(compiled: mujoco.MjModel) -> float:
    """m: from the floor to the top of a robot that stands as its model has it."""
    data = mujoco.MjData(compiled)
    data.qpos[:] = rest(compiled)[0]
    mujoco.mj_forward(compiled, data)
    moving = np.flatnonzero((compiled.body_weldid[compiled.geom_bodyid] != 0) & _SHOWN[compiled.geom_group])
    if not len(moving):
        return 1.0
    size = compiled.geom_rbound[moving, None]
    low, high = (data.geom_xpos[moving] - size).min(axis=0), (data.geom_xpos[moving] + size).max(axis=0)
    return float(np.max(high - np.minimum(low, [np.inf, np.inf, 0.0])))


def _shapes(compiled: mujoco.MjModel) -> tuple[Shape, ...]:
    shapes = []
    for g in range(compiled.ngeom):
        rgba = compiled.geom_rgba[g] if compiled.geom_matid[g] < 0 else compiled.mat_rgba[compiled.geom_matid[g]]
        if not _SHOWN[compiled.geom_group[g]] or rgba[3] == 0.0 or int(compiled.geom_type[g]) in _FLAT:
            continue
        points, radius = _hull(compiled, g)
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, compiled.geom_quat[g])
        placed = points @ turn.reshape(3, 3).T + compiled.geom_pos[g]
        shapes.append(
            Shape(int(compiled.geom_bodyid[g]), placed, radius, (float(rgba[0]), float(rgba[1]), float(rgba[2])))
        )
    return tuple(shapes)


_FLAT = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))


def _hull(compiled: mujoco.MjModel, g: int) -> tuple[Array, float]:
    """Points (n, 3) in the geom's own frame whose hull, thickened by a radius, it is."""
    most = 60  # points of a mesh
    ring = 12  # points of a circle
    kind, size = mujoco.mjtGeom(int(compiled.geom_type[g])), np.array(compiled.geom_size[g])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.zeros((1, 3)), float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]]), float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(compiled.geom_dataid[g])
        first, count = int(compiled.mesh_vertadr[mesh]), int(compiled.mesh_vertnum[mesh])
        points = np.array(compiled.mesh_vert[first : first + count], dtype=np.float64)
        toward = np.random.default_rng(0).standard_normal((most, 3))  # the outermost points in many directions
        return points[np.unique((toward @ points.T).argmax(axis=1))], 0.0
    turn = 2.0 * np.pi * np.arange(ring) / ring
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        ends = [np.column_stack([size[0] * circle, np.full(ring, z)]) for z in (-size[1], size[1])]
        return np.concatenate(ends), 0.0
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        rings = [np.column_stack([c * circle, np.full(ring, s)]) for s, c in ((-0.8, 0.6), (0.0, 1.0), (0.8, 0.6))]
        return np.concatenate([*rings, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]]) * size, 0.0
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return corners * size, 0.0
