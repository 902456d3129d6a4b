# SPDX-License-Identifier: Apache-2.0
"""Which actuator each label of a command drives, and what its numbers mean there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from trueup.articulated.model import Model
from trueup.errors import ModelError, unknown_name
from trueup.recording import Channel

ONSET_OF = "/onset"
"""Ends the name of a second actuator of a servo, which takes its command: a steep onset of force (see `kernels.ONSET`)."""


def twins(model: Model) -> list[tuple[int, int]]:
    """Columns of the commands that repeat another one, and which."""
    columns = model.columns()
    mains = {name: name.removesuffix(ONSET_OF) for name in columns if name.endswith(ONSET_OF)}
    return [(columns[twin], columns[main]) for twin, main in mains.items() if main in columns]


def commanded(model: Model, command: Channel) -> list[str]:
    """The actuator of each command label: its own name, or the joint that it drives. Raises UnknownNameError."""
    return actuators_named(model, command.labels)


def actuators_named(model: Model, labels: Sequence[str]) -> list[str]:
    """The actuators that labels name, by themselves or by the joints that they drive. Raises UnknownNameError."""
    by_joint = {joint: actuator for joint, actuator in model.drives().items() if actuator}
    names = [n for n in model.names("actuator") if n]
    if not names:
        raise ModelError(
            f"model '{model.name}' has no actuators, so the commands of '{', '.join(labels)}' drive "
            "nothing; add <position> or <motor> actuators to it"
        )
    driven = []
    for label in labels:
        if label not in by_joint and label not in names:
            raise unknown_name(
                "actuator", label, {*names, *by_joint},
                "the model (rename the recording's joints in the mapping's [joints] table)",
            )  # fmt: skip
        driven.append(by_joint.get(label, label))
    return driven


def joints_commanded(model: Model) -> tuple[str, ...]:
    """(width,) the joint that each column of the commands drives, or the actuator's name where it drives no single one."""
    joints = {actuator: joint for joint, actuator in model.drives().items() if actuator}
    named = [""] * model.width
    for actuator, column in model.columns().items():
        named[column] = joints.get(actuator, actuator)
    return tuple(named)


def control_of(model: Model, actuator: str, unit: str) -> float:
    """What a command in `unit` is multiplied by to become the actuator's: a motor's gear and gain taken out of a torque."""
    whole = float(model.get("actuator.torque", actuator)[0]) if unit in ("N m", "N") else 0.0
    return 1.0 / whole if whole else 1.0


def no_signal(trial: str, channel: str, model: str, known: Iterable[str]) -> ModelError:
    """The error for what a trial observes and a model does not have, with what it has."""
    return ModelError(
        f"channel '{channel}' of '{trial}' is no signal of '{model}'; it has: {', '.join(sorted({*known, 'command'}))}"
    )
