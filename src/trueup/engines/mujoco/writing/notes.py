# SPDX-License-Identifier: Apache-2.0
"""What a calibrated MJCF cannot say by itself: notes, and the lines of code that simulate it as it was fitted."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.articulated.declarations import SOFTNESS
from trueup.articulated.quantities.known import quantity
from trueup.articulated.wiring import ONSET_OF
from trueup.calibration import Calibration
from trueup.engines.mujoco.attributes import is_position_servo
from trueup.engines.mujoco.base import free_joint, spared
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.wiring import is_speed_servo
from trueup.noise import UNUSUAL, spread

DELAY = "actuator.delay"
_ALIKE, _OTHER_UNIT = 0.05, 2.0
"""Share by which gains that were found may differ from a log's and be the same; times, from which on these are counts of a
servo's firmware rather than N m/rad: files are seldom wrong by as much in what a robot weighs.
"""
_RELATIVE = ("kp", "kv", "gain", "damping", "friction", "armature")
"""Quantities that grow with the masses where nothing tells forces."""


def usage_of(simulator: MujocoSimulator, values: Array, path: Path) -> tuple[str, ...]:
    """Lines of Python that simulate the file at `path` as it was fitted, driven by a log whatever its period.

    A command is held until the next one comes, in the midst of a step where it likes: each step takes the mean over it.
    """
    known = simulator.model.driven or simulator.model.given or simulator.model
    file = path.with_name(f"{path.stem}_driven{path.suffix}") if simulator.model.driven is not None else path
    begin = "mujoco.mj_resetDataKeyframe(model, data, 0)" if known.compiled.nkey else "mujoco.mj_resetData(model, data)"
    if any(seconds > 0.0 for seconds in delays_of(simulator, values).values()):
        begin += (
            "; data.ctrl[:] = commands[0]; [mujoco.mj_initCtrlHistory(model, data, i, None, np.full((n, 1), data.ctrl[i])) "
            "for i, n in enumerate(model.actuator_history[:, 0]) if n]"
        )
    driven = simulator.model.driven or simulator.model
    columns = [driven.columns()[n] for n in punches_of(simulator, values) if has_drive(simulator, driven, n)]
    onsets = f"; commands = np.hstack([commands, commands[:, {columns}]])" if columns else ""
    leads = leads_of(simulator, values)
    ahead = [leads.get(name, 0.0) for name in driven.names("actuator")[: known.compiled.nu]]
    led = f"; commands = commands + {[round(x, 6) for x in ahead]} * np.gradient(commands, times, axis=0)" * any(ahead)
    return (
        f"# times (n,) in s from 0 on and commands (n, {known.compiled.nu}) of a log's rows, each held until the next; "
        "once reset, set data.qpos to where it begins",
        f'model = mujoco.MjModel.from_xml_path("{file.as_posix()}"); data = mujoco.MjData(model){led}{onsets}',
        *_holding(simulator.model, known),
        begin + _held_at(simulator.model, known),
        "while data.time < times[-1]:  # commands come within steps too: each step takes their mean over it",
        '    rows = np.searchsorted(times, data.time + model.opt.timestep * (np.arange(8) + 0.5) / 8, side="right") - 1',
        "    data.ctrl[:] = commands[rows].mean(axis=0); mujoco.mj_step(model, data)",
    )


def _holding(fitted: Model, known: Model) -> tuple[str, ...]:
    """The line that holds a base which is free in the file and was held for the fit: too heavy to move, touching nothing."""
    joint = _held_joint(fitted, known)
    if joint < 0:
        return ()
    dof = int(known.compiled.jnt_dofadr[joint])
    return (
        "still = model.body_weldid[model.geom_bodyid] == 0; model.geom_contype[still] = model.geom_conaffinity[still] = 0; "
        f"model.dof_armature[{dof}:{dof + 6}] = 1e9; mujoco.mj_setConst(model, data)  # the base held, as for the fit",
    )


def _held_at(fitted: Model, known: Model) -> str:
    """Where it was held."""
    joint = _held_joint(fitted, known)
    if joint < 0:
        return ""
    body, start = int(known.compiled.jnt_bodyid[joint]), int(known.compiled.jnt_qposadr[joint])
    pose = np.concatenate([fitted.compiled.body_pos[body], fitted.compiled.body_quat[body]])
    return f"; data.qpos[{start}:{start + 7}] = [{', '.join(f'{x:.9g}' for x in pose)}]"


def _held_joint(fitted: Model, known: Model) -> int:
    """The free joint of a base that was held for the fit; -1 where none was."""
    return free_joint(known.compiled) if free_joint(fitted.compiled) < 0 else -1


def has_drive(simulator: MujocoSimulator, model: Model, actuator: str) -> bool:
    """Whether a model has an actuator as it is simulated, rather than none or one of another kind."""
    kinds = [(int(m.actuator_gaintype[i]), int(m.actuator_biastype[i]), is_position_servo(m, i))
             for m in (model.compiled, simulator.model.compiled)
             for i in (mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_ACTUATOR, actuator),) if i >= 0]  # fmt: skip
    return len(kinds) == 2 and kinds[0] == kinds[1]


def delays_of(simulator: MujocoSimulator, values: Array) -> dict[str, float]:
    """Delays of commands in s, by actuator: those found, and those that a file has."""
    return {
        target: float(value)
        for quantity, value in zip(simulator.quantities, values, strict=True)
        for target in quantity.targets
        if DELAY in quantity.quantity.attributes and (value > 0.0 or simulator.model.get(DELAY, target)[0] > 0.0)
    }


def punches_of(simulator: MujocoSimulator, values: Array) -> dict[str, float]:
    """Punches of servos in N m, by actuator, of those that have any."""
    return _above_none(simulator, values, "punch")


def leads_of(simulator: MujocoSimulator, values: Array) -> dict[str, float]:
    """How far ahead along their speed commands are taken in s, by actuator, of those that are."""
    return _above_none(simulator, values, "lead")


def _above_none(simulator: MujocoSimulator, values: Array, kind: str) -> dict[str, float]:
    """Values of quantities of a kind, by what they are of, of those that are more than none."""
    return {
        target: float(value)
        for quantity, value in zip(simulator.quantities, values, strict=True)
        for target in quantity.targets
        if quantity.kind == kind and value > 0.0
    }


def _beside(simulator: MujocoSimulator, values: Array) -> list[str]:
    """What is no attribute of an element of the file."""
    outside: dict[str, list[str]] = {}
    for assignment, value in zip(simulator.quantities, values, strict=True):
        known = assignment.quantity.attributes or assignment.kind == "punch"
        if value not in (0.0, assignment.quantity.nothing) and not known:
            outside.setdefault(assignment.quantity.title, []).extend(assignment.targets)
    notes = [
        f"{title} ({', '.join(there[:12])}) is no part of MJCF: take it from parameters.toml"
        for title, there in outside.items()
    ]
    if punches := punches_of(simulator, values):
        those = ", ".join(list(punches)[:12])
        notes.append(
            f"the steep onset of force of {those} is a second actuator of each, '...{ONSET_OF}' behind all others, "
            "which takes the same command"
        )
    return notes


def notes_of(simulator: MujocoSimulator, values: Array) -> list[str]:
    """What to mind with a file that holds values (n,), in words."""
    model = simulator.model
    notes: list[str] = []
    free = (model.given or model).compiled
    excluded = free.nexclude
    if free_joint(free) >= 0 > free_joint(model.compiled):
        notes.append("the base was held for the fit alone: in the file it is free, with the keyframes that it had")
        excluded += len(spared(free, free_joint(free)))
    if model.compiled.nexclude > excluded:
        notes.append(
            "parts that overlap touch each other in the file as they did; only the fit left these contacts out"
        )
    notes += _beside(simulator, values)
    delays = {actuator: seconds for actuator, seconds in delays_of(simulator, values).items() if seconds > 0.0}
    step = float(model.compiled.opt.timestep)
    if delays:
        notes.append("delayed actuators start with commands of zero: call mj_initCtrlHistory after a reset")
        short = [a for a, seconds in delays.items() if seconds < step]
        if short:
            notes.append(f"MuJoCo delays by a step ({1e3 * step:g} ms) at least; shorter ones: {', '.join(short)}")
    if model.compiled.opt.integrator != simulator.compiled.opt.integrator:
        notes.append("the integrator is now implicitfast, with which the values were found")
    if model.compiled.opt.iterations < simulator.compiled.opt.iterations:
        notes.append(
            f"the model's solver stops after {model.compiled.opt.iterations} iterations: the values were found with one that "
            "converges"
        )
    if step > 1.01 * simulator.step:
        notes.append(
            f"the step is now {1e3 * simulator.step:g} ms, at which the values were found (it was {1e3 * step:g} ms)"
        )
    return notes


def about_masses(simulator: MujocoSimulator, calibration: Calibration) -> tuple[str, ...]:
    """A note where nothing tells forces: what was found is then in proportion to the masses that the file has."""
    model, forces = simulator.model, ("torque", "N")
    m = model.compiled
    servos = all(is_position_servo(m, i) or is_speed_servo(m, i) for i in range(m.nactuator))
    seen = {r.channel for r in calibration.replays} | {r.unit for r in calibration.replays}
    kinds = dict.fromkeys(q.kind for q in simulator.quantities if q.kind in _RELATIVE)
    masses = any(q.quantity.family == "body" for q in simulator.quantities)
    if not servos or not kinds or masses or seen & {*forces, "N m"}:
        return ()
    note = (
        f"{', '.join(kinds)} are in proportion to the masses in the file, which their intervals take as right: no torque or "
        "force was compared, and with all masses twice as large (or those behind a last joint: its own) they would be so and "
        "replay as well. Weigh what you doubt, or have it searched: "
        '--parameters FILE with quantity = "mass" (and "com_x" ...) of the body; measured torques in N m are compared by '
        "--channels position,torque"
    )
    return (note + _by_the_gains(simulator, calibration.values),)


def _by_the_gains(simulator: MujocoSimulator, values: Array) -> str:
    """What gains that the log names say of the masses, if they are in N m/rad and can be; "" for nothing."""
    named, joints = simulator.gains.given_for, {a: j for j, a in simulator.model.drives().items()}
    ratios = []
    for assignment, value in zip(simulator.quantities, values, strict=True):
        for drive in assignment.targets if assignment.kind == "kp" and value > 0.0 else ():
            told = named.get(f"kp.{joints.get(drive, drive)}", named.get("kp", 0.0))
            ratios += [told / float(value)] if told > 0.0 else []
    low, high = (min(ratios), max(ratios)) if ratios else (1.0, 1.0)
    if not (1.0 + _ALIKE < low <= high < _OTHER_UNIT or 1.0 / _OTHER_UNIT < low <= high < 1.0 - _ALIKE):
        return ""
    times = f"{low:.3g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.3g} to {high:.3g}"
    return (
        f". The gains kp that the log names are {times} times those found: if they are in N m/rad, all of these are to be "
        "multiplied by that, and so are the masses of what the drives move"
    )


def about_sensors(simulator: MujocoSimulator, calibration: Calibration) -> tuple[str, ...]:
    """A note for each sensor of a joint's own, or of a body, that was found to be late, or early."""
    late = dict(zip(simulator.parameters.names, simulator.quantities, strict=True))
    by = {
        "joint_sensor_delay": "was logged by a sensor of its own, which",
        "sensor_delay": "beside the joints' sensors",
    }
    return tuple(
        f"{', '.join(late[e.name].targets)} {by[late[e.name].kind]} tells {1e3 * abs(e.value):.3g} ms too "
        f"{'late' if e.value > 0.0 else 'early'} ([{1e3 * e.low:.3g}, {1e3 * e.high:.3g}] ms): it is compared with what was "
        f"so then. To set the log itself right, add {-e.value:.3g} to time_offset of its channel in the mapping"
        for e in calibration.estimates
        if e.fitted and e.low * e.high > 0.0 and e.name in late and late[e.name].kind in by
    )


def about_step(simulator: MujocoSimulator) -> tuple[str, ...]:
    """A note where the model steps otherwise than it is simulated."""
    own = float(simulator.model.compiled.opt.timestep)
    if abs(own - simulator.step) < 0.01 * simulator.step:
        return ()
    here = f"here it is simulated at {1e3 * simulator.step:g} ms, and values are those for that step"
    return (f"the model steps by {1e3 * own:g} ms; {here}",)


def about_load(simulator: MujocoSimulator, calibration: Calibration) -> tuple[str, ...]:
    """A note where servos stay far above the noise, and friction that grows with their load has not been tried."""
    kinds = {q.kind for q in simulator.quantities}
    seen = [r for r in calibration.training() if r.channel == "position"]
    if calibration.lacking or "kp" not in kinds or "friction_load" in kinds:
        return ()
    if not seen or not all(r.noise.all() for r in seen):
        return ()
    off = np.concatenate([((r.after - r.measured) / r.noise).ravel() for r in seen])
    times = float(spread(off[np.isfinite(off)]))  # the usual error: a walk that went another way tells nothing of it
    if not times > UNUSUAL:
        return ()
    return (
        f"the replay error stays at {times:.0f} times the noise. Is each joint the one that it is named (left and right, the "
        "order of numbers)? What is called identified is so for a model like this one, and may stand for what it lacks. "
        "Small geared servos may have friction that grows with their load: --beyond-mjcf tries that too (in twice the "
        "time), and `trueup replay --parameters` replays it" + _about_contacts(simulator),
    )


def _about_contacts(simulator: MujocoSimulator) -> str:
    """That nobody asks how soft contacts are where the shapes that touch have no names; "" elsewhere."""
    if not simulator.touches or quantity(SOFTNESS).choices(simulator.model, {}):
        return ""
    return (
        ". Something touches something here, and contacts stay as soft as the file has them: give the shapes (floor, foot) "
        f'names, and that is asked about, or declare quantity = "{SOFTNESS}" of them'
    )
