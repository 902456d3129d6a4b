# SPDX-License-Identifier: Apache-2.0
"""Recordings and a model brought together: positions for servos, torques for motors, drives where it has none."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from trueup.errors import ModelError, TrueupError
from trueup.recording import Channel, Recording
from trueup.simulators.mujoco.model import Model
from trueup.simulators.mujoco.wiring import actuators_of, is_motor
from trueup.trial import COMMANDS, command_of

_STIFFNESS = 100.0  # N m/rad of position servos that a model lacks; calibrated from there
_TORQUE = ("N m", "N")
_POSITION = ("rad", "m")


def driven(model: Model, recordings: Sequence[Recording]) -> Model:
    """The model, with position servos or motors for the commanded joints where it has no actuator at all.

    Raises ModelError where it does not compile with them.
    """
    if model.compiled.nactuator:
        return model
    commands = [c for r in recordings for c in (command_of(r),) if c is not None and c.unit in (*_POSITION, *_TORQUE)]
    wanted = [j for j in model.scalar_joints() if any(j in c.labels for c in commands)]
    if not wanted:
        return model
    spec, motors = model.spec.copy(), commands[0].unit in _TORQUE
    for joint in wanted:
        actuator = spec.add_actuator()
        actuator.name, actuator.target, actuator.trntype = joint, joint, mujoco.mjtTrn.mjTRN_JOINT
        if motors:
            actuator.set_to_motor()
        else:
            actuator.set_to_position(kp=_STIFFNESS)
    try:
        compiled = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"model '{model.path}' does not compile with actuators added: {error}") from None
    added = "motors" if motors else f"position servos with kp {_STIFFNESS:g} N m/rad"
    note = f"the model has no actuators: {added} were added for the commanded joints ({', '.join(wanted)})"
    return Model(model.path, spec, compiled, (*model.notes, note))


def undriven(model: Model, recordings: Sequence[Recording]) -> list[str]:
    """Notes on recordings without any command."""
    silent = [r.name for r in recordings if command_of(r) is None]
    if not silent or not model.compiled.nactuator:
        return []
    logged = any(r.has("torque") for r in recordings)
    hint = "; if 'torque' is what drove the robot, name it 'command_torque' in the mapping" if logged else ""
    return [f"no command in {', '.join(silent)}: servos hold the posture of the start and motors do nothing{hint}"]


def suited(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings as a model can take them, and notes on what was changed.

    Where both have one joint only it gets the model's name. Of positions and torques that were commanded those stay that
    the drives take: a model with motors knows nothing of the controller that positions go through.
    Raises ModelError where servos would have to take torques, or motors positions.
    """
    named, notes = _by_the_only_joint(recordings, model.scalar_joints())
    kept, cut = [], []
    for recording in named:
        command = command_of(recording)
        torques = [n for n in COMMANDS if recording.has(n) and recording.channel(n).unit in _TORQUE]
        if torques and command is not None and command.name not in torques and _motors(model, command):
            for name in COMMANDS:
                if recording.has(name) and recording.channel(name).unit not in _TORQUE:
                    recording = recording.without(name)
            cut.append(recording.name)
        _check(model, recording)
        kept.append(recording)
    if cut:
        notes.append(
            f"the model has motors: of what was commanded in {', '.join(cut)} the torques are used, not the positions"
        )
    return kept, notes


def _by_the_only_joint(recordings: Sequence[Recording], joints: Sequence[str]) -> tuple[list[Recording], list[str]]:
    logged = {label for r in recordings for c in ("position", *COMMANDS) if r.has(c) for label in r.channel(c).labels}
    if len(joints) != 1 or len(logged) != 1 or logged == set(joints):
        return list(recordings), []
    (name,) = logged
    note = f"'{name}' of the recordings is taken for '{joints[0]}', the only joint of the model"
    return [r.rename({name: joints[0]}) for r in recordings], [note]


def _actuators(model: Model, command: Channel) -> dict[str, int]:
    """Label to actuator; empty where one has none, which the simulator tells with the names that there are."""
    try:
        return dict(zip(command.labels, actuators_of(model, command), strict=True))
    except TrueupError:
        return {}


def _motors(model: Model, command: Channel) -> list[str]:
    return [label for label, actuator in _actuators(model, command).items() if is_motor(model.compiled, actuator)]


def _check(model: Model, recording: Recording) -> None:
    command = command_of(recording)
    if command is None:
        return
    where = f"recording '{recording.name}' commands {command.unit} (channel '{command.name}')"
    if command.unit in _TORQUE:
        drives = _actuators(model, command)
        servos = [label for label, actuator in drives.items() if model.is_position_servo(actuator)]
        if servos:
            raise ModelError(
                f"{where}, but model '{model.path.name}' has position servos at {', '.join(servos)}: give it <motor> "
                "actuators, or log the commanded positions as 'command'"
            )
    elif command.unit in _POSITION and (motors := _motors(model, command)):
        raise ModelError(
            f"{where}, but model '{model.path.name}' has motors at {', '.join(motors)}, which take torques: give it "
            "<position> actuators, or log the commanded torques as 'command_torque'"
        )
