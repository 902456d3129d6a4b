# SPDX-License-Identifier: Apache-2.0
"""Which joints of a robot mirror one another, by where their axes lie.

A rotation about an axis a, mirrored at a plane with normal n, is the same rotation about 2 (a.n) n - a: axes are
pseudovectors.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.samples import SLIGHT

_SIDES = re.compile(
    r"(?i:(^|[_.\-])(left|right|l|r)(?=[_.\-]|$))|(?<=[a-z0-9])(Left|Right|L|R)$|^(left|right|Left|Right|[lrLR](?=[A-Z]))"
)


@dataclass(frozen=True, eq=False)
class Posture:
    """A named keyframe of a model."""

    name: str
    joints: Array
    """(k,) of the commanded joints, in rad."""
    position: Array
    """(3,) of the base, in m."""
    angles: Array
    """(3,) roll, pitch, yaw of the base, in rad."""

    @property
    def inverted(self) -> bool:
        """Whether the base's z axis points down."""
        return bool(np.cos(self.angles[0]) * np.cos(self.angles[1]) < 0.0)


@dataclass(frozen=True)
class Mirrored:
    """Joints that move as one in a symmetric motion: a pair with its signs, or one joint in the middle."""

    name: str
    joints: tuple[str, ...]
    signs: tuple[float, ...]
    sagittal: bool
    """Whether it turns about the axis from one side to the other, as hips, knees and ankles do when one rises."""


def mirrored_at_best(joints: tuple[str, ...], anchors: Array, axes: Array) -> tuple[Mirrored, ...]:
    """Joints with points (k, 3) and directions (k, 3) of their axes at zero angles, in the base's frame.

    Mirrored at the plane through the base, along its x or y axis, at which most of them find a partner; of several partners
    the one named alike counts.
    """
    planes = (_pairs(joints, anchors, axes, normal) for normal in np.eye(3)[[1, 0]])
    return max(planes, key=lambda plane: sum(len(m.joints) == 2 for m in plane))


def _pairs(joints: tuple[str, ...], anchors: Array, axes: Array, normal: Array) -> tuple[Mirrored, ...]:
    """Joints mirrored at the plane through the base with a normal, each pair once, in the order of the joints."""
    size = float(np.ptp(anchors, axis=0).max()) or 1.0
    flipped = anchors - 2.0 * (anchors @ normal)[:, None] * normal
    wanted = 2.0 * (axes @ normal)[:, None] * normal - axes
    taken: set[int] = set()
    found = []
    for i, joint in enumerate(joints):
        if i in taken:
            continue
        apart = np.linalg.norm(anchors - flipped[i], axis=1) / size
        along = axes @ wanted[i]
        partners = [
            j for j in np.flatnonzero((apart < SLIGHT) & (np.abs(along) > 1.0 - SLIGHT)).tolist() if j not in taken
        ]
        others = [j for j in partners if j != i]
        sagittal = bool(abs(axes[i] @ normal) > 1.0 - SLIGHT)
        alike = [j for j in others if _bare(joints[j]) == _bare(joint)]
        if others and abs(anchors[i] @ normal) / size > SLIGHT / 2:
            j = (alike or others)[0]
            taken |= {i, j}
            found.append(Mirrored(_bare(joint), (joint, joints[j]), (1.0, float(np.sign(along[j]))), sagittal))
        elif abs(anchors[i] @ normal) / size <= SLIGHT / 2:
            taken.add(i)
            found.append(Mirrored(joint, (joint,), (1.0,), sagittal))
    return tuple(found)


def _bare(name: str) -> str:
    """A joint's name without its side: 'l_knee', 'knee_right' and 'LKnee' are 'knee'."""
    return _SIDES.sub("", name).strip("_.- ") or name
