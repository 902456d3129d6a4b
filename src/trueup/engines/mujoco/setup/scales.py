# SPDX-License-Identifier: Apache-2.0
"""Positions whose unit nobody said (see `inspection.scales`), by how far the joints of a model can move."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from trueup.engines.mujoco.model import Model
from trueup.inspection import scales
from trueup.recording import Recording


def with_units(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """See `inspection.scales.with_units`."""
    return scales.with_units(ways(model), recordings)


def of_slides(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """See `inspection.scales.of_slides`."""
    return scales.of_slides(ways(model), recordings)


def ways(model: Model) -> dict[str, scales.Way]:
    """How each hinge and slide joint of a model moves, in its order."""
    m, found = model.compiled, {}
    for joint in model.scalar_joints():
        j = model.index("joint", joint)
        low, high = m.jnt_range[j]
        limited = (float(low), float(high)) if m.jnt_limited[j] else None
        found[joint] = scales.Way(bool(m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE), limited)
    return found
