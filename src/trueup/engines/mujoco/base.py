# SPDX-License-Identifier: Apache-2.0
"""A free base: where a model has its pose, and models set free, or held, as recordings show it."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.articulated.model import BasePose
from trueup.articulated.pose import (
    ANGLES,
    AXES,
    ORIENTATION,
    POSITION,
    in_angles,
    is_quaternion,
    quaternion_of,
    turning,
)
from trueup.engines.mujoco.floor_plane import add_floor, plane_of
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.contacts import without_contacts
from trueup.engines.mujoco.setup.stance import stood
from trueup.errors import ModelError
from trueup.inspection.sensors import turned
from trueup.instant import STILL
from trueup.recording import Recording

_TURNS = 0.05  # rad within a second: a stand gives less


def free_joint(compiled: mujoco.MjModel) -> int:
    """The first free joint of a model that carries other joints, or the first at all; -1 if none is free."""
    free = np.flatnonzero(compiled.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).tolist()
    if len(free) < 2:
        return next(iter(free), -1)
    carried = [int(compiled.body_treeid[b]) for j, b in enumerate(compiled.jnt_bodyid) if j not in free]
    carrying = [j for j in free if int(compiled.body_treeid[compiled.jnt_bodyid[j]]) in carried]
    return next(iter([*carrying, *free]), -1)


def check_base(model: Model, recordings: Sequence[Recording]) -> list[str]:
    """Notes on recordings that do not say where the base was, or whose base moves and the model's cannot. Raises ModelError
    where the model does not say where it was either.
    """
    if free_joint(model.compiled) < 0:
        return _carried(model, recordings)
    without = [r.name for r in recordings if not r.has(POSITION) or not r.has(ORIENTATION)]
    if not without:
        return []
    where = f"the base of model '{model.path.name}' is free, but nothing tells where it was in {', '.join(without)}"
    if not model.compiled.nkey:
        raise ModelError(
            f"{where}: log its pose ({POSITION}: x, y, z; {ORIENTATION}: w, x, y, z or roll, pitch, yaw) there too, give "
            "the model a keyframe to start from, or leave these recordings out"
        )
    return [f"{where}: it starts as in the model's first keyframe"]


def _carried(model: Model, recordings: Sequence[Recording]) -> list[str]:
    """A note where a base that stands fixed in the model was moved."""
    ways = {r.name: float(np.nanmax(np.ptp(r.channel(POSITION).values, axis=0))) for r in recordings if r.has(POSITION)}
    furthest = max(ways, key=lambda name: ways[name], default="")
    if not furthest or not ways[furthest] > STILL:
        return []
    return [
        f"'{POSITION}' moves by {ways[furthest]:.3g} m in '{furthest}', but model '{model.path.name}' stands fixed: if its "
        "base was carried or drove, what that does to the joints is not simulated, and estimates stand for it too"
    ]


def held(model: Model, recordings: Sequence[Recording]) -> Model:
    """A model whose base is free, fixed in the air where none of the recordings tells where it was: most such robots hang.

    It stands as its first keyframe has it, or its reference pose, turned as an inertial unit saw it, and what stands
    around it touches nothing. Raises ModelError where it does not compile so, or recordings tell a pose in part.
    """
    joint = free_joint(model.compiled)
    if joint < 0 or not recordings:
        return model
    posed = [r for r in recordings if r.has(POSITION) and r.has(ORIENTATION)]
    _check_whole(posed)
    if posed:
        return model
    compiled = model.compiled
    spec, _ = without_contacts(model.spec, spared(compiled, joint))
    start = int(compiled.jnt_qposadr[joint])
    pose = (compiled.key_qpos[0] if compiled.nkey else compiled.qpos0)[start : start + 7]
    seen = _mean_angles(recordings)
    body = spec.bodies[int(compiled.jnt_bodyid[joint])]
    body.pos, body.quat = pose[:3], quaternion_of(seen) if seen is not None else pose[3:]
    _untouched(spec, compiled)
    # Keyframes have a place for the pose, which is gone.
    for gone in (*spec.keys, body.joints[0]):
        spec.delete(gone)
    turn = "as it was turned on average" if seen is not None else "as its first keyframe or reference pose has it"
    note = (
        f"the base of model '{model.path.name}' is free, but no recording tells where it was: it is held in the air, {turn}, "
        f"touching nothing, as on a stand. If it stood or walked, log its pose ({POSITION}: x, y, z; {ORIENTATION}: w, x, y, "
        "z or roll, pitch, yaw), or how it was turned alone from a rest on its feet on (that orientation, roll and pitch, or "
        "a gyro and an accelerometer on the base, in their units), or refuse this: it then begins free, as in the first "
        "keyframe"
    )
    note += _perhaps(recordings)
    angle, sensor = turned(recordings)
    hanging = model.changed(spec, "with its base held", note)
    if angle > _TURNS:
        against = f"by '{sensor}' it turned by {np.degrees(angle):.0f} degrees within a second"
        note += f". It was not held: {against}. What is found of the joints stands for that motion too, however sure it looks"
    elif against := stood(model, hanging.compiled, recordings):
        note += f". It was not held: {against}. What is found of the joints stands for that weight too, however sure it looks"
    return model.changed(spec, "with its base held", note)


def _perhaps(recordings: Sequence[Recording]) -> str:
    """Which quaternions may be the base's, under a name that no rule knows; '' where there is none."""
    found = dict.fromkeys(
        name for r in recordings for name, c in r.channels.items() if name != ORIENTATION and is_quaternion(c.labels)
    )
    named = f"[channels.{ORIENTATION}] (labels w, x, y, z), and the x, y, z beside it [channels.{POSITION}]"
    return f". If {' or '.join(map(repr, found))} is the base's, call it {named} in the mapping" if found else ""


def spared(compiled: mujoco.MjModel, joint: int) -> list[tuple[int, int]]:
    """Pairs of bodies, the base with this free joint (or what is fixed to it) and what it carries, that may overlap since
    MuJoCo lets a link and its parent pass each other, but not where the parent stands fixed.
    """
    base, weld = int(compiled.body_weldid[compiled.jnt_bodyid[joint]]), compiled.body_weldid
    above = weld[compiled.body_parentid[weld]]
    touching = np.unique(compiled.geom_bodyid[(compiled.geom_contype != 0) | (compiled.geom_conaffinity != 0)])
    return [(int(a), int(b)) for a in touching for b in touching if weld[a] == base != weld[b] and above[b] == base]


def _check_whole(recordings: Sequence[Recording]) -> None:
    """Raises ModelError where a pose lacks numbers, as one in the plane does: each window would begin elsewhere."""
    for recording in map(in_angles, recordings):
        place, turn = recording.channel(POSITION), recording.channel(ORIENTATION)
        if not set(AXES) <= set(place.labels) or turn.labels != ANGLES:
            raise ModelError(
                f"recording '{recording.name}' tells {', '.join(place.labels)} of {POSITION} and {', '.join(turn.labels)} of "
                f"{ORIENTATION}; a free base begins at x, y, z and w, x, y, z or roll, pitch, yaw. For a robot on a floor "
                "that is level add columns of its height above it, and of roll and pitch, both 0, to the log"
            )


def _mean_angles(recordings: Sequence[Recording]) -> Array | None:
    """(3,) roll and pitch of the base on average, no yaw; None where no recording has them."""
    seen = [r.channel(ORIENTATION) for r in map(in_angles, recordings) if r.has(ORIENTATION)]
    rows = [c.values for c in seen if c.labels == ANGLES]
    return np.append(np.nanmean(np.concatenate(rows), axis=0)[:2], 0.0) if rows else None


def _untouched(spec: mujoco.MjSpec, compiled: mujoco.MjModel) -> None:
    """What stands in the world neither touches nor is touched."""
    names = set()
    for geom in spec.geoms:
        if compiled.body_weldid[compiled.geom_bodyid[geom.id]] == 0:
            geom.contype = geom.conaffinity = 0
            names.add(geom.name)
    for pair in [p for p in spec.pairs if {p.geomname1, p.geomname2} & names]:
        spec.delete(pair)


def floating(model: Model, recordings: Sequence[Recording]) -> Model:
    """A model that stands fixed, set free and put on a floor where recordings show that its base moves (a URDF)."""
    moved = [r for r in recordings if r.has(POSITION) and np.nanmax(np.ptp(r.channel(POSITION).values, axis=0)) > STILL]
    bodies = model.spec.worldbody.bodies
    if not moved or model.is_mjcf or free_joint(model.compiled) >= 0 or len(bodies) != 1 or bodies[0].joints:
        return model
    spec = model.spec.copy()
    root = spec.worldbody.bodies[0]
    joint = root.add_freejoint()
    joint.name = "floating_base"
    if plane_of(model.compiled) < 0:
        add_floor(spec)
    note = f"the recordings show that the base moves: '{root.name}' was set free, on a floor at the height 0"
    return model.changed(spec, "with a free base", note)


def place(compiled: mujoco.MjModel, qpos: Array, qvel: Array, pose: BasePose) -> None:
    """Writes a pose of the free base into a state (nq,), (nv,)."""
    joint = free_joint(compiled)
    if joint < 0:
        return
    q, v = int(compiled.jnt_qposadr[joint]), int(compiled.jnt_dofadr[joint])
    qpos[q : q + 3], qvel[v : v + 3] = pose.position, pose.velocity
    qpos[q + 3 : q + 7], qvel[v + 3 : v + 6] = quaternion_of(pose.angles), turning(pose.angles, pose.rates)


def columns_of(compiled: mujoco.MjModel, name: str, labels: Sequence[str]) -> list[int] | None:
    """Where a channel of the base stands in qpos: numbers of the position, or the four of the quaternion; None for others."""
    joint = free_joint(compiled)
    if joint < 0:
        return None
    start = int(compiled.jnt_qposadr[joint])
    if name == POSITION and set(labels) <= set(AXES):
        return [start + AXES.index(label) for label in labels]
    return [start + 3 + i for i in range(4)] if name == ORIENTATION and tuple(labels) == ANGLES else None
