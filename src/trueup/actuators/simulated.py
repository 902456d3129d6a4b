# SPDX-License-Identifier: Apache-2.0
"""An identified servo in trueup's own simulators: a quantity whose law acts before each step on a motor of the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.actuators.replay import compiled_drive
from trueup.actuators.servo import REMEMBERED, Law
from trueup.arrays import Array
from trueup.articulated.laws import Term
from trueup.articulated.model import Copies, Model
from trueup.articulated.quantities.quantity import Quantity, factor
from trueup.compiled import njit
from trueup.errors import ModelError


def servo_quantity(law: Law) -> Quantity:
    """What makes a plain motor of a model (`<motor>`, gear 1) this servo, commanded by position.

    Its value is the servo's proportional setting over the one that the law stands for. The joint's armature is to be
    `law.armature`; its damping and dry friction are written in each step.
    """

    def acting_servos(model: Model, copies: Copies, terms: Sequence[Term]) -> ActingServos:
        return ActingServos(law, model, copies, terms)

    return Quantity(
        name="servo", family="actuator", unit="", title="proportional setting of an identified servo", scale="log",
        bounds=factor(20, 20, 1.0), law=acting_servos, start=1.0,
    )  # fmt: skip


class ActingServos:
    """Turns commanded positions into torques, for all copies at once (`articulated.laws.Law`)."""

    def __init__(self, law: Law, model: Model, copies: Copies, terms: Sequence[Term]) -> None:
        joint_of = {actuator: joint for joint, actuator in model.drives().items() if actuator}
        for term in terms:
            if float(model.get("actuator.torque", term.target)[0]) != 1.0:
                raise ModelError(
                    f"actuator '{term.target}' is not a motor of gear 1: an identified servo needs one to act by"
                )
        joints = [joint_of[t.target] for t in terms]
        self._law, self._columns = law, np.array([model.columns()[t.target] for t in terms], dtype=np.int64)
        self._gain = np.ascontiguousarray(np.stack([t.value for t in terms], axis=1))
        self._state = np.zeros((*self._gain.shape, len(REMEMBERED)))
        self._step = float(copies.get("world.step", "world")[0])
        self._read = [copies.reader(state, joints) for state in ("position", "velocity", "bias")]
        self._write = copies.writer("joint.damping", joints), copies.writer("joint.friction", joints)
        self._told: list[Array] = []

    def act(self, command: Array) -> None:
        """See Law."""
        n = len(command)
        position, velocity, bias = (read(n) for read in self._read)
        torque, damping, friction = (np.empty((n, len(self._columns))) for _ in range(3))
        acting = self._delayed(np.ascontiguousarray(command[:, self._columns]))
        _drives(
            self._law, self._gain[:n], self._state[:n], acting, position, velocity, -bias, self._step, torque, damping,
            friction,
        )  # fmt: skip
        command[:, self._columns] = torque
        self._write[0](damping)
        self._write[1](friction)

    def _delayed(self, command: Array) -> Array:
        """The mean over the step of what was commanded a delay ago; before the first command, that one."""
        late = self._law.delay / self._step + 0.5  # see `Servo`
        whole = int(late)
        self._told = [command, *self._told[: whole + 1]]
        newer, older = (self._told[min(k, len(self._told) - 1)][: len(command)] for k in (whole, whole + 1))
        return newer + (late - whole) * (older - newer)


@njit(nogil=True)
def _drives(
    law: Law, gain: Array, state: Array, command: Array, position: Array, velocity: Array, external: Array, step: float,
    torque: Array, damping: Array, friction: Array,
) -> None:  # fmt: skip
    for i in range(command.shape[0]):
        for j in range(command.shape[1]):
            torque[i, j], damping[i, j], friction[i, j] = compiled_drive(
                law, gain[i, j], True, state[i, j], command[i, j], position[i, j], velocity[i, j], external[i, j], step
            )
