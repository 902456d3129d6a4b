# SPDX-License-Identifier: Apache-2.0
"""What may be calibrated in actuators: the law of a servo, its limits and dead band, and what its commands go through."""

from __future__ import annotations

from trueup.articulated.changes import NO_ACCELERATION_LIMIT, NO_SPEED_LIMIT
from trueup.articulated.laws import Firmware
from trueup.articulated.quantities.quantity import Quantity, around, between, factor

DRIVES = (
    Quantity(
        name="kp", family="actuator", unit="N m/rad", title="servo stiffness", scale="log", bounds=factor(100, 30, 1.0),
        attributes=("actuator.kp",), start=None, servos_only=True,
        shown_by="holding against gravity in several poses, or stiff fast motion",
    ),
    Quantity(
        name="kv", family="actuator", unit="N m s/rad", title="servo damping", scale="log", bounds=factor(100, 30, 0.05),
        attributes=("actuator.kv",), start=None, servos_only=True, shown_by="fast motion",
    ),
    Quantity(
        name="force_limit", family="actuator", unit="N m", title="force limit", scale="log", bounds=factor(10, 10, 0.3),
        attributes=("actuator.force_limit",), start=None, needs="limit", nothing=1e6,
        shown_by="steps large enough to saturate the drive",
    ),
    Quantity(
        name="gain", family="actuator", unit="", title="factor on the actuator's force", scale="log",
        bounds=factor(5, 5, 1.0), attributes=("actuator.gain",), start=1.0, turn=1,
    ),
    Quantity(
        name="delay", family="actuator", unit="s", title="delay of the command", bounds=between(0.0, 0.1),
        attributes=("actuator.delay",), signals=("delay",), start=None,
        shown_by="fast steps or chirps, recorded at a high rate",
    ),
    Quantity(
        name="lead", family="actuator", unit="s", title="lead of the command: its speed fed forward, damping / stiffness",
        bounds=between(0.0, 0.5), signals=("lead",), servos_only=True, nothing=0.0,
        shown_by="smooth motion at several speeds, beside steps",
    ),
    Quantity(
        name="zero", family="actuator", unit="rad", title="zero error of the servo's own sensor", bounds=around(0.2),
        attributes=("actuator.zero",), start=None, servos_only=True, turn=2, shown_by="holding in several poses",
    ),
    Quantity(
        name="speed_limit", family="actuator", unit="rad/s", title="speed limit of the command", scale="log",
        bounds=factor(5, 1e3, 1.0), signals=("speed_limit",), servos_only=True, nothing=NO_SPEED_LIMIT,
        shown_by="steps large enough to reach it",
    ),
    Quantity(
        name="acceleration_limit", family="actuator", unit="rad/s2", title="acceleration limit of the command",
        scale="log", bounds=factor(20, 1e4, 10.0), signals=("acceleration_limit",), servos_only=True,
        nothing=NO_ACCELERATION_LIMIT, shown_by="fast chirps, or steps of several sizes",
    ),
    Quantity(
        name="dead_band", family="actuator", unit="rad", title="dead band", bounds=between(0.0, 0.1), law=Firmware,
        nothing=0.0, servos_only=True, shown_by="slow reversals of small amplitude",
    ),
    Quantity(
        name="punch", family="actuator", unit="N m", title="punch: least force once there is an error", scale="log",
        bounds=factor(100, 10, 0.01), law=Firmware, nothing=0.0, servos_only=True,
        shown_by="slow motion and small steps under load",
    ),
)  # fmt: skip
