# SPDX-License-Identifier: Apache-2.0
"""What acts in each step of a simulation: what firmware makes of an error, friction that depends on speed and load."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from trueup.arrays import Array
from trueup.articulated.kernels import firmware_command, stribeck_friction
from trueup.articulated.model import Copies, Model

STRIBECK_SPEED = 0.05
"""rad/s at which breakaway friction has faded where no parameter says it: an ordinary value of greased gears (Armstrong-
Helouvry et al. 1994, table 3: 0.01 to 0.1)."""


@dataclass(frozen=True, eq=False)
class Term:
    """What one quantity says of one target."""

    quantity: str
    target: str
    value: Array
    """(b,)"""


class Law(Protocol):
    """Something that acts before each step of the first n copies."""

    def act(self, command: Array) -> None:
        """Changes the commands (n, width) in place, or attributes of the copies."""
        ...


LawFactory = Callable[[Model, Copies, Sequence[Term]], Law]


class Firmware:
    """Servos that do not push while their error is small (`dead_band`, end to end), then at least with their `punch`."""

    def __init__(self, model: Model, copies: Copies, terms: Sequence[Term]) -> None:
        joint_of = {actuator: joint for joint, actuator in model.drives().items() if actuator}
        targets = list(dict.fromkeys(t.target for t in terms))
        self._columns = np.array([model.columns()[t] for t in targets], dtype=np.int64)
        self._position = copies.reader("position", [joint_of[t] for t in targets])
        self._zero = np.stack([copies.get("actuator.zero", t) for t in targets], axis=1)
        self._band, self._kick = np.zeros((2, len(terms[0].value), len(targets)))
        for term in terms:
            place = (slice(None), targets.index(term.target))
            if term.quantity == "punch":
                self._kick[place] = term.value / copies.get("actuator.kp", term.target)
            else:
                self._band[place] = 0.5 * term.value  # the error may grow to half of it on either side

    def act(self, command: Array) -> None:
        """See Law."""
        n, shaped = len(command), np.empty((len(command), len(self._columns)))
        asked = np.ascontiguousarray(command[:, self._columns])
        firmware_command(asked + self._zero[:n], self._position(n), self._band[:n], self._kick[:n], shaped)
        command[:, self._columns] = shaped - self._zero[:n]


class VaryingFriction:
    """Joints whose friction is larger at rest (`friction_static`, `stribeck_speed`) and under load (`friction_load`)."""

    def __init__(self, model: Model, copies: Copies, terms: Sequence[Term]) -> None:
        joints = list(dict.fromkeys(t.target for t in terms))
        self._coulomb = np.stack([copies.get("joint.friction", j) for j in joints], axis=1)
        parts = {
            "friction_static": np.zeros(self._coulomb.shape),
            "stribeck_speed": np.full(self._coulomb.shape, STRIBECK_SPEED),
            "friction_load": np.zeros(self._coulomb.shape),
        }
        for term in terms:
            parts[term.quantity][:, joints.index(term.target)] = term.value
        self._static, self._speed, self._load = parts.values()
        self._velocity, self._force = copies.reader("velocity", joints), copies.reader("force", joints)
        self._write = copies.writer("joint.friction", joints)

    def act(self, command: Array) -> None:
        """See Law."""
        n, shaped = len(command), np.empty((len(command), self._coulomb.shape[1]))
        stribeck_friction(
            self._velocity(n),
            self._force(n),
            self._coulomb[:n],
            self._static[:n],
            self._speed[:n],
            self._load[:n],
            shaped,
        )
        self._write(shaped)
