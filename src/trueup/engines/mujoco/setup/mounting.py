# SPDX-License-Identifier: Apache-2.0
"""Whether a gyro turns as the base does by its orientation: sensors mounted otherwise, quaternions in another order."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.articulated.inertial import RATES, Together, orientations, together
from trueup.articulated.pose import ORIENTATION
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.model import Model
from trueup.inspection.relations import CORRELATED, nearest
from trueup.inspection.sensors import sensed
from trueup.instant import HARDLY
from trueup.recording import Channel, Recording


def mounted_otherwise(model: Model, recordings: Sequence[Recording]) -> list[str]:
    """Sentences on gyros of the base that turn otherwise than its orientation says, given where the model has them; of each
    what the first recording shows.
    """
    said: dict[str, tuple[str, list[str]]] = {}
    gyros = {name: s for name, s in sensed(recordings, model.sensors()).items() if model.sensors()[s] == "rad/s"}
    for recording in recordings:
        pose = orientations(recording).get(ORIENTATION)
        for name, sensor in gyros.items():
            channel, site = recording.channels.get(name), on_base(model.compiled, sensor)
            if pose is None or channel is None or channel.unit != "rad/s" or site is None:
                continue
            sentence = _doubt(channel, sensor, pose, site)
            if sentence:
                said.setdefault(name, (sentence, []))[1].append(recording.name)
    return [f"{sentence} ({', '.join(names)})" for sentence, names in said.values()]


def _doubt(gyro: Channel, sensor: str, pose: Channel, site: Array) -> str:
    """What is wrong with a gyro and an orientation, and what to do; '' where they agree, or turn too little."""
    found = together(gyro, pose)
    if found is None or found.fits < CORRELATED or found.shares[1] < HARDLY:
        return ""
    unit, (apart, turn) = nearest(found.factor, RATES), _beside(found, site)
    if unit not in ("", "rad/s"):
        many = f"{found.factor:.3g} times"
        return f"'{gyro.name}' turns {many} as far as '{ORIENTATION}' says: is it in {unit}? Say so in the mapping"
    mirrored = found.is_mirrored and found.shares[2] >= HARDLY
    if _alike(apart) and not mirrored:
        return ""
    ways = [
        f"'{ORIENTATION}' is {meant}, and not w, x, y, z of the base in the world"
        for meant, values in _otherwise(pose.values)
        if (other := together(gyro, pose.replace(values=values))) is not None
        and other.fits > CORRELATED and not (other.is_mirrored and other.shares[2] >= HARDLY)
        and _alike(_beside(other, site)[0])
    ]  # fmt: skip
    if not mirrored:
        ways.append(
            f"it is mounted {np.degrees(_angle(apart)):.0f} degrees from where the model has sensor '{sensor}' (its site "
            f'would have quat="{" ".join(f"{x:.2f}" for x in turn)}")'
        )
    either = " or ".join(ways) or "one of them has axes of another sense"
    return f"'{gyro.name}' turns otherwise than '{ORIENTATION}' says, as if {either}: mend the mapping, or the model"


def _otherwise(quaternions: Array) -> tuple[tuple[str, Array], ...]:
    """How quaternions (T, 4) that are called w, x, y, z may have been meant, and what they are then."""
    real, imaginary = quaternions[:, :1], quaternions[:, 1:]
    return (
        ("x, y, z, w", np.roll(quaternions, 1, axis=1)),
        ("the inverse (from the world's frame to the base's)", np.hstack([real, -imaginary])),
    )


def _beside(found: Together, site: Array) -> tuple[Array, Array]:
    """The turn (3, 3) between how a gyro is mounted and its site (3, 3), and the quaternion (4,) of such a site."""
    axes = found.axes
    if found.is_mirrored:  # by the weakest direction, which noise decides
        left, strengths, right = np.linalg.svd(axes)
        axes = left @ np.diag([*strengths[:2], -1.0]) @ right
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(axes.T).ravel())
    return axes @ site, quaternion


def _alike(turn: Array) -> bool:
    """Whether each axis is nearest to itself after a turn (3, 3): units are mounted by quarters of one."""
    return bool(np.all(np.argmax(turn, axis=1) == np.arange(len(turn))))


def _angle(turn: Array) -> float:
    """How far, in rad, a matrix (3, 3) turns."""
    return float(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0)))


def on_base(m: mujoco.MjModel, sensor: str) -> Array | None:
    """(3, 3) the axes of a sensor's site in the frame of the free base that carries it; None for a site elsewhere."""
    joint = free_joint(m)
    index = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_SENSOR, sensor)
    if joint < 0 or index < 0 or m.sensor_objtype[index] != mujoco.mjtObj.mjOBJ_SITE:
        return None
    site = int(m.sensor_objid[index])
    if m.site_bodyid[site] != m.jnt_bodyid[joint]:
        return None
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, m.site_quat[site])
    return matrix.reshape(3, 3)
