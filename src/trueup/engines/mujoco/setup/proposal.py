# SPDX-License-Identifier: Apache-2.0
"""Which parameters to calibrate when nobody says: those of the drives that move in the recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trueup.articulated.declarations import Declaration
from trueup.articulated.hidden_limits import asked_for
from trueup.articulated.quantities.known import quantity
from trueup.articulated.wiring import ONSET_OF
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.setup.footed import of_a_floor, of_the_base, of_what_touches
from trueup.engines.mujoco.setup.gravity import of_held_weight
from trueup.engines.mujoco.setup.motors import AT_LEAST, Drive, drives_seen
from trueup.engines.mujoco.setup.own_sensors import of_sensors
from trueup.engines.mujoco.setup.rotors import of_rotors
from trueup.engines.mujoco.setup.servos import loads
from trueup.engines.mujoco.setup.tendons import leading, of_several_joints
from trueup.engines.mujoco.wiring import is_motor, is_speed_servo
from trueup.inspection.steps import accelerations, profiles
from trueup.recording import Recording
from trueup.samples import MOST
from trueup.trial import command_of

LOAD = "friction with load"
"""The optional structure that `beyond_mjcf` proposes."""
HELD = "weight that gravity compensation leaves"
"""Of links that a controller was told to hold by a model of its own."""
FED_FORWARD = "speed fed forward"
"""Of servos: a command that leads along its own speed."""
PUNCH = "punch"
"""Of servos: torque that sets in steeply."""
_KICK = 0.01  # rad (or m) of error that a servo's punch is worth: amid what firmware has
_SOFTER = 10.0  # times: as a spring may be, or stiffer, than the file says; bounds of the other drives are wider still
_MOVES = 5e-3  # rad or m: a joint that moves less teaches nothing; torques that push one within 20 mrad tell its drive


def propose(
    model: Model,
    recordings: Sequence[Recording],
    clocks: Mapping[str, float] | None = None,
    floor: float | None = None,
    beyond_mjcf: bool = False,
    stops: Mapping[str, float] | None = None,
) -> list[Declaration]:
    """Declarations for the joints that move: servo stiffness, damping, friction, rotor inertia, servo zero, factors
    on motors' torques, one delay.

    All of it is part of MJCF, so the calibrated file replays the robot in any MuJoCo program, but for limits of commands
    (`profiles`), where recordings show them, and for friction that grows with the load, if `beyond_mjcf`. `clocks`: how
    late the commands of some recordings are stamped, in s (`inspection.alignment.clock_errors`); searched from there.
    `floor`: the height in m of a floor that the model lacks (`inspection.floor.stopped_by_floor`). `stops`: hard stops that
    it lacks, by '<joint> upper' (`inspection.stops.stopped_at`).
    """
    clocks = clocks or {}
    joints = moving_joints(model, recordings) or model.scalar_joints()
    leaders, driven = leading(model, joints), model.actuator_of_joint()
    servos = tuple(j for j in joints if j in driven and model.is_position_servo(driven[j]))
    motors = tuple(j for j in joints if j in driven and is_motor(model.compiled, driven[j]))
    several = _pulled(model, recordings)
    pulling = {a: k for a in several if model.is_position_servo(k := model.index("actuator", a))}
    lines = [*([Declaration("kp", stiff)] if (stiff := (*servos, *pulling)) else []), *_of_pulling(model, pulling)]
    lines += _limits(model, recordings, leaders, {j: driven[j] for j in servos})
    lines += [
        Declaration("friction", leaders),
        # Real gears stick: starting at MuJoCo's own creep would let every friction estimate leak away.
        Declaration("friction_creep", joints, tie="all", name="friction_creep", nominal=1e-3),
        *of_rotors(model, leaders),
        Declaration("damping_quadratic", leaders, optional="quadratic damping"),
        *_of_springs(model, joints),
    ]
    lines += [*_leads(servos), *_punches(model, servos), *of_sensors(model, joints, recordings)]
    if servos and beyond_mjcf:
        lines.append(Declaration("friction_load", servos, optional=LOAD))
    lines += [*_of_motors(model, motors), *_of_speed_servos(model, joints), *of_held_weight(model, servos, recordings)]
    if stiff:
        lines.append(Declaration("zero", stiff, optional="servo zero"))
    # A delay and the clocks of all recordings are the same thing.
    commanded = (*(j for j in joints if j in driven), *several)
    if commanded and not all(r.name in clocks for r in recordings):
        lines.append(Declaration("delay", commanded, tie="all", name="delay"))
    lines += [] if floor is None else of_a_floor(floor)
    lines += _of_stops(stops or {})
    lines += [*of_the_base(model, recordings), *of_what_touches(model, recordings)]
    lines += [Declaration("clock", (name,), nominal=late) for name, late in clocks.items()]
    return _as_seen(model, lines, drives_seen(model, recordings) if motors else {})


def _as_seen(model: Model, lines: Sequence[Declaration], seen: Mapping[str, Drive]) -> list[Declaration]:
    """Lines of drives that begin as inverse dynamics saw them. Joints that stood still in every recording are held by
    friction, and creep no more than others: without it, what moves the others would move them too.
    """
    moving = {j for line in lines for j in line.of}
    still = tuple(j for j in seen if j not in moving)
    begun: list[Declaration] = []
    for line in lines:
        if line.quantity in ("friction", "damping", "armature"):
            begun += [_as(model, line, joint, seen.get(joint)) for joint in line.of]
        else:
            begun.append(replace(line, of=(*line.of, *still)) if line.quantity == "friction_creep" else line)
    return begun + [Declaration("friction", (j,), nominal=seen[j].friction, frozen=True) for j in still]


def _as(model: Model, line: Declaration, joint: str, drive: Drive | None) -> Declaration:
    kind = quantity(str(line.quantity))
    if drive is None or getattr(drive, kind.name) is None:
        return replace(line, of=(joint,))
    least = kind.begun(model, joint, kind.nominal(model, joint))
    return replace(line, of=(joint,), nominal=max(getattr(drive, kind.name), least))


def _of_springs(model: Model, joints: Sequence[str]) -> list[Declaration]:
    """Those that the file has (legs with springs, elastic drives): what it says of their stiffness is an estimate too."""
    stiffness = {j: float(model.compiled.jnt_stiffness[model.index("joint", j)]) for j in joints}
    some = {j: k for j, k in stiffness.items() if k > 0.0}
    return [Declaration("spring", (j,), lower=k / _SOFTER, upper=k * _SOFTER, scale="log") for j, k in some.items()]


def _of_stops(stops: Mapping[str, float]) -> list[Declaration]:
    ends = [(*name.rsplit(" ", 1), value) for name, value in stops.items()]
    return [Declaration(f"stop_{side}", (joint,), nominal=value) for joint, side, value in ends]


def _of_speed_servos(model: Model, joints: Sequence[str]) -> list[Declaration]:
    """How hard servos of speed pursue it: files rarely say, and what stands for a controller's loop may be far off."""
    driven = model.actuator_of_joint()
    fast = tuple(j for j in joints if j in driven and is_speed_servo(model.compiled, driven[j]))
    return [Declaration("gain", fast, lower=0.01, upper=100.0)] if fast else []


def _of_motors(model: Model, joints: Sequence[str]) -> list[Declaration]:
    """Factors on the torques of motors at these joints, and what else holds the weight of the bodies that they move."""
    m = model.compiled
    bodies = [int(m.jnt_bodyid[model.index("joint", joint)]) for joint in joints]
    held = tuple(name for i in bodies if m.body_gravcomp[i] and (name := model.names("body")[i]))
    gains = [Declaration("gain", tuple(joints), optional="factors on the motors' torques")] if joints else []
    return gains + ([Declaration("weight_held", held, optional=HELD)] if held else [])


def _pulled(model: Model, recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Actuators that are commanded and pull at a tendon, not at one joint."""
    told = {label for r in recordings for c in (command_of(r),) if c is not None for label in c.labels}
    return tuple(name for name in of_several_joints(model) if name in told)


def _of_pulling(model: Model, pulling: Mapping[str, int]) -> list[Declaration]:
    """Damping of servos that pull at tendons: it is not that of their joints, each of which has its own."""
    damped = tuple(a for a, servo in pulling.items() if model.compiled.actuator_biasprm[servo, 2] < 0.0)
    return [Declaration("kv", damped)] if damped else []


def _limits(
    model: Model, recordings: Sequence[Recording], joints: Sequence[str], servos: Mapping[str, int]
) -> list[Declaration]:
    """Damping, and what the servos cannot do: limits of force, and of the commands' speed and acceleration."""
    limited = tuple(j for j, servo in servos.items() if _limited(model, j, servo))
    strengths = _strengths(model, recordings, tuple(j for j in servos if j not in limited))
    strained = tuple(j for j in limited if _strained(model, recordings, j, servos[j]))
    return [
        *_dampings(model, joints, servos, (*limited, *strengths)),
        *_settling(model, recordings, {j: s for j, s in servos.items() if j in (*strained, *strengths)}),
        *([Declaration("force_limit", strained)] if strained else []),
        *(Declaration("force_limit", (j,), nominal=force) for j, force in strengths.items()),
        *_profiles(model, recordings, tuple(servos), strained),
    ]


def _dampings(
    model: Model, joints: Sequence[str], servos: Mapping[str, int], limited: Sequence[str]
) -> list[Declaration]:
    """Damping of the servo and of its joint are one thing, until the servo's force is limited: then both count."""
    damped = tuple(j for j, servo in servos.items() if _damps(model, j, servo))
    rest = tuple(j for j in joints if j not in damped or j in limited)
    return [Declaration(kind, which) for kind, which in (("kv", damped), ("damping", rest)) if which]


def _settling(model: Model, recordings: Sequence[Recording], saturated: Mapping[str, int]) -> list[Declaration]:
    """Damping of servos that saturate and have none in the file, searched from half of what is critical."""
    bare = {j: servo for j, servo in saturated.items() if not _damps(model, j, servo)}
    inertia, _ = loads(model, tuple(bare), recordings)
    stiffness = [float(model.compiled.actuator_gainprm[servo, 0]) for servo in bare.values()]
    return [
        Declaration("kv", (j,), nominal=float(np.sqrt(k * i))) for j, k, i in zip(bare, stiffness, inertia, strict=True)
    ]


def _strengths(model: Model, recordings: Sequence[Recording], unlimited: Sequence[str]) -> dict[str, float]:
    """Limits of the force of servos whose file gives none, where they are told to step: no drive follows that as told."""
    drives = _drives(model)
    stepped = {j: a for j in unlimited if len(a := accelerations(j, drives[j], recordings))}
    inertia, weight = loads(model, tuple(stepped), recordings)
    return {
        j: AT_LEAST * float(i * np.max(a) + w) for (j, a), i, w in zip(stepped.items(), inertia, weight, strict=True)
    }


def _profiles(
    model: Model, recordings: Sequence[Recording], servos: Sequence[str], strained: Sequence[str]
) -> list[Declaration]:
    """Limits of the commands' speed and acceleration, for servos whose steps show them and are not short of force."""
    drives = _drives(model)
    driven = model.actuator_of_joint()
    speeds, accelerations = profiles(
        {j: a for j, a in drives.items() if model.is_position_servo(driven[j])}, recordings
    )
    lines = [Declaration("speed_limit", (j,), nominal=v) for j, v in speeds.items() if j in servos]
    lines += [
        Declaration("acceleration_limit", (j,), nominal=a)
        for j, a in accelerations.items()
        if j in servos and (j in speeds or j not in strained)
    ]
    shown = {j for line in lines for j in line.of}
    plain = {j: drives[j] for j in servos if j not in shown}
    return lines + asked_for(plain, {j: _law(model, j) for j in plain}, recordings)


def _drives(model: Model) -> dict[str, str]:
    """Driven joints, each to its actuator's name."""
    names = model.names("actuator")
    return {joint: names[i] for joint, i in model.actuator_of_joint().items()}


def _law(model: Model, joint: str) -> tuple[float, ...]:
    """What the model says of a joint's drive: drives with the same numbers are taken to be of one kind."""
    m, i = model.compiled, model.actuator_of_joint()[joint]
    parts = m.actuator_gainprm[i, :3], m.actuator_biasprm[i, :3], m.actuator_forcerange[i], m.actuator_gear[i, :1]
    return tuple(np.concatenate(parts).tolist())


def _strained(model: Model, recordings: Sequence[Recording], joint: str, servo: int) -> bool:
    """Whether a servo with a force limit is told to go so far ahead of its joint that it may reach it (steps)."""
    compiled = model.compiled
    limit, stiffness = float(compiled.actuator_forcerange[servo, 1]), float(compiled.actuator_gainprm[servo, 0])
    if not compiled.actuator_forcelimited[servo] or limit <= 0.0:
        return False
    names = {joint, model.names("actuator")[servo]}
    for recording in recordings:
        command = command_of(recording)
        label = next((x for x in command.labels if x in names), "") if command is not None else ""
        if command is None or not label or not recording.has("position"):
            continue
        position = recording.channel("position")
        if joint in position.labels:
            ahead = np.abs(command.select([label]).at(position.time, hold=True)[:, 0] - position.column(joint))
            if stiffness * np.nanmax(ahead, initial=0.0) > MOST * limit:
                return True
    return False


def _leads(servos: Sequence[str]) -> list[Declaration]:
    """Asked about before a punch, which would make up for what a lead does to smooth motion."""
    return [Declaration("lead", (j,), optional=FED_FORWARD) for j in servos]


def _punches(model: Model, servos: Sequence[str]) -> list[Declaration]:
    """Of servos that have a stiffness, and no steep onset beside it in the file."""
    driven, names, gains = model.actuator_of_joint(), model.names("actuator"), model.compiled.actuator_gainprm[:, 0]
    plain = [j for j in servos if names[driven[j]] + ONSET_OF not in names and gains[driven[j]] > 0.0]
    return [Declaration("punch", (j,), nominal=_KICK * float(gains[driven[j]]), optional=PUNCH) for j in plain]


def _damps(model: Model, joint: str, servo: int) -> bool:
    """Whether a servo damps more than its joint does."""
    compiled = model.compiled
    in_joint = float(compiled.dof_damping[compiled.jnt_dofadr[model.index("joint", joint)]])
    return float(-compiled.actuator_biasprm[servo, 2]) > in_joint


def _limited(model: Model, joint: str, servo: int) -> bool:
    compiled = model.compiled
    return bool(compiled.actuator_forcelimited[servo] or compiled.jnt_actfrclimited[model.index("joint", joint)])


def moving_joints(model: Model, recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Joints of the model that move in at least one recording, in the model's order."""
    moved: set[str] = set()
    for recording in recordings:
        if recording.has("position"):
            channel = recording.channel("position")
            for label, column in zip(channel.labels, channel.values.T, strict=True):
                finite = column[np.isfinite(column)]
                if len(finite) and float(np.ptp(finite)) > _MOVES:
                    moved.add(label)
    return tuple(j for j in model.scalar_joints() if j in moved)
