# SPDX-License-Identifier: Apache-2.0
"""Commands of drives that take speeds, alone or beside others that take positions: wheels on the legs of a robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.wiring import is_speed_servo
from trueup.inspection.relations import follows_by_speed
from trueup.recording import Recording
from trueup.trial import COMMANDS, command_of

SPEED = {"rad": "rad/s", "m": "m/s"}
"""Unit of a joint's position to that of its speed."""
_SPEEDS = tuple(name for name in COMMANDS if name.endswith("velocity"))


def with_speeds(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings in which drives of speed are told speeds, in the channel of the other drives' commands, and a note.

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
    """Positions and speeds that were commanded of several drives as one command, where the drives take them."""
    channels = [recording.channel(n) for n in COMMANDS if recording.has(n)]
    positions = next((c for c in channels if c.unit in SPEED), None)
    speeds = next((c for c in channels if c.unit in SPEED.values() or (c.name in _SPEEDS and not c.unit)), None)
    if positions is None or speeds is None:
        return recording
    drives = _drives(model)
    taken = [x for x in speeds.labels if x in drives and is_speed_servo(model.compiled, drives[x])]
    others = [x for x in positions.labels if x not in taken]
    if not taken:
        return recording
    if not speeds.unit:
        speeds = speeds.replace(unit=SPEED[positions.unit])
    for channel in channels:
        recording = recording.without(channel.name)
    if not others:
        return recording.with_channel(speeds)
    values = np.concatenate(
        [positions.select(others).values, speeds.select(taken).at(positions.time, hold=True)], axis=1
    )
    units = (*(positions.unit_of(x) for x in others), *(speeds.unit_of(x) for x in taken))
    return recording.with_channel(positions.replace(labels=(*others, *taken), values=values, units=units))


def _in_speeds(recording: Recording, labels: Sequence[str]) -> Recording:
    """With the commands of some joints in the unit of speeds."""
    command = command_of(recording)
    if command is None or not set(labels) & set(command.labels):
        return recording
    units = tuple(SPEED.get(u, u) if x in labels else u for x, u in ((x, command.unit_of(x)) for x in command.labels))
    most = max(set(units), key=units.count)
    return recording.with_channel(command.replace(unit=most, units=units if len(set(units)) > 1 else ()))
