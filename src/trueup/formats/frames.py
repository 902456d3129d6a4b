# SPDX-License-Identifier: Apache-2.0
"""Transforms between frames, as ROS publishes all of them on one topic, made into the pose of a robot's base."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.formats.messages import seconds_of

KIND = "tfmessage"
"""How the type of such messages ends, without capitals."""
_BASES = ("base_footprint", "base_link", "base")
"""What the frame of a robot on a floor is called, the first choice first."""
_AXES = (*(f"translation.{axis}" for axis in "xyz"), *(f"rotation.{axis}" for axis in "xyzw"))


@dataclass
class Link:
    """How one frame lay in another, sample by sample."""

    stamps: list[float] = field(default_factory=list)
    received: list[float] = field(default_factory=list)
    poses: list[list[float]] = field(default_factory=list)
    """x, y, z in m and a quaternion x, y, z, w."""

    def held(self, times: Array) -> Array:
        """(T, 7) the last pose at each instant, the first one before it."""
        order = np.argsort(self.stamps, kind="stable")
        last = np.searchsorted(np.array(self.stamps)[order], times, side="right") - 1
        return np.array(self.poses)[order[np.maximum(last, 0)]]


Links = dict[tuple[str, str], Link]
"""By parent and child."""


def take(message: Any, received: float, links: Links) -> None:
    """Adds the transforms of a message that was received at a time in s."""
    for one in message.transforms:
        pair = (str(one.header.frame_id).lstrip("/"), str(one.child_frame_id).lstrip("/"))
        move, turn = one.transform.translation, one.transform.rotation
        if not any((turn.x, turn.y, turn.z, turn.w)):
            continue  # no rotation at all: ROS takes none of these either
        link, stamp = links.setdefault(pair, Link()), seconds_of(one.header.stamp)
        link.stamps.append(stamp or received)
        link.received.append(received)
        link.poses.append([float(v) for v in (move.x, move.y, move.z, turn.x, turn.y, turn.z, turn.w)])


def base(links: Mapping[tuple[str, str], Link]) -> tuple[str, Link] | None:
    """The pose of the base in the frame that all others hang on, and what leads there ("map > odom > base_link"); of a
    single link whatever it is called. None where no frame is called a base.
    """
    parents = {child: parent for parent, child in links}
    if len(links) == 1:
        child = next(iter(parents))
    else:
        named = [c for name in _BASES for c in parents if c.split("/")[-1] == name]
        child = next(iter(named), "")
    chain = [child]
    while chain[0] in parents and parents[chain[0]] not in chain:
        chain.insert(0, parents[chain[0]])
    if len(chain) < 2:
        return None
    along = [links[pair] for pair in pairwise(chain)]
    moving = max(along, key=lambda link: len(link.stamps))
    times = np.array(moving.stamps)
    pose = along[0].held(times)
    for link in along[1:]:
        pose = _composed(pose, link.held(times))
    return " > ".join(chain), Link(moving.stamps, moving.received, pose.tolist())


def cells(link: Link) -> dict[str, list[float | None]]:
    """Columns, named as those of a message of one transform."""
    return {f"transforms/0.transform.{n}": list(c) for n, c in zip(_AXES, zip(*link.poses, strict=True), strict=True)}


def _composed(outer: Array, inner: Array) -> Array:
    """(T, 7) poses of a frame in the outermost one, from those of its parent there and its own in the parent."""
    from scipy.spatial.transform import Rotation  # half a second that other files do not need

    turn = Rotation.from_quat(outer[:, 3:])
    return np.hstack([outer[:, :3] + turn.apply(inner[:, :3]), (turn * Rotation.from_quat(inner[:, 3:])).as_quat()])
