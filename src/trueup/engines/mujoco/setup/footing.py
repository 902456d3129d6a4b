# SPDX-License-Identifier: Apache-2.0
"""Whether the poses measured of a free base put the robot on the model's floor: frames of the log, and who lifted it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from trueup.arrays import Array
from trueup.articulated.pose import (
    ANGLES,
    AXES,
    ORIENTATION,
    POSITION,
    headed,
    in_angles,
    product,
    quaternion_of,
    up_of,
)
from trueup.articulated.quantities.known import quantity
from trueup.ends import TILT
from trueup.engines.mujoco.base import floating, free_joint
from trueup.engines.mujoco.floor_plane import plane_of
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.floor import Reach
from trueup.inspection.pauses import parted
from trueup.inspection.stamps import Gap
from trueup.noise import FEWEST
from trueup.recording import Recording
from trueup.samples import MOSTLY
from trueup.trial import LOOK
from trueup.units import GRAVITY


@dataclass(frozen=True, eq=False)
class _Poses:
    """Where a robot was at instants (T,) in s: heights of its lowest point over the floor and of its base in m."""

    time: Array
    heights: Array
    base: Array
    lean: float
    """What its base leant beside the model's first keyframe or reference pose, in rad, in the median."""

    @property
    def floor(self) -> float:
        """Height over the model's floor at which the robot stood, in m: mostly no lower, whatever hops or is lifted."""
        return float(np.quantile(self.heights, 1.0 - MOSTLY))


def on_the_floor(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings whose poses of a free base are in the model's frame: z up, the floor where the robot stands; and notes.

    Where every pose of a recording is far over the floor or below it, heights are counted from elsewhere. Those of recordings
    that agree, as far as the floor's height is calibrated, are changed by the same. As they are where the model has no
    free base, or stands on something else than a plane.
    """
    reach, result, notes = _reach(model, recordings), list(recordings), []
    if reach is None:
        return result, notes
    turned = [k for k, r in enumerate(result) if _has_y_up(reach, r)]
    for k in turned:
        result[k] = _z_up(result[k])
    if turned:
        notes.append(
            f"in {', '.join(result[k].name for k in turned)} the base lies on its side, and stands if y points up, as motion "
            f"capture often has it: x, y, z of {POSITION} are taken as x, -z, y, and {ORIENTATION} is turned likewise"
        )
    seen = {k: poses.floor for k, r in enumerate(result) if (poses := _poses(reach, r)) is not None}
    if not any(abs(height) > _calibrated() for height in seen.values()):
        return result, notes
    middle = float(np.median(list(seen.values())))
    alike = all(abs(height - middle) <= _calibrated() for height in seen.values())
    moved = {k: middle if alike else h for k, h in seen.items() if alike or abs(h) > _calibrated()}
    for k, height in moved.items():
        result[k] = _moved(result[k], (0.0, 0.0, -height))
    note = ", ".join(f"{result[k].name} {seen[k]:+.3f} m" for k in moved)
    notes.append(
        f"by {POSITION} the lowest point of the robot is never at the model's floor ({note}; is its origin another point of "
        "the robot, or the frame's not on the floor?): heights are taken so that the robot stands on it. If it hung, leave "
        "the pose out"
    )
    return result, notes


def without_lifts(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings without stretches in which the robot is off the floor and does not fly, in parts, and notes."""
    reach = _reach(model, recordings)

    def lifts(recording: Recording) -> list[Gap]:
        poses = _poses(reach, recording) if reach is not None else None
        return _lifts(poses) if poses is not None else []

    def said(recording: Recording, _: Sequence[Gap], spans: str, parts: str) -> str:
        return (
            f"in '{recording.name}' the whole robot is off the model's floor and does not fall ({spans}): held in the air, "
            f"or on something that the model lacks. What is left is replayed as {parts}"
        )

    return parted(recordings, lifts, said)


def _calibrated() -> float:
    """How far from the model's floor its height is calibrated, in m."""
    return quantity("floor_height").bounds(0.0)[1]


def _lifts(poses: _Poses) -> list[Gap]:
    """Stretches off the floor that are no flights: what flies falls at g, and what is held goes straight on in the mean."""
    off = np.concatenate([[False], poses.heights > _calibrated(), [False]]).astype(int)
    begins, ends = np.flatnonzero(np.diff(off) == 1), np.flatnonzero(np.diff(off) == -1)
    found = []
    for a, b in zip(begins, ends, strict=True):
        if b - a < FEWEST:
            continue
        falls = -2.0 * float(np.polyfit(poses.time[a:b] - poses.time[a], poses.base[a:b], 2)[0])
        if falls < 0.5 * GRAVITY:
            # It left the floor after the sample before, and is on it again from the next one on.
            start, stop = float(poses.time[max(a - 1, 0)]), float(poses.time[min(b, len(poses.time) - 1)])
            found.append(Gap(start, stop - start))
    return found


def _reach(model: Model, recordings: Sequence[Recording]) -> Reach | None:
    """How low the robot reaches; None without a free base whose pose was measured, or where a plane is not all around it."""
    if not any(r.has(POSITION) and r.has(ORIENTATION) for r in recordings):
        return None
    return on_a_plane(floating(model, recordings))


def on_a_plane(model: Model) -> Reach | None:
    """How low a robot with a free base reaches; None without one, or where a plane is not all that is around it."""
    m, plane = model.compiled, plane_of(model.compiled)
    around = [g for g in range(m.ngeom) if m.body_weldid[m.geom_bodyid[g]] == 0 and g != plane]
    if free_joint(m) < 0 or plane < 0 or any(m.geom_contype[g] or m.geom_conaffinity[g] for g in around):
        return None
    reach = Reach(model)
    return reach if reach.clouds else None


def _poses(reach: Reach, recording: Recording) -> _Poses | None:
    """What a recording tells of the robot's height; None where it does not tell the pose of its base."""
    recording = in_angles(recording)
    if not recording.has(POSITION) or not recording.has(ORIENTATION):
        return None
    place, turn = recording.channel(POSITION), recording.channel(ORIENTATION)
    if not set(AXES) <= set(place.labels) or turn.labels != ANGLES:
        return None
    time = np.arange(recording.start, recording.stop, LOOK)
    bases = np.hstack([place.select(AXES).at(time), quaternion_of(headed(turn.at(time)))])
    labels: list[str] = []
    joints = np.zeros((len(time), 0))
    if recording.has("position"):
        channel = recording.channel("position")
        labels = [x for x in channel.labels if x in reach.joints and channel.unit_of(x) in ("rad", "m")]
        joints = channel.select(labels).at(time) if labels else joints
    good = np.isfinite(bases).all(axis=1) & np.isfinite(joints).all(axis=1)
    if np.count_nonzero(good) < 3:
        return None
    heights = reach.lowest(labels, joints[good], bases[good])
    return _Poses(time[good], heights, bases[good, 2], _lean(reach.model, bases[good]))


def _lean(m: mujoco.MjModel, bases: Array) -> float:
    """Angle between what points up in the model's pose and in these (T, 7), in rad, in the median."""
    start = int(m.jnt_qposadr[free_joint(m)])
    own = (m.key_qpos[0] if m.nkey else m.qpos0)[start + 3 : start + 7]
    return float(np.arccos(np.clip(np.median(up_of(bases[:, 3:]) @ up_of(np.array(own))), -1.0, 1.0)))


def _has_y_up(reach: Reach, recording: Recording) -> bool:
    """Whether a robot stands if y points up in its log's frame, and lies further beside the floor if z does."""
    as_it_is = _poses(reach, recording)
    if as_it_is is None or as_it_is.lean < TILT:
        return False
    other = _poses(reach, _z_up(recording))
    return other is not None and other.lean < TILT and abs(other.floor) < abs(as_it_is.floor)


def _z_up(recording: Recording) -> Recording:
    """A recording whose frame's y points up, in one whose z does."""
    recording = in_angles(recording)
    place, turn = recording.channel(POSITION), recording.channel(ORIENTATION)
    upright = Rotation.from_euler("x", 90, degrees=True)  # x, -z, y
    by = np.roll(upright.as_quat(), 1)
    turned = product(np.tile(by, (len(turn.time), 1)), quaternion_of(turn.values))
    recording = recording.with_channel(
        place.replace(labels=AXES, values=place.select(AXES).values @ upright.as_matrix().T)
    )
    return in_angles(recording.with_channel(turn.replace(labels=("w", "x", "y", "z"), unit="", values=turned)))


def _moved(recording: Recording, by: tuple[float, float, float]) -> Recording:
    """With its base elsewhere by x, y and z in m."""
    place = recording.channel(POSITION)
    values = place.values + [dict(zip(AXES, by, strict=True))[label] for label in place.labels]
    return recording.with_channel(place.replace(values=values))
