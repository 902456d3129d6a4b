# SPDX-License-Identifier: Apache-2.0
"""Compiled: joint angles of legs from where they point, one leg at a time."""

from __future__ import annotations

import math

from trueup.arrays import Array
from trueup.compiled import njit
from trueup.rounding import PRINTED


@njit(cache=True, nogil=True)
def joint_angles(
    wanted: tuple[Array, Array, Array, Array, Array, Array], axes: Array, thighs: Array, shanks: Array, signs: Array,
    out: Array,
) -> None:  # fmt: skip
    """Fills `out` (b, 2, 6) with the angles of `Legs.angles`, whose arguments (b, 2) and fields these are."""
    yaws, rolls, pitches, lengths, foot_rolls, foot_pitches = wanted
    for side in range(2):
        axis = axes[side, 0], axes[side, 1], axes[side, 2]
        l1, thigh = math.hypot(thighs[side, 0], thighs[side, 1]), math.atan2(thighs[side, 0], -thighs[side, 1])
        l2, shank = math.hypot(shanks[side, 0], shanks[side, 1]), math.atan2(shanks[side, 0], -shanks[side, 1])
        for row in range(len(out)):
            yaw, roll, pitch = yaws[row, side], rolls[row, side], pitches[row, side]
            d = min(max(lengths[row, side], abs(l1 - l2) + PRINTED), l1 + l2 - PRINTED)
            bend = math.acos(_cut((d * d - l1 * l1 - l2 * l2) / (2.0 * l1 * l2)))
            before = math.asin(_cut(l2 * math.sin(bend) / d))  # between thigh and the line to the ankle
            if l1 + l2 * math.cos(bend) < 0.0:
                before = math.pi - before
            psi = yaw * axis[2]
            # Directions before the first joint turns them: the other hip joints make these.
            cp = math.cos(pitch)
            x, y, z = turned(axis, -yaw, _yawed(psi, math.sin(pitch), math.sin(roll) * cp, -math.cos(roll) * cp))
            hip_roll = math.atan2(y, -z)
            hip_pitch, knee = thigh - math.asin(_cut(x)) - before, shank - thigh + bend
            cp = math.cos(foot_pitches[row, side])
            tilt = foot_rolls[row, side]
            normal = _yawed(psi, math.sin(foot_pitches[row, side]), -math.sin(tilt) * cp, math.cos(tilt) * cp)
            x, y, z = turned(axis, -yaw, normal)
            c, s = math.cos(hip_roll), math.sin(hip_roll)
            y, z = c * y + s * z, c * z - s * y
            c, s = math.cos(hip_pitch + knee), math.sin(hip_pitch + knee)
            x, z = c * x - s * z, s * x + c * z
            out[row, side] = yaw, hip_roll, hip_pitch, knee, math.atan2(x, z), math.asin(_cut(-y))
            out[row, side] *= signs[side]


@njit(cache=True, nogil=True)
def _cut(x: float) -> float:
    """Within the range of sines."""
    return min(max(x, -1.0), 1.0)


@njit(cache=True, nogil=True)
def _yawed(psi: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector turned about z."""
    c, s = math.cos(psi), math.sin(psi)
    return c * x - s * y, s * x + c * y, z


@njit(cache=True, nogil=True)
def turned(axis: tuple[float, float, float], angle: float, v: tuple[float, float, float]) -> tuple[float, float, float]:
    """A vector turned about a unit axis: Rodrigues' formula."""
    kx, ky, kz = axis
    x, y, z = v
    c, s = math.cos(angle), math.sin(angle)
    along = (kx * x + ky * y + kz * z) * (1.0 - c)
    return (
        c * x + s * (ky * z - kz * y) + kx * along,
        c * y + s * (kz * x - kx * z) + ky * along,
        c * z + s * (kx * y - ky * x) + kz * along,
    )
