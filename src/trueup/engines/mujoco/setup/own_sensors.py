# SPDX-License-Identifier: Apache-2.0
"""How late, or early, robots are seen by sensors beside the encoders of their joints."""

from __future__ import annotations

from collections.abc import Sequence

from trueup.articulated.declarations import Declaration
from trueup.engines.mujoco.model import Model
from trueup.inspection.scattered import seen_apart
from trueup.recording import Recording

OWN_SENSOR = "delay of a sensor of its own"
"""Of joints that were logged apart from the others."""


def of_sensors(model: Model, joints: Sequence[str], recordings: Sequence[Recording]) -> list[Declaration]:
    """How late joints are seen that were logged apart from the others: a camera's images come late, and clocks differ. And
    what inertial sensors tell beside encoders: they smooth it, and may have a clock of their own. That is searched as the
    delay of drives is, which takes its place elsewhere, and leaves encoders as they are.
    """
    apart = tuple(j for j in joints if j in seen_apart(recordings))
    lines = [Declaration("joint_sensor_delay", apart, optional=OWN_SENSOR)] if apart else []
    beside = {name for r in recordings if r.has("position") for name in r.channels}
    mounted = dict[tuple[int, int], list[str]]()
    for i, name in enumerate(model.names("sensor")):
        if name in beside:
            place = int(model.compiled.sensor_objtype[i]), int(model.compiled.sensor_objid[i])
            mounted.setdefault(place, []).append(name)
    groups = tuple("+".join(names) for names in mounted.values())
    return lines + ([Declaration("sensor_delay", groups, lower=-0.1)] if groups else [])
