# SPDX-License-Identifier: Apache-2.0
"""A simulated 6-joint arm with 30 hidden parameters and noisy recordings: the problem of the calibration benchmarks."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from arm_model import ARMATURE, BODIES, DAMPING, FORCE_LIMIT, FRICTION, JOINTS, TIMESTEP, mjcf, write_meshes
from mujoco import rollout
from numpy.typing import NDArray

from trueup.recording import Channel, Recording

Array = NDArray[np.float64]

# Joint motion tells mass and CoM of these links apart. The first wrist link turns about an axis parallel to the
# forearm's: with it in place of the tool the bound on some CoM is above 1 cm.
LINKS = ("upper_arm", "forearm", "tool")
MEASURED_EVERY, DURATION = 2, 8.0  # steps, [s]

# Standard deviations: a 16-bit joint encoder, an on-line velocity estimate, a motor current at 1 % of the range.
NOISE: Mapping[str, Array] = {
    "position": np.full(6, 1e-4),  # [rad]
    "velocity": np.full(6, 2e-2),  # [rad/s]
    "torque": 0.01 * np.array(FORCE_LIMIT),  # [N m]
}
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N m"}

# Numbers of excitations. The training ones were chosen among 60 random ones by the Cramer-Rao bound at three draws of
# the truth (other ones than the benchmark's); even numbers are multisines, odd ones steps.
_TRAINING, _HELD_OUT = (0, 32, 31, 49), (40, 41)
_AMPLITUDE = np.array([1.0, 0.7, 0.9, 1.2, 1.2, 1.4])  # [rad]
_SPEED = np.array([3.0, 2.2, 3.0, 4.0, 4.0, 4.0])  # [rad/s]
_CENTER_LOW = np.array([-1.0, -1.7, -1.2, -1.2, -1.2, -1.0])  # [rad]
_CENTER_HIGH = np.array([1.0, -0.3, 1.2, 1.2, 1.2, 1.0])  # [rad]
_REST = 0.2  # [s] at the start of each recording


@dataclass(frozen=True)
class ArmParameter:
    """One unknown scalar. Quantities: joint.damping, joint.friction, joint.armature, body.mass, body.com_x, _y, _z."""

    quantity: str
    target: str
    unit: str
    nominal: float
    lower: float
    upper: float
    log: bool
    """Whether its natural scale is logarithmic (all but the CoM)."""


@dataclass(frozen=True)
class ArmProblem:
    """What is known (model, parameters, recordings) and what is to be found (`truth`)."""

    seed: int
    model: Path
    """The nominal MJCF; with `meshes`, STL files lie beside it."""
    xml: str
    """The nominal MJCF without meshes; dynamics are the same."""
    parameters: tuple[ArmParameter, ...]
    """30: damping, friction, armature of all joints, then mass and CoM of each of LINKS.

    A heavier link is a denser one: its rotational inertia about the CoM scales with its mass.
    """
    truth: Array
    """(30,)"""
    training: tuple[Recording, ...]
    """4 of 8 s at 250 Hz: command, position, velocity, torque (actuator force), at the same times; labels JOINTS.

    A sample at time t shows the state at t and the torque that the command of t makes there; commands are held.
    """
    held_out: tuple[Recording, ...]
    """2, as noisy as the training recordings."""
    held_out_truth: tuple[Recording, ...]
    """The same 2 without noise."""
    starts: Mapping[str, Array]
    """True start state of each recording (mjSTATE_FULLPHYSICS), by its name: at rest, holding the first command."""

    @property
    def nominal(self) -> Array:
        """(30,) values of the model as it is delivered: where a fit starts."""
        return np.array([p.nominal for p in self.parameters])


def make_problem(seed: int, *, meshes: int = 0, folder: Path | None = None) -> ArmProblem:
    """The problem with truth and noise drawn from `seed`; the motions are the same for all seeds.

    True damping, friction and armature are within exp(+-0.4) of nominal, masses within exp(+-0.35), CoM within 2.5 cm.
    `meshes` adds that many visual meshes of 20480 triangles, which make the model slow to compile.
    Files are written to `folder` (default: a new temporary one).
    """
    rng = np.random.default_rng([seed, 2026])
    xml, parameters = mjcf(), _parameters()
    truth = np.array([_draw(rng, p) for p in parameters])
    model = changed(xml, parameters, truth)
    names = [f"{'training' if i < 4 else 'held_out'}_{i if i < 4 else i - 4}" for i in range(6)]
    commands = np.stack([_excitation(k) for k in (*_TRAINING, *_HELD_OUT)])
    starts = np.stack([_settled(model, c[0]) for c in commands])
    sensors = _rollout([model], starts, commands)[0]
    clean = [_recording(n, c, s, None) for n, c, s in zip(names, commands, sensors, strict=True)]
    noisy = [_recording(n, c, s, rng) for n, c, s in zip(names, commands, sensors, strict=True)]
    if folder is None:
        folder = Path(tempfile.mkdtemp(prefix="arm-problem-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path = folder / "arm.xml"
    path.write_text(mjcf(write_meshes(folder, meshes)), encoding="utf-8")
    state = dict(zip(names, starts, strict=True))
    return ArmProblem(seed, path, xml, parameters, truth, tuple(noisy[:4]), tuple(noisy[4:]), tuple(clean[4:]), state)


def simulate(problem: ArmProblem, values: Array, recordings: Sequence[Recording]) -> Mapping[str, Array]:
    """Simulated (b, r, T, 6) by role, for `values` (b, 30), at the recordings' times, from the true start states."""
    models = [changed(problem.xml, problem.parameters, row) for row in np.atleast_2d(values)]
    starts = np.stack([problem.starts[r.name] for r in recordings])
    commands = np.stack([np.repeat(r.channel("command").values, MEASURED_EVERY, axis=0) for r in recordings])
    sensors = _rollout(models, starts, commands)[:, :, ::MEASURED_EVERY]
    return {role: sensors[..., 6 * i : 6 * i + 6] for i, role in enumerate(NOISE)}


def held_out_over_truth(problem: ArmProblem, values: Array) -> float:
    """Noise-weighted error on the held-out recordings over that of the true values; 1 is as good as knowing them."""
    both = simulate(problem, np.stack([values, problem.truth]), problem.held_out)
    squares = np.zeros(2)
    for role, simulated in both.items():
        measured = np.stack([r.channel(role).values for r in problem.held_out])
        squares += (((simulated - measured) / NOISE[role]) ** 2).sum(axis=(1, 2, 3))
    return float(np.sqrt(squares[0] / squares[1]))


def worst_mass_error(problem: ArmProblem, values: Array) -> float:
    """In percent of the true mass."""
    mass = np.array([p.quantity == "body.mass" for p in problem.parameters])
    return float(100 * np.abs(values[mass] / problem.truth[mass] - 1).max())


def worst_com_error(problem: ArmProblem, values: Array) -> float:
    """Largest distance of an estimated CoM from the true one, in mm."""
    com = np.array([p.quantity.startswith("body.com") for p in problem.parameters])
    return float(1e3 * np.linalg.norm((values - problem.truth)[com].reshape(-1, 3), axis=1).max())


def cramer_rao(problem: ArmProblem) -> Array:
    """(30,) least standard deviation of an unbiased estimate, by central differences at the truth; starts known."""
    step = np.where([p.log for p in problem.parameters], 1e-3 * np.abs(problem.truth), 1e-4)
    values = np.concatenate([problem.truth + np.diag(step), problem.truth - np.diag(step)])
    n, rows = len(step), []
    for role, simulated in simulate(problem, values, problem.training).items():
        slope = (simulated[:n] - simulated[n:]) / NOISE[role]
        rows.append(slope.reshape(n, -1) / (2 * step[:, None]))
    jacobian = np.concatenate(rows, axis=1)
    return np.sqrt(np.diag(np.linalg.inv(jacobian @ jacobian.T)))


def changed(xml: str, parameters: Sequence[ArmParameter], values: Array) -> mujoco.MjModel:
    """The model with `values` written into it."""
    model = mujoco.MjModel.from_xml_string(xml)
    dofs = {"joint.damping": model.dof_damping, "joint.friction": model.dof_frictionloss}
    dofs["joint.armature"] = model.dof_armature
    for p, value in zip(parameters, values, strict=True):
        if p.quantity in dofs:
            dofs[p.quantity][model.joint(p.target).dofadr[0]] = value
        elif p.quantity == "body.mass":
            body = model.body(p.target).id
            model.body_inertia[body] *= value / model.body_mass[body]
            model.body_mass[body] = value
        else:
            model.body_ipos[model.body(p.target).id, "xyz".index(p.quantity[-1])] = value
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _parameters() -> tuple[ArmParameter, ...]:
    rows = []
    for what, unit, nominal in (
        ("damping", "N m s/rad", DAMPING),
        ("friction", "N m", FRICTION),
        ("armature", "kg m^2", ARMATURE),
    ):
        rows += [
            ArmParameter(f"joint.{what}", j, unit, v, 0.05 * v, 20 * v, True)
            for j, v in zip(JOINTS, nominal, strict=True)
        ]
    for name, _, com, mass, *_ in BODIES:
        if name in LINKS:
            rows.append(ArmParameter("body.mass", name, "kg", mass, 0.3 * mass, 3 * mass, True))
            rows += [
                ArmParameter(f"body.com_{a}", name, "m", c, c - 0.1, c + 0.1, False)
                for a, c in zip("xyz", com, strict=True)
            ]
    return tuple(rows)


def _draw(rng: np.random.Generator, p: ArmParameter) -> float:
    if not p.log:
        return p.nominal + rng.uniform(-0.025, 0.025)
    spread = 0.35 if p.quantity == "body.mass" else 0.4
    return p.nominal * float(np.exp(rng.uniform(-spread, spread)))


def _excitation(number: int) -> Array:
    """(T, 6) commanded positions in rad, one per step, changing at the measured rate; at rest for _REST."""
    rng = np.random.default_rng(number)
    time = TIMESTEP * np.arange(round(DURATION / TIMESTEP), dtype=np.float64)
    center = rng.uniform(_CENTER_LOW, _CENTER_HIGH)
    make = _steps if number % 2 else _multisine
    motion = np.column_stack([make(rng, time, a, v) for a, v in zip(_AMPLITUDE, _SPEED, strict=True)])
    return np.repeat((center + motion)[::MEASURED_EVERY], MEASURED_EVERY, axis=0)


def _multisine(rng: np.random.Generator, time: Array, amplitude: float, speed: float) -> Array:
    """(T,) five harmonics up to 1.5 Hz, within amplitude and speed, faded in."""
    harmonics = rng.choice(np.arange(1, 13), 5, replace=False)
    weight = rng.uniform(0.5, 1.0, 5) / harmonics**0.6
    phase = rng.uniform(0, 2 * np.pi, 5)
    rate = 2 * np.pi * harmonics / DURATION
    angle = rate * time[:, None] + phase
    motion, velocity = (weight * np.sin(angle)).sum(axis=1), (weight * rate * np.cos(angle)).sum(axis=1)
    fade = np.clip((time - _REST) / 0.8, 0.0, 1.0)
    return motion * min(amplitude / np.abs(motion).max(), speed / np.abs(velocity).max()) * fade**2 * (3 - 2 * fade)


def _steps(rng: np.random.Generator, time: Array, amplitude: float, speed: float) -> Array:
    """(T,) eight targets at random instants, each approached at `speed` and held."""
    instants = np.concatenate([[0.0], np.sort(rng.uniform(0.3, 7.6, 8))])
    targets = np.concatenate([[0.0], rng.uniform(-1, 1, 8)]) * amplitude
    motion, position = np.empty_like(time), 0.0
    for i, target in enumerate(targets[np.searchsorted(instants, time, side="right") - 1]):
        position += float(np.clip(target - position, -speed * TIMESTEP, speed * TIMESTEP))
        motion[i] = position
    return motion


def _settled(model: mujoco.MjModel, command: Array) -> Array:
    """Start state after holding `command` for 2 s."""
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = command
    mujoco.mj_step(model, data, round(2.0 / TIMESTEP))
    data.time = 0.0
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS.value))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
    return state


def _rollout(models: Sequence[mujoco.MjModel], starts: Array, commands: Array) -> Array:
    """(b, r, T, 18) sensors at the start of each step, for r starts and commands (r, T, 6)."""
    b, r = len(models), len(starts)
    _, sensors = rollout.rollout(
        [model for model in models for _ in range(r)],
        [mujoco.MjData(models[0]) for _ in range(2)],
        np.tile(starts, (b, 1)),
        np.tile(commands, (b, 1, 1)),
    )
    return np.asarray(sensors).reshape(b, r, commands.shape[1], -1)


def _recording(name: str, command: Array, sensors: Array, rng: np.random.Generator | None) -> Recording:
    sampled = sensors[::MEASURED_EVERY]
    time = TIMESTEP * MEASURED_EVERY * np.arange(len(sampled), dtype=np.float64)
    channels = {"command": Channel("command", JOINTS, "rad", time, command[::MEASURED_EVERY])}
    for i, (role, sigma) in enumerate(NOISE.items()):
        values = sampled[:, 6 * i : 6 * i + 6]
        noise = 0.0 if rng is None else sigma * rng.standard_normal(values.shape)
        channels[role] = Channel(role, JOINTS, UNITS[role], time, values + noise)
    return Recording(name, channels, {"source": "simulated arm"})
