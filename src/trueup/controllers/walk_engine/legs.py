# SPDX-License-Identifier: Apache-2.0
"""Legs of up to six joints: from where a leg points, how long it is and how its foot lies to joint angles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trueup.arrays import Array, Integers
from trueup.controllers.walk_engine.chain import refine
from trueup.controllers.walk_engine.kernel import joint_angles
from trueup.errors import ModelError

JOINTS = ("hip yaw", "hip roll", "hip pitch", "knee", "ankle pitch", "ankle roll")
"""What a leg's joints do, in the order in which its angles are kept; the first may turn about any axis that is not level (a
NAO's turns about yaw and pitch at once)."""
AXES = np.array([[axis == about for axis in "xyz"] for about in "zxyyyx"], dtype=np.float64)
"""(6, 3) what they turn about: z for the yaw, x for rolls, y for pitches."""
SPARED = {"hip yaw": "hip pitch", "ankle roll": "hip roll"}
"""Those that a leg may lack (then it cannot turn, or its sole cannot roll), to the joint beside which they would be."""
_ALONG, _UPRIGHT = 0.9, 0.5  # cosines: what an axis is for, where it is not quite its own direction
_BENT = 0.5  # rad that a knee must be able to bend
_APART, _LEAN = 0.01, 0.02  # m, and of unit axes: what is nearer counts as meeting, or as along its direction


@dataclass(frozen=True, eq=False)
class Legs:
    """Geometry of both legs, left before right, at zero joint angles in the base's frame (x forward, y left, z up), in m.

    Feet are parallel to the base at zero. Raises ModelError where a leg does not bend forward, or its hip yaw does not turn
    the foot.
    """

    joints: tuple[tuple[str, ...], tuple[str, ...]]
    """By what they do (`JOINTS`), '' for those that a leg lacks."""
    order: Integers
    """(2, 6) places in `JOINTS` of a leg's joints from the hip down, -1 after the last."""
    axes: Array
    anchors: Array
    """(2, 6, 3) unit axes of the joints, and points on them."""
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
            bent = max(self.signs[side, 3] * self.lower[side, 3], self.signs[side, 3] * self.upper[side, 3])
            if bent < _BENT:
                raise ModelError(
                    f"joint '{joints[3]}' bends the knee to the front by {max(bent, 0.0):.2g} rad at most, from zero on; "
                    f"this walk needs {_BENT:g} rad (legs that bend backward want a walk of your own)"
                )

    @cached_property
    def signs(self) -> Array:
        """(2, 6) -1 where a joint turns about -x (rolls) or -y (pitches), 0 where a leg lacks it."""
        signs = np.sign(np.sum(self.axes * AXES, axis=2))
        signs[:, 0] = 1.0
        return np.where([[bool(n) for n in names] for names in self.joints], signs, 0.0)

    @property
    def yaw(self) -> Array:
        """(2, 3) unit axes of the first joints."""
        return self.axes[:, 0]

    @property
    def hips(self) -> Array:
        """(2, 3) where legs turn: on the axis of the hip's pitch, above the ankle."""
        return np.stack([self.anchors[:, 2, 0], self.ankles[:, 1], self.anchors[:, 2, 2]], axis=1)

    @property
    def ankles(self) -> Array:
        """(2, 3) on the axis of the ankle's pitch, in the plane of its roll."""
        return np.stack([self.anchors[:, 4, 0], self.anchors[:, 5, 1], self.anchors[:, 4, 2]], axis=1)

    @cached_property
    def thigh(self) -> Array:
        """(2, 2) knee from hip, forward and up."""
        return (self.anchors[:, 3] - self.anchors[:, 2])[:, [0, 2]]

    @cached_property
    def shank(self) -> Array:
        """(2, 2) ankle from knee."""
        return (self.anchors[:, 4] - self.anchors[:, 3])[:, [0, 2]]

    @cached_property
    def longest(self) -> Array:
        """(2,) m from hip to ankle of straight legs."""
        return np.hypot(*self.thigh.T) + np.hypot(*self.shank.T)

    @cached_property
    def plain(self) -> bool:
        """Whether a closed form holds: yaw, roll and pitch meet in the hip, pitch and roll in the ankle, in this order."""
        along = np.where(self.signs == 0.0, 1.0, self.signs)
        ideal = np.concatenate([self.axes[:, :1], along[:, 1:, None] * AXES[1:]], axis=1)
        ends = np.stack([self.hips] * 4 + [self.ankles] * 2, axis=1)
        away = np.linalg.norm(np.cross(ends - self.anchors, self.axes), axis=2)
        away[:, 3] = 0.0  # a knee lies between
        return bool(
            (self.order == np.arange(6)).all() and np.abs(ideal - self.axes).max() < _LEAN and away.max() < _APART
        )

    def yawing(self, wanted: Array) -> Array:
        """(b, 2) angles of the first joints that yaw the legs by `wanted` (b, 2) rad, or nearly so where they are shared."""
        turned = wanted * self.signs[:, 0] / self.yaw[:, 2]
        return np.repeat(0.5 * (turned[:, :1] + turned[:, 1:]), 2, axis=1) if self.shared else turned

    def angles(
        self, yaw: Array, roll: Array, pitch: Array, length: Array, foot_roll: Array, foot_pitch: Array
    ) -> Array:
        """(b, 2, 6) joint angles in rad, not yet within their ranges. Arguments are (b, 2), in rad and m.

        `yaw` is the angle of the first joint. The ankle lies `length` from the hip, in the direction that points down, turned
        forward by `pitch`, then outward about x by `roll`, then about z by as much as the first joint yaws. The sole's
        normal is turned by `foot_pitch` about y (toes down), `foot_roll` about x, and that same yaw, all in the base's frame.
        Of legs of another build than the closed form's, whose foot also points where that yaw does, in all the nearest.
        """
        out = np.empty((*np.shape(yaw), 6))
        wanted = (yaw, roll, pitch, length, foot_roll, foot_pitch)
        joint_angles(wanted, self.yaw, self.thigh, self.shank, self.signs, out)
        if not self.plain:
            refine(
                wanted,
                self.yaw[:, 2].copy(),
                self.hips,
                self.ankles,
                self.longest,
                self.order,
                self.axes,
                self.anchors,
                out,
            )
        return out


def roles(model: str, names: Sequence[str], axes: Array) -> tuple[int, ...]:
    """Places in `JOINTS` of a leg's joints, given from the hip down with their axes (k, 3), in the base's frame.

    Raises ModelError for legs of another build, naming joints, axes and `model`.
    """
    kinds = [_kind(axis) for axis in axes]
    said = ", ".join(f"'{n}' ({k or f'about {np.round(a, 2)}'})" for n, k, a in zip(names, kinds, axes, strict=True))
    pitches = [k for k, kind in enumerate(kinds) if kind == "pitch"]
    if len(pitches) != 3:
        turned = "; its knees turn about the base's x axis: x must point forward" if kinds.count("roll") > 2 else ""
        raise ModelError(
            f"a leg of model '{model}' has {len(pitches)} joints that pitch (turn about the base's y axis at zero angles); a "
            f"walk needs those of hip, knee and ankle{turned}. From the hip down it has: {said}"
        )
    out = []
    for k, kind in enumerate(kinds):
        above, below = k < pitches[1], k > pitches[1]
        places = {"pitch": 2 + pitches.index(k) if k in pitches else -1, "roll": 1 if above else 5 if below else -1}
        out.append(places.get(kind, 0 if kind == "yaw" and above else -1))
    lacking = [name for j, name in enumerate(JOINTS) if j not in out and name not in SPARED]
    if lacking or -1 in out or len(set(out)) < len(out):
        why = f"lacks a {lacking[0]}" if lacking else "has other joints than a walk knows"
        raise ModelError(
            f"a leg of model '{model}' {why} ({', '.join(JOINTS)}, in any order above and below the knee; the "
            f"first and the last may be missing). From the hip down it has: {said}"
        )
    return tuple(out)


def _kind(axis: Array) -> str:
    """What a joint does to a leg that hangs down; '' for oblique axes."""
    x, y, z = np.abs(axis)
    return "pitch" if y > _ALONG else "roll" if x > _ALONG else "yaw" if z > _UPRIGHT else ""


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
        columns, moved = self._moved
        within = np.minimum(np.maximum(angles, self.legs.lower), self.legs.upper)
        out[:, columns] = within.reshape(len(angles), -1)[:, moved]
        return out

    @cached_property
    def _moved(self) -> tuple[Integers, Integers]:
        """Columns of commands, and places of the angles (12) that they take."""
        places = np.flatnonzero(self.columns >= 0)
        return self.columns.reshape(-1)[places], places
