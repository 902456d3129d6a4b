# SPDX-License-Identifier: Apache-2.0
"""Joints that really were where their range in the model does not let them go."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.scales import ways
from trueup.errors import listed
from trueup.inspection.ranges import turned_beyond
from trueup.recording import Recording


def unstopped(model: Model, recordings: Sequence[Recording]) -> Model:
    """The model without the ranges of hinges that were measured beyond them.

    Simulated, such a joint would stop where the robot did not, and what is fitted would make up for that.
    """
    own = {j.name for j in model.spec.joints}
    found = [name for name in turned_beyond(ways(model), recordings) if name in own]
    if not found:
        return model
    spec = model.spec.copy()
    for name in found:
        spec.joint(name).limited = mujoco.mjtLimited.mjLIMITED_FALSE
    note = (
        f"joints were measured beyond their range in the model ({listed(found)}), which does not stop them in replays; the "
        "written file keeps it: mend it there, or the zero, sense or unit in the mapping"
    )
    return model.changed(spec, "without ranges of joints", note)
