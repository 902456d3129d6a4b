# SPDX-License-Identifier: Apache-2.0
"""Positions whose unit nobody said (see `inspection.scales`), by how far the joints of a model can move."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.tendons import pulls
from trueup.inspection import scales
from trueup.recording import Recording


def with_units(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """See `inspection.scales.with_units`."""
    return scales.with_units(ways(model) | _of_several(model), recordings)


def of_slides(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """See `inspection.scales.of_slides`."""
    return scales.of_slides(ways(model) | _of_several(model), recordings)


def ways(model: Model) -> dict[str, scales.Way]:
    """How each hinge and slide joint of a model moves, in its order."""
    m, found = model.compiled, {}
    for joint in model.scalar_joints():
        j = model.index("joint", joint)
        low, high = m.jnt_range[j]
        limited = (float(low), float(high)) if m.jnt_limited[j] else None
        found[joint] = scales.Way(bool(m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE), limited)
    return found


def _of_several(model: Model) -> dict[str, scales.Way]:
    """How far servos go that pull at several slides, as of a gripper; not those named as a joint."""
    joints, found = ways(model), {}
    for drive, moved in pulls(model).items():
        servo = model.is_position_servo(model.index("actuator", drive))
        if drive in joints or not servo or not all(joints[j].slides for j in moved):
            continue
        reaches = [sorted(weight * end for end in joints[j].range or ()) for j, weight in moved.items()]
        ends = (sum(low for low, _ in reaches), sum(high for _, high in reaches)) if all(reaches) else None
        found[drive] = scales.Way(True, ends, tuple(moved))
    return found
