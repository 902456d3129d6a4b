# SPDX-License-Identifier: Apache-2.0
"""What to calibrate, when nobody says, of a base that moves freely and of the floor that it stands on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.articulated.declarations import Declaration, of_contacts
from trueup.articulated.pose import POSITION
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.floor_plane import plane_of
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.floor import Reach
from trueup.engines.simulator import CONTACTS
from trueup.recording import Recording
from trueup.trial import LOOK

HEIGHT, TILTS = "height of the floor", {"floor_roll": "floor turned about x", "floor_pitch": "floor turned about y"}
"""Of the floor that a robot stands on, and of one that the model lacks."""
_OF_BASE = ("mass", "com_x", "com_y", "com_z", "spread_x", "spread_y", "spread_z")
"""Of the body that moves freely: what it carries (a battery, a computer) is seldom in its file, and all of it but products of
inertia is seen where it is tracked while it walks. What is left out is made up for: with a trunk of 6.7 kg whose inertia
grew along in the simulator and not in the robot, gains came out 4.5 % high, in intervals of 1 %.
"""


def of_a_floor(height: float) -> list[Declaration]:
    """Of one that the model lacks: where the robot was stopped is no more than a first guess of its height."""
    return [
        Declaration("floor_height", nominal=height),
        *(Declaration(kind, optional=tilt) for kind, tilt in TILTS.items()),
        Declaration("floor_friction"),
    ]


def of_the_base(model: Model, recordings: Sequence[Recording]) -> list[Declaration]:
    """What a base that was tracked tells beyond its joints: what it carries, and the floor that it stands on."""
    compiled = model.compiled
    joint = free_joint(compiled)
    if joint < 0 or not any(r.has(POSITION) for r in recordings):
        return []
    body = compiled.body(compiled.jnt_bodyid[joint]).name
    lines = [Declaration(kind, (body,)) for kind in _OF_BASE] if body else []
    if plane_of(compiled) >= 0:
        lines += [Declaration("floor_height", optional=HEIGHT), Declaration("floor_friction")]
    return lines


def of_what_touches(model: Model, recordings: Sequence[Recording]) -> list[Declaration]:
    """Of a robot on a rail or boom that reaches the model's floor as it was measured: how its feet slide, and how soft its
    contacts are. A leg that squats there slides its foot with as much force as it carries: with 1 in place of a true 0.8
    gains, rotors and damping made up for it. A file's time constant is seldom more than MuJoCo's own, and they do so, too.
    """
    if free_joint(model.compiled) >= 0 or plane_of(model.compiled) < 0:
        return []
    reach = Reach(model)
    if not reach.clouds or not any(_touches(reach, r) for r in recordings):
        return []
    return [Declaration("floor_friction"), *(replace(line, optional=CONTACTS) for line in of_contacts(model))]


def _touches(reach: Reach, recording: Recording) -> bool:
    if not recording.has("position"):
        return False
    seen = recording.channel("position")
    known = [label for label in seen.labels if label in reach.joints]
    rows = np.unique(np.searchsorted(seen.time, np.arange(seen.time[0], seen.time[-1], LOOK)))
    poses = seen.select(known).values[rows]
    return bool(np.any(reach.lowest(known, poses[np.isfinite(poses).all(axis=1)]) <= 0.0))
