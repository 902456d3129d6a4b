# SPDX-License-Identifier: Apache-2.0
"""What may be calibrated in what was recorded: errors and delays of sensors, clocks, and where runs began."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trueup.articulated.model import Model
from trueup.articulated.quantities.quantity import Quantity, around, between
from trueup.instant import REACH


@dataclass(frozen=True, kw_only=True)
class JointInRecording(Quantity):
    """Something of one joint in one recording; targets are 'recording:joint'."""

    def choices(self, model: Model, extra: Mapping[str, Sequence[str]]) -> dict[str, str]:
        """See Quantity."""
        return {f"{r}:{j}": f"{r}:{j}" for r in extra.get("recording", ()) for j in model.drives()}


SIGNALS = (
    Quantity(
        name="bias", family="joint", unit="rad", title="error of the position sensor", bounds=around(0.2),
        signals=("sensor",), shown_by="holding in several poses",
    ),
    Quantity(
        name="offset", family="joint", unit="rad", title="zero error shared by sensor and command", bounds=around(0.2),
        signals=("sensor", "command"), shown_by="holding against gravity in several poses",
    ),
    Quantity(
        name="sensor_delay", family="channel", unit="s", title="delay of a measured channel", bounds=between(0.0, 0.1),
        signals=("sensor_delay",),
    ),
    Quantity(
        name="joint_sensor_delay", family="joint", unit="s", title="delay of the joint's own sensor", bounds=around(REACH),
        signals=("joint_sensor_delay",), shown_by="motion that a drive commands, seen by both sensors",
    ),
    Quantity(
        name="clock", family="recording", unit="s", title="how late the commands' time stamps are", bounds=around(0.1),
        signals=("clock",), shown_by="fast steps or chirps, recorded at a high rate",
    ),
    JointInRecording(
        name="start_position", family="recording", unit="rad", title="correction of the start position",
        bounds=around(0.2), signals=("start_position",),
    ),
    JointInRecording(
        name="start_velocity", family="recording", unit="rad/s", title="correction of the start speed",
        bounds=around(2.0), signals=("start_velocity",),
    ),
)  # fmt: skip
