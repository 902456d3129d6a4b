# SPDX-License-Identifier: Apache-2.0
"""Recordings and a model brought together: positions for servos, torques for motors, drives where it has none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from json import dumps

import mujoco

from trueup.articulated.pose import in_angles
from trueup.articulated.quantities.known import quantity
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.mixed_commands import with_mixed_commands
from trueup.engines.mujoco.setup.proposal import moving_joints
from trueup.engines.mujoco.setup.scales import of_slides, ways, with_units
from trueup.engines.mujoco.setup.servos import add_servos, add_speed_servos
from trueup.engines.mujoco.wiring import actuators_of, is_motor, is_speed_servo, takes
from trueup.errors import ModelError, RecordingError, TrueupError, listed, unknown_name
from trueup.inspection import pauses
from trueup.inspection.strangers import several_robots
from trueup.inspection.suspicions import at_odds
from trueup.inspection.unfit import check_slides, check_units
from trueup.recording import Channel, Recording
from trueup.trial import COMMANDS, ENABLED, command_of, drives_off

_TORQUE = ("N m", "N")
_POSITION = ("rad", "m")
_NO_DUTY = "duties and voltages of motors are not simulated."
_CONTROLS = (
    'if these drove the motors, they are the model\'s controls (ctrl): [channels.command_torque] with unit = "%" or none'
    "; the motors' gain is calibrated, and damping holds what their own voltage takes away."
)
_AMPERES = (
    "a current drives the joint by the motor's torque constant: name its column in [channels.command_torque] with "
    'unit = "N m" and scale = the N m at the joint (torque constant times gear ratio) for 1 of what the file has.'
)
_SPEED = ("rad/s", "m/s")


def driven(model: Model, recordings: Sequence[Recording]) -> Model:
    """The model with a drive for each commanded joint: servos or motors where it has no actuator at all, and servos in
    place of motors that are told positions or speeds, which the controller in the robot turned into torques. Servos of
    speed take the place of those of position where only speeds were commanded, and the other way round.

    Raises ModelError where it does not compile with them.
    """
    commands = [
        c for r in recordings for c in (command_of(r),) if c is not None and c.unit in (*_POSITION, *_SPEED, *_TORQUE)
    ]
    if not commands:
        return model
    told: dict[str, str] = {}
    for command in commands:
        told = {x: command.unit_of(x) for x in command.labels} | told
    bare = not model.compiled.nactuator
    if bare:
        wanted = {j: told[j] for j in model.scalar_joints() if j in told}
    else:
        wanted = {} if commands[0].unit in _TORQUE else _otherwise_driven(model, told)
    kinds = {kind: [j for j, unit in wanted.items() if unit in kind] for kind in (_POSITION, _SPEED, _TORQUE)}
    kinds = {kind: joints for kind, joints in kinds.items() if joints}
    if not kinds:
        return model
    spec = model.spec.copy()
    for kind, joints in kinds.items():
        if kind == _TORQUE:
            _add_motors(spec, joints)
        else:
            (add_speed_servos if kind == _SPEED else add_servos)(spec, model, joints, recordings)
    said = "; ".join((_said_of_speeds if kind == _SPEED else _note)(kinds[kind], bare, kind) for kind in kinds)
    return model.changed(spec, "with actuators added", said)


def _said_of_speeds(joints: Sequence[str], bare: bool, _: Sequence[str]) -> str:
    why = "the model has no actuators, and the recordings command speeds: servos of speed were added" if bare else (
        "the recordings command speeds, which the model's drives do not take: servos of speed took their place"
    )  # fmt: skip
    return f"{why}, whose gain stands for the controller in the robot ({', '.join(joints)})"


def _note(joints: Sequence[str], bare: bool, kind: Sequence[str]) -> str:
    where = f"({', '.join(joints)})"
    if not bare:
        return (
            "the recordings command positions, which drives of the model do not take: position servos took their place, "
            f"whose stiffness and damping stand for the controller in the robot {where}"
        )
    drives = (
        "motors" if kind == _TORQUE else "position servos (stiffness and damping to start from: 5 Hz, no overshoot)"
    )
    return f"the model has no actuators: {drives} were added for the commanded joints {where}"


def _add_motors(spec: mujoco.MjSpec, joints: Sequence[str]) -> None:
    for joint in joints:
        actuator = spec.add_actuator()
        actuator.name, actuator.target, actuator.trntype = joint, joint, mujoco.mjtTrn.mjTRN_JOINT
        actuator.set_to_motor()


def _otherwise_driven(model: Model, told: Mapping[str, str]) -> dict[str, str]:
    """Joints that are commanded, under their name or their drive's, what such a drive does not take, positions or speeds,
    with the unit of that. `told`: units by label.
    """
    names = model.names("actuator")
    return {
        joint: told[label]
        for joint, i in model.actuator_of_joint().items()
        for label in (names[i], joint)
        if told.get(label, _TORQUE[0]) not in _TORQUE and not takes(model.compiled, i, speeds=told[label] in _SPEED)
    }


def undriven(model: Model, recordings: Sequence[Recording], *, refused: bool = False) -> list[str]:
    """Notes on recordings without any command.

    Raises RecordingError where no recording has one though the model has drives, unless all say that these were off, or it
    was `refused` to take measured torques for commands: a fit would lay what drove the robot to friction and inertia.
    """
    silent = [r for r in recordings if command_of(r) is None]
    if not silent or not model.compiled.nactuator:
        return []
    motors = any(is_motor(model.compiled, i) for i in range(model.compiled.nactuator))  # servos take no torques
    names = ", ".join(r.name for r in silent)
    if len(silent) == len(recordings) and not refused and not all(drives_off(r) for r in silent):
        drives = {a: j for j, a in model.drives().items() if a}
        way = ("command_torque]", "N m") if motors else ("command]", "rad")
        open_loop = [n for n in ("duty", "command_duty", "command_voltage") if any(r.has(n) for r in silent)]
        not_taken = f"{' and '.join(open_loop)}: {_CONTROLS if motors else _NO_DUTY} " if open_loop else ""
        amperes = [n for n in ("command_current", "current") if any(r.has(n) for r in silent)]
        not_taken += f"{amperes[0]}: {_AMPERES} " if amperes and motors else ""
        seen = dict.fromkeys(f"{c.name} ({', '.join(c.labels)})" for r in silent for c in r.channels.values())
        raise RecordingError(
            f"no command in {names}: nothing says what the drives of model '{model.path.name}' "
            f"({', '.join(drives) or 'of no single joint'}) did. Channels seen: {'; '.join(seen)}. {not_taken}Name the "
            f'columns that commanded them in the mapping: [channels.{way[0]} columns = ["..."], '
            f'labels = {dumps(list(drives.values()))}, unit = "{way[1]}". If nothing drove the robot, give a model without '
            f"actuators, or log {ENABLED} as 0"
        )
    logged = motors and any(r.has("torque") for r in recordings)
    hint = "; if 'torque' is what drove the robot, name it 'command_torque' in the mapping" if logged else ""
    some = ", unlike in the others" if len(silent) < len(recordings) else ""
    return [f"no command in {names}{some}: there servos hold the posture of the start and motors do nothing{hint}"]


def uncommanded(model: Model, recordings: Sequence[Recording]) -> list[str]:
    """A note on drives that nothing commands in recordings that command others, though their joints move there."""
    found: dict[str, list[str]] = {}
    beside: list[str] = []
    for recording in recordings:
        command = command_of(recording)
        told = set(command.labels if command is not None else ())
        for joint in moving_joints(model, [recording]) if told else ():
            drive = model.drives().get(joint)
            if drive and not {joint, drive} & told:
                found.setdefault(drive, []).append(recording.name)
                others = (recording.channel(n) for n in COMMANDS if recording.has(n))
                beside += [f"'{c.name}' ({c.unit or 'no unit'})" for c in others if {joint, drive} & {*c.labels}]
    if not found:
        return []
    runs = listed(tuple(dict.fromkeys(name for names in found.values() for name in names)))
    unused = (
        f" What is in {', '.join(dict.fromkeys(beside))} is not used: beside positions of others the model's drives "
        "take speeds in rad/s or m/s where they are <velocity> actuators, torques in N m or N where they are <motor>."
        if beside
        else ""
    )
    return [
        f"nothing commands {listed(tuple(found))} in {runs}, though the joint moves there: its servo holds where it began, a "
        f"motor does nothing.{unused} If it was driven, give the columns that say so to [channels.command] in the mapping"
    ]


def suited(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings as a model can take them, and notes on what was changed.

    Where both have one joint only it gets the model's name. Of positions and torques that were commanded those stay that
    the drives take: a model with motors knows nothing of the controller that positions go through. Give all recordings at
    once: what units they are in is told from all of them.
    Raises ModelError where servos would have to take torques, and RecordingError for positions that fit no unit.
    """
    named, notes = by_the_only_joint(recordings, model.scalar_joints())
    named = [in_angles(r) for r in named]
    check_slides(ways(model), named)
    named, more = with_units(model, named)
    check_units(ways(model), named)
    named, still_more = of_slides(model, named)
    notes += [*more, *still_more, *at_odds(named)]
    kept, cut = [], []
    named, more = with_mixed_commands(model, named)
    notes += more
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


def parted_at_pauses(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """See `inspection.pauses.parted_at_pauses`: as long after a pause as any delay that is searched, nothing is compared."""
    return pauses.parted_at_pauses(recordings, late=quantity("delay").bounds(0.0)[1])


def torques_as_commands(model: Model, recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings of which none has commands: torques measured at motors, or at any joint of a model without actuators, drive
    it. Without them the robot would be let go. And a note.
    """
    if any(command_of(r) is not None for r in recordings):
        return list(recordings), []
    drives = model.actuator_of_joint() if model.compiled.nactuator else dict.fromkeys(model.scalar_joints(), -1)
    motors = {j for j, i in drives.items() if i < 0 or is_motor(model.compiled, i)}
    changed, told = [], []
    for recording in recordings:
        torque = recording.channels.get("torque")
        if torque is not None and torque.unit in _TORQUE and (joints := [n for n in torque.labels if n in motors]):
            told.append(recording.name)
            recording = recording.with_channel(torque.select(joints).replace(name="command_torque")).without("torque")
        changed.append(recording)
    note = f"no command in {', '.join(told)}: the torques measured there are taken for what drove the joints"
    return changed, [note] if told else []


def by_the_only_joint(recordings: Sequence[Recording], joints: Sequence[str]) -> tuple[list[Recording], list[str]]:
    """Recordings of one joint with the name of the model's only one, and a note."""
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
    told = [label for label in command.labels if command.unit_of(label) in _TORQUE]
    drives = _actuators(model, command.select(told)) if told else {}
    servos = [label for label, i in drives.items() if model.is_position_servo(i)]
    speeds = [label for label, i in drives.items() if is_speed_servo(model.compiled, i)]
    if servos or speeds:
        kind = f"position servos at {', '.join(servos)}" if servos else f"servos of speed at {', '.join(speeds)}"
        raise ModelError(
            f"recording '{recording.name}' commands {command.unit_of(told[0])} (channel '{command.name}'), but model "
            f"'{model.path.name}' has {kind}: give it <motor> actuators, or log the commanded positions as 'command'"
        )


def check_joints(model: Model, recordings: Sequence[Recording]) -> None:
    """Raises UnknownNameError for a joint that the model does not have, and says how to rename it."""
    joints, file = model.scalar_joints(), model.path.name
    for recording in recordings:
        if recording.has("position"):
            labels = recording.channel("position").labels
            left = [j for j in joints if j not in labels]
            for label in labels:
                if label not in joints:
                    raise unknown_name(
                        "joint", label, left or joints,
                        f"model '{file}' (recording '{recording.name}', channel 'position'; rename it in the mapping's "
                        f"[joints]: `trueup inspect RECORDINGS --model {file}` proposes{several_robots(labels, joints)})",
                    )  # fmt: skip
