# SPDX-License-Identifier: Apache-2.0
"""Commands of drives that take speeds, or torques, beside others that take positions: wheels on the legs of a robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.wiring import is_motor, is_speed_servo
from trueup.inspection.relations import follows_by_speed
from trueup.recording import Channel, Recording
from trueup.trial import COMMANDS, command_of

SPEED = {"rad": "rad/s", "m": "m/s"}
"""Unit of a joint's position to that of its speed."""
TORQUE = {"rad": "N m", "m": "N"}
"""Unit of a joint's position to that of its torque or force."""


def with_mixed_commands(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings in which drives of speed are told speeds, and motors torques, in the channel of the other drives' commands,
    and a note.

    These stand in a channel of their own, beside positions of the same drives or of others; or where commands are called
    positions, a drive takes speeds and its joint turns as fast as it is told.
    """
    together = [_together(model, r) for r in recordings]
    drives = {name for name, i in _drives(model).items() if is_speed_servo(model.compiled, i)}
    every = [c for r in together if (c := command_of(r)) is not None]
    told = [label for label in dict.fromkeys(x for c in every for x in c.labels) if label in drives]
    speeds = [label for label in told if follows_by_speed(label, together)]
    note = (
        f"{', '.join(speeds)}: taken as told speeds, which the drive in the model takes and the joint follows; if these are "
        "positions, give the model <position> actuators there"
    )
    return [_in_speeds(r, speeds) for r in together], [note] if speeds else []


def _drives(model: Model) -> dict[str, int]:
    """Actuators by their own names and by those of the joints that they drive."""
    found = model.actuator_of_joint()
    names = model.names("actuator")
    return {**{names[i]: i for i in found.values()}, **found}


def _together(model: Model, recording: Recording) -> Recording:
    """Positions of some drives and speeds or torques of others that were commanded, as one command, where the drives take
    them, or nothing else says what these did and the model has no drives, or is given others for speeds (`drives.driven`).
    Torques of motors whose positions were commanded as well are another matter (`drives.suited`).
    """
    drives = _drives(model)
    bare = set(model.scalar_joints()) if not model.compiled.nactuator else set[str]()
    for kind, units in (("velocity", SPEED), ("torque", TORQUE)):
        channels = [recording.channel(n) for n in COMMANDS if recording.has(n)]
        positions = next((c for c in channels if c.unit in SPEED), None)
        told = next((c for c in channels if c.unit in units.values() or (c.name.endswith(kind) and not c.unit)), None)
        if positions is None or told is None:
            continue
        takes = is_speed_servo if kind == "velocity" else is_motor
        given = bare | set(drives) if kind == "velocity" else bare if told.unit else set()
        taken = [
            x for x in told.labels
            if (x in drives and takes(model.compiled, drives[x])) or (x in given and x not in positions.labels)
        ]  # fmt: skip
        others = [x for x in positions.labels if x not in taken]
        motors = [x for x in others if x in drives and is_motor(model.compiled, drives[x])]
        if not taken or (kind == "torque" and (motors or len(others) < len(positions.labels))):
            continue
        told = told if told.unit else told.replace(unit=units[positions.unit])
        for channel in (positions, told):
            recording = recording.without(channel.name)
        recording = recording.with_channel(_beside(positions.select(others), told.select(taken)) if others else told)
    return recording


def _beside(positions: Channel, told: Channel) -> Channel:
    """One command of what positions and what else were told."""
    values = np.concatenate([positions.values, told.at(positions.time, hold=True)], axis=1)
    units = tuple(c.unit_of(x) for c in (positions, told) for x in c.labels)
    return positions.replace(labels=(*positions.labels, *told.labels), values=values, units=units)


def _in_speeds(recording: Recording, labels: Sequence[str]) -> Recording:
    """With the commands of some joints in the unit of speeds."""
    command = command_of(recording)
    if command is None or not set(labels) & set(command.labels):
        return recording
    units = tuple(SPEED.get(u, u) if x in labels else u for x, u in ((x, command.unit_of(x)) for x in command.labels))
    most = max(set(units), key=units.count)
    return recording.with_channel(command.replace(unit=most, units=units if len(set(units)) > 1 else ()))
