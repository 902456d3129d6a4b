# SPDX-License-Identifier: Apache-2.0
"""Where a free base was that nobody tracked: its joints and its inertial unit tell it, for feet on the floor stand still."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array, Integers
from trueup.articulated.attitude import attitude, by_gravity, by_tilt, smoothed_attitude
from trueup.articulated.inertial import with_inertial_units
from trueup.articulated.pose import (
    ANGLES,
    AXES,
    ORIENTATION,
    POSITION,
    RATES,
    headed,
    in_angles,
    quaternion_of,
)
from trueup.engines.mujoco.base import free_joint, held
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.floor import Reach
from trueup.engines.mujoco.setup.footing import on_a_plane
from trueup.engines.mujoco.setup.mounting import on_base
from trueup.engines.mujoco.setup.stance import stood
from trueup.engines.mujoco.setup.treading import trod
from trueup.inspection.sensors import sensed
from trueup.inspection.sliding import Legs
from trueup.reckoned import RECKONED, TOLD_BY
from trueup.recording import Channel, Recording
from trueup.samples import between

_HEADING = " (where it headed was not logged, and is taken not to change: if it turned, log yaw, or a gyro in rad/s)"


def reckoned(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings with the pose of a free base that none of them tells, where the robot stood on its feet, and notes.

    How it was turned is told by `base_orientation`, by a gyro and an accelerometer on the base, or by roll and pitch alone:
    then it is taken to head where it did. The lowest point is on the floor and stands still, so that the base goes against
    how that moves. As they are where the robot may have hung, as `stance.stood` and `treading.trod` tell, where something
    else than a plane is around it, or any recording lacks what is needed.
    """
    result = list(recordings)
    if free_joint(model.compiled) < 0 or not result or any(r.has(POSITION) for r in result):
        return result, []
    reach = on_a_plane(model)
    found = [] if reach is None else [_with_pose(model, reach, r) for r in result]
    known = [f for f in found if f is not None]
    if not known or len(known) < len(found):
        return result, []
    hanging = held(model, result).compiled
    against = stood(model, hanging, result) or trod(model, hanging, [f[0] for f in known])
    if not against:
        return result, []
    how = sorted({what for f in known for what in f[1]})
    yaw = "" if all(np.isfinite(f[0].channel(ORIENTATION).values[:, 2]).any() for f in known) else _HEADING
    note = (
        f"no recording tells where the base was, and it stood on the floor ({against}): its pose is reckoned from "
        f"{' and '.join(how)} and from the joints, as of feet of which the lowest stands still{yaw}. Replays begin "
        f"there, as unsure as simulated runs show it to be, and are not compared with it. If it hopped, or feet slipped for "
        f"long, log {POSITION}; if it hung, refuse this"
    )
    return [f[0] for f in known], [note]


def with_pose(model: Model, recording: Recording) -> Recording | None:
    """A recording with the pose of a free base, reckoned as above; None where it does not tell that."""
    reach = on_a_plane(model)
    found = None if reach is None else _with_pose(model, reach, recording)
    return None if found is None else found[0]


def _with_pose(model: Model, reach: Reach, recording: Recording) -> tuple[Recording, tuple[str, ...]] | None:
    """A recording with the pose of its base, and the channels that told how it was turned; None where nothing does."""
    position = recording.channels.get("position")
    turning = _turning(model, recording)
    if position is None or turning is None:
        return None
    labels = [x for x in position.labels if x in reach.joints]
    joints = position.select(labels)
    good = np.isfinite(joints.values).all(axis=1)
    angles, rates, by = turning
    if not set(reach.joints) <= set(labels) or np.count_nonzero(good) < 2:
        return None
    time = joints.time[good]
    time = time[(time >= angles.time[0]) & (time <= angles.time[-1])]
    if len(time) < 2:
        return None
    poses, turns = between(time, joints.time[good], joints.values[good]), quaternion_of(headed(angles.at(time)))
    place, _ = path(reach, labels, poses, turns)
    channels, names = {POSITION: Channel(POSITION, AXES, "m", time, place), ORIENTATION: angles}, {POSITION}
    if rates is not None:  # the inertial unit is compared itself
        channels, names = {**channels, RATES: rates}, {POSITION, ORIENTATION, RATES}
    told = {**recording.provenance, RECKONED: " ".join(sorted(names))}
    if rates is None and len(by) == 1:
        told[TOLD_BY] = by[0].strip("'")
    return recording.replace(channels={**recording.channels, **channels}, provenance=told), by


def path(reach: Reach, labels: Sequence[str], poses: Array, turns: Array) -> tuple[Array, Integers]:
    """(T, 3) where the base is in m, from 0, 0 on, of joints at `poses` (T, k) and a base turned by quaternions (T, 4); and
    (T,) the bodies on which it stood.
    """
    bases = np.hstack([np.zeros((len(poses), 3)), turns])
    place = np.zeros((len(poses), 3))
    moved, heights, bodies = reach.steps(labels, poses, bases)
    place[1:] = -np.cumsum(moved, axis=0)
    place[:, 2] = -heights
    return place, bodies


def legs_of(model: Model) -> Legs | None:
    """What hangs on the base of a robot that walks on a plane; None where something else is around it."""
    m, reach = model.compiled, on_a_plane(model)
    if reach is None:
        return None
    base, joints = int(m.jnt_bodyid[free_joint(m)]), reach.joints
    limbs: dict[int, list[int]] = {}
    for i, joint in enumerate(joints):
        body = int(m.jnt_bodyid[model.index("joint", joint)])
        while body > 0 and int(m.body_parentid[body]) != base:
            body = int(m.body_parentid[body])
        if body > 0:
            limbs.setdefault(body, []).append(i)
    places = [np.array(m.body_pos[body][:2]) for body in limbs]
    return Legs(tuple(joints), list(limbs.values()), places, lambda poses, turns: path(reach, joints, poses, turns))


def _turning(model: Model, recording: Recording) -> tuple[Channel, Channel | None, tuple[str, ...]] | None:
    """Roll, pitch and yaw of the base, how fast they change where a gyro told it, and what told them."""
    told = recording.channels.get(ORIENTATION) or attitude(recording)
    if told is not None:
        channel = in_angles(recording.with_channel(told.replace(name=ORIENTATION))).channel(ORIENTATION)
        return (channel, None, (f"'{told.name}'",)) if channel.labels == ANGLES else None
    (recording,), _ = with_inertial_units([recording])
    if (shown := by_gravity(recording)) is not None:
        return shown[0], None, shown[1]
    kinds = model.sensors()
    found = {}
    for name, sensor in sensed([recording], kinds).items():
        channel, site = recording.channels[name], on_base(model.compiled, sensor)
        if site is not None and channel.unit == kinds[sensor] and np.isfinite(channel.values).all():
            axes = sorted(channel.labels, key=lambda label: label[-1])
            found[kinds[sensor]] = (channel.time, channel.select(axes).values @ site.T, name)
    if not {"rad/s", "m/s^2"} <= set(found):
        tilt = by_tilt(recording)
        return None if tilt is None else (tilt[0], None, tilt[1])
    (time, rates, gyro), (late, pulls, accelerometer) = found["rad/s"], found["m/s^2"]
    angles, changes = smoothed_attitude(time, rates, between(time, late, pulls))
    how = (f"'{gyro}'", f"'{accelerometer}'")
    return Channel(ORIENTATION, ANGLES, "rad", time, angles), Channel(RATES, ANGLES, "rad/s", time, changes), how
