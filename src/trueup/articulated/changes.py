# SPDX-License-Identifier: Apache-2.0
"""What parameters change in signals rather than in a model: delays, limits of commands, errors of sensors and clocks."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from trueup.arrays import Array
from trueup.errors import unknown_name

NO_SPEED_LIMIT, NO_ACCELERATION_LIMIT = 1e4, 1e6
"""rad/s and rad/s2: limits of a command from here on are none."""

SIGNALS: Mapping[str, str] = {
    "delay": "of an actuator's command, s",
    "lead": "how far ahead along its own speed an actuator's command is taken, s",
    "speed_limit": "of an actuator's command, rad/s",
    "acceleration_limit": "of an actuator's command, rad/s2",
    "command": "what a joint's servo takes off its command, rad",
    "sensor": "what a joint's position sensor adds to the truth, rad",
    "sensor_delay": "how late a channel is measured, s",
    "joint_sensor_delay": "how late a joint's own sensor tells of it, s",
    "clock": "how late a recording's commands are stamped, s",
    "start_position": "correction of 'recording:joint', rad",
    "start_velocity": "correction of 'recording:joint', rad/s",
}
"""Each signal, of what, and its unit."""


class Changes:
    """Values (b,) by signal and target; what several quantities add to one target is summed."""

    def __init__(self) -> None:
        self._added: dict[str, dict[str, Array]] = {name: {} for name in SIGNALS}

    def add(self, signal: str, target: str, value: Array) -> None:
        """Adds (b,). Raises UnknownNameError for a signal that is none of SIGNALS."""
        if signal not in self._added:
            raise unknown_name("signal", signal, SIGNALS, "what quantities may change")
        there = self._added[signal]
        there[target] = there[target] + value if target in there else np.array(value)

    def of(self, signal: str) -> Mapping[str, Array]:
        """Target to (b,), for those that anything changes."""
        return self._added[signal]
