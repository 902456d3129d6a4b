# SPDX-License-Identifier: Apache-2.0
"""Servos that were told to speed up more than any like them did: limits of speed and acceleration that may be their own."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence

import numpy as np

from trueup.articulated.declarations import Declaration
from trueup.articulated.quantities.known import quantity
from trueup.instant import CUBIC, usual_step
from trueup.recording import Channel, Recording
from trueup.trial import command_of

LIMITS = ("acceleration limit of commands", "speed limit of commands")
"""The optional structures, in the order in which they are asked about."""
_BELOW = 4.0  # times: a drive overshoots its own profile, so that what it did may have been asked for by less
_REACH = 1.5  # times the limit at least that must have been asked for, or it was not met


def asked_for(
    joints: Mapping[str, str], laws: Mapping[str, Hashable], recordings: Sequence[Recording]
) -> list[Declaration]:
    """Declarations of limits that are searched from a fit without them: from what like servos delivered to what was asked.

    `joints` with the names of their actuators; like servos have the same law in `laws`, by joint. Firmware moves its set
    point within limits of its own (profile velocity and acceleration), whatever it is told; a joint that follows all that it
    is told can have none that matters.
    """
    asked = {j: _most(recordings, {j, a}, command=True) for j, a in joints.items()}
    done = {j: _most(recordings, {j, a}, command=False) for j, a in joints.items()}
    lines = []
    for order, (name, structure) in enumerate(zip(("acceleration_limit", "speed_limit"), LIMITS, strict=True)):
        for joint in joints:
            like = [other for other in joints if laws[other] == laws[joint]]
            delivered, told = max(done[other][order] for other in like), asked[joint][order]
            lower, upper = delivered / _BELOW, min(told / _REACH, 0.5 * (quantity(name).nothing or np.inf))
            if delivered > 0.0 and told > delivered and upper > lower:
                lines.append(Declaration(name, (joint,), nominal=float(np.sqrt(lower * upper)), lower=lower, upper=upper,
                                         optional=structure))  # fmt: skip
    return lines


def _most(recordings: Sequence[Recording], names: set[str], *, command: bool) -> tuple[float, float]:
    """Largest acceleration and speed that a joint, of either of these names, was told, from sample to sample, or was measured
    to have; 0 for none.
    """
    most = np.zeros(2)
    for recording in recordings:
        channel = (
            command_of(recording) if command else recording.channel("position") if recording.has("position") else None
        )
        label = next((x for x in channel.labels if x in names), "") if channel is not None else ""
        if channel is not None and label and channel.unit in ("rad", "m"):
            most = np.maximum(most, _rates(channel, label, 0.0 if command else CUBIC))
    return float(most[0]), float(most[1])


def _rates(channel: Channel, label: str, over: float) -> tuple[float, float]:
    """Largest second and first difference quotient over `over` s, or a sample where that is longer."""
    good = np.isfinite(channel.column(label))
    time, values = channel.time[good], channel.column(label)[good]
    if len(time) < 5:
        return 0.0, 0.0
    dt = usual_step(time)
    n = max(1, round(over / dt))
    if len(values) <= 2 * n or not dt > 0.0:
        return 0.0, 0.0
    second = np.abs(values[2 * n :] - 2.0 * values[n:-n] + values[: -2 * n]) / (n * dt) ** 2
    first = np.abs(values[n:] - values[:-n]) / (n * dt)
    return float(second.max()), float(first.max())
