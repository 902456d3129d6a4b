# SPDX-License-Identifier: Apache-2.0
"""What acts in each step of a simulation: dead bands of servos, friction that depends on speed and load."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trueup.articulated.kernels import dead_band_command, stribeck_friction
from trueup.articulated.model import Copies, Model

Array = NDArray[np.float64]

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


class DeadBand:
    """Servos that do not push while their error is small; `dead_band` is given end to end."""

    def __init__(self, model: Model, copies: Copies, terms: Sequence[Term]) -> None:
        joint_of = {actuator: joint for joint, actuator in model.drives().items() if actuator}
        self._columns = np.array([model.columns()[t.target] for t in terms], dtype=np.int64)
        self._position = copies.reader("position", [joint_of[t.target] for t in terms])
        # The error may grow to half of it on either side.
        self._band = np.ascontiguousarray(np.stack([0.5 * t.value for t in terms], axis=1))

    def act(self, command: Array) -> None:
        """See Law."""
        n, shaped = len(command), np.empty((len(command), len(self._columns)))
        asked = np.ascontiguousarray(command[:, self._columns])
        dead_band_command(asked, self._position(n), self._band[:n], shaped)
        command[:, self._columns] = shaped


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
