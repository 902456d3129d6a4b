# SPDX-License-Identifier: Apache-2.0
"""Legs of six joints: from where a leg points, how long it is and how its foot lies to joint angles, in closed form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers
from trueup.controllers.walk_engine.kernel import joint_angles
from trueup.errors import ModelError

JOINTS = ("hip yaw", "hip roll", "hip pitch", "knee", "ankle pitch", "ankle roll")
"""The order of a leg's joints from the hip down; the first may turn about any axis (a NAO's about yaw and pitch at once)."""
_AXES = (None, 0, 1, 1, 1, 0)  # of the joints of a leg, after the first: x for rolls, y for pitches
_APART = 0.01  # m: axes of a hip or an ankle that lie closer count as meeting in one point
_LEAN = 0.02  # how far an axis may be off its own direction


@dataclass(frozen=True, eq=False)
class Legs:
    """Geometry of both legs, left before right, at zero joint angles in the base's frame (x forward, y left, z up), in m.

    The axes of hip and ankle meet in one point each; feet are parallel to the base at zero. Raises ModelError where a leg
    does not bend, or its hip yaw does not turn the foot.
    """

    joints: tuple[tuple[str, ...], tuple[str, ...]]
    hips: Array
    """(2, 3) centres of the hips."""
    yaw: Array
    """(2, 3) unit axes of the first joints."""
    signs: Array
    """(2, 6) -1 where a joint turns about -x (rolls) or -y (pitches)."""
    thigh: Array
    """(2, 2) knee from hip, forward and up."""
    shank: Array
    """(2, 2) ankle from knee."""
    lower: Array
    upper: Array
    """(2, 6) ranges of the joints, in rad."""
    shared: bool = False
    """One motor turns both first joints."""

    def __post_init__(self) -> None:
        """Checks the geometry."""
        for side, joints in enumerate(self.joints):
            if min(np.hypot(*self.thigh[side]), np.hypot(*self.shank[side])) < 1e-3:
                raise ModelError(f"leg {', '.join(joints)}: thigh and shank must be longer than a millimetre")
            if abs(self.yaw[side, 2]) < 0.1:
                raise ModelError(f"joint '{joints[0]}' turns about {self.yaw[side]}: the first joint must yaw the leg")

    @classmethod
    def of(
        cls, joints: tuple[tuple[str, ...], tuple[str, ...]], axes: Array, anchors: Array, lower: Array, upper: Array, *,
        shared: bool, model: str,
    ) -> Legs:  # fmt: skip
        """From axes (2, 6, 3) of the joints, points (2, 6, 3) on them, and ranges (2, 6), in the base's frame.

        Raises ModelError for legs of another build, naming joint and `model`.
        """
        _check(model, joints, axes, anchors)
        signs = np.ones((2, 6))
        signs[:, 1:] = [[np.sign(axes[s, j, _AXES[j]]) for j in range(1, 6)] for s in range(2)]
        return cls(
            joints=joints, hips=anchors[:, 2], yaw=axes[:, 0], signs=signs,
            thigh=(anchors[:, 3] - anchors[:, 2])[:, [0, 2]], shank=(anchors[:, 4] - anchors[:, 3])[:, [0, 2]],
            lower=lower, upper=upper, shared=shared,
        )  # fmt: skip

    @property
    def longest(self) -> Array:
        """(2,) m from hip to ankle of straight legs."""
        return np.hypot(*self.thigh.T) + np.hypot(*self.shank.T)

    def yawing(self, wanted: Array) -> Array:
        """(b, 2) angles of the first joints that yaw the legs by `wanted` (b, 2) rad, or nearly so where they are shared."""
        turned = wanted / self.yaw[:, 2]
        return np.repeat(turned.mean(axis=1, keepdims=True), 2, axis=1) if self.shared else turned

    def angles(
        self, yaw: Array, roll: Array, pitch: Array, length: Array, foot_roll: Array, foot_pitch: Array
    ) -> Array:
        """(b, 2, 6) joint angles in rad, not yet within their ranges. Arguments are (b, 2), in rad and m.

        `yaw` is the angle of the first joint. The ankle lies `length` from the hip, in the direction that points down, turned
        forward by `pitch`, then outward about x by `roll`, then about z by as much as the first joint yaws. The sole's
        normal is turned by `foot_pitch` about y (toes down), `foot_roll` about x, and that same yaw, all in the base's frame.
        """
        out = np.empty((*np.shape(yaw), 6))
        joint_angles(
            (yaw, roll, pitch, length, foot_roll, foot_pitch), self.yaw, self.thigh, self.shank, self.signs, out
        )
        return out


@dataclass(frozen=True, eq=False)
class Biped:
    """What a walk must know of a robot: its legs, and where their joints stand in commands and observations."""

    legs: Legs
    columns: Integers
    """(2, 6) of the legs' joints in commands; -1 where no motor turns one."""
    places: Integers
    """(2, 6) of the legs' joints in `Observation.position`."""
    rest: Array
    """(nu,) what all motors are commanded that do not move legs (in rad): arms and head keep still."""

    def commands(self, angles: Array) -> Array:
        """(b, nu) of angles (b, 2, 6), within the joints' ranges."""
        out = np.repeat(self.rest[None], len(angles), axis=0)
        moved = self.columns >= 0
        out[:, self.columns[moved]] = np.clip(angles, self.legs.lower, self.legs.upper)[:, moved]
        return out


def _check(model: str, names: Sequence[Sequence[str]], axes: Array, anchors: Array) -> None:
    for side in range(2):
        for j, axis in enumerate(_AXES):
            if axis is not None and abs(abs(axes[side, j, axis]) - 1.0) > _LEAN:
                raise ModelError(
                    f"joint '{names[side][j]}' of model '{model}' turns about {axes[side, j].round(3)}; a leg's "
                    f"{JOINTS[j]} turns about {'xyz'[axis]} at zero angles"
                )
        for a, b in ((0, 2), (1, 2), (4, 5)):
            apart = float(np.linalg.norm(anchors[side, a] - anchors[side, b]))
            if apart > _APART:
                raise ModelError(
                    f"joints '{names[side][a]}' and '{names[side][b]}' of model '{model}' lie {1e3 * apart:.0f} mm "
                    f"apart; the axes of a hip or an ankle must meet within {1e3 * _APART:.0f} mm"
                )
        aside = float(np.ptp(anchors[side, 2:5, 1]))
        if aside > _APART:
            raise ModelError(
                f"the leg of '{names[side][2]}' in model '{model}' is {1e3 * aside:.0f} mm out of its own plane"
            )
