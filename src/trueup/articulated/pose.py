# SPDX-License-Identifier: Apache-2.0
"""The pose of a free base in recordings: its channels, angles of quaternions and back, and turns by quaternions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.reckoned import RATE_OF
from trueup.recording import Recording
from trueup.rounding import NEGLIGIBLE, ROUNDED
from trueup.samples import unwound, wrapped

POSITION, ORIENTATION = "base_position", "base_orientation"
RATES = ORIENTATION + RATE_OF
"""Channels: x, y, z in m; roll, pitch, yaw in rad (turned about the base's x first, then y, then z of the world), and how
fast these change, in rad/s."""
AXES, ANGLES, QUATERNION = ("x", "y", "z"), ("roll", "pitch", "yaw"), ("w", "x", "y", "z")


def in_angles(recording: Recording) -> Recording:
    """The recording with its base's orientation as roll, pitch and yaw in rad that do not jump, whatever it was."""
    if not recording.has(ORIENTATION):
        return recording
    channel = recording.channel(ORIENTATION)
    if set(channel.labels) == set(QUATERNION):
        values = angles_of(channel.select(QUATERNION).values)
    elif set(channel.labels) == set(ANGLES):
        values = channel.select(ANGLES).values
    else:
        return recording
    return recording.with_channel(channel.replace(labels=ANGLES, unit="rad", values=unwound(values)))


def headed(angles: Array) -> Array:
    """(..., 3) roll, pitch and yaw, or how fast they change, with a yaw of 0 where nobody measured it: on a level floor
    nothing hangs on where a robot heads.
    """
    return np.where(np.isnan(angles) & (np.arange(3) == ANGLES.index("yaw")), 0.0, angles)


def is_quaternion(labels: Sequence[str]) -> bool:
    """Whether labels are those of a quaternion: w, x, y, z, or qw, qx, qy, qz, in any order."""
    return sorted(label.removeprefix("q") for label in labels) == sorted("wxyz")


def angles_of(quaternion: Array) -> Array:
    """(..., 3) roll, pitch, yaw in rad of quaternions w, x, y, z (..., 4) of any length."""
    unit = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    w, x, y, z = (unit[..., k] for k in range(4))
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def yaw_of(quaternion: Array) -> Array:
    """(...) yaw alone in rad, as `angles_of` has it."""
    unit = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    w, x, y, z = (unit[..., k] for k in range(4))
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def quaternions_of_vectors(vectors: Array) -> Array:
    """(b, 4) w, x, y, z of rotation vectors (b, 3) in rad."""
    half = 0.5 * np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.hstack([np.cos(half), 0.5 * np.sinc(half / np.pi) * vectors])


def quaternion_of(angles: Array) -> Array:
    """(..., 4) w, x, y, z of roll, pitch, yaw (..., 3) in rad."""
    half = np.moveaxis(0.5 * angles, -1, 0)
    (cr, cp, cy), (sr, sp, sy) = np.cos(half), np.sin(half)
    return np.stack([
        cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    ], axis=-1)  # fmt: skip


def product(first: Array, second: Array) -> Array:
    """(..., 4) w, x, y, z of the rotations `second` (..., 4), then `first`, about axes of the world."""
    w, v = first[..., :1], first[..., 1:]
    other, u = second[..., :1], second[..., 1:]
    scalar = w * other - np.sum(v * u, axis=-1, keepdims=True)
    return np.concatenate([scalar, w * u + other * v + np.cross(v, u)], axis=-1)


def rotation_between(first: Array, second: Array) -> Array:
    """(..., 3) rotation vectors in rad from the first quaternions w, x, y, z (..., 4) to the second, in its axes."""
    turn = product(first * (1.0, -1.0, -1.0, -1.0), second)
    scalar, vector = turn[..., :1], turn[..., 1:]
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(scalar))
    factor = np.where(sine > ROUNDED, angle / np.maximum(sine, NEGLIGIBLE), 2.0)
    return np.where(scalar < 0.0, -1.0, 1.0) * factor * vector


def up_of(quaternion: Array) -> Array:
    """(..., 3) the world's z in the frame of what is turned by unit quaternions w, x, y, z (..., 4)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    return np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=-1)


def turning(angles: Array, rates: Array) -> Array:
    """(..., 3) angular velocity about the base's own axes in rad/s, of roll, pitch, yaw (..., 3) and how fast they change."""
    turns = np.moveaxis(angles, -1, 0)
    (sr, sp, _), (cr, cp, _) = np.sin(turns), np.cos(turns)
    roll, pitch, yaw = np.moveaxis(rates, -1, 0)
    return np.stack([roll - yaw * sp, pitch * cr + yaw * sr * cp, -pitch * sr + yaw * cr * cp], axis=-1)


def rates_of(angles: Array, turns: Array) -> Array:
    """(..., 3) how fast roll, pitch, yaw (..., 3) change in rad/s, of an angular velocity about the base's own axes: what
    `turning` undoes, up to a pitch of a right angle.
    """
    (sr, sp, _), (cr, cp, _) = (np.moveaxis(x, -1, 0) for x in (np.sin(angles), np.cos(angles)))
    x, y, z = np.moveaxis(turns, -1, 0)
    yaw = (y * sr + z * cr) / cp
    return np.stack([x + yaw * sp, y * cr - z * sr, yaw], axis=-1)


def near(angles: Array, measured: Array) -> Array:
    """(b, T, 3) angles, each in the turn that is nearest to what was measured (T, 3); as they are where nothing was."""
    away = np.where(np.isfinite(measured), measured, 0.0)
    return np.where(np.isfinite(measured), away + wrapped(angles - away), angles)
