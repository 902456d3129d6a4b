# SPDX-License-Identifier: Apache-2.0
"""A stand-in for a real servo arm: its hidden truth has another structure than the simulator being calibrated.

Each drive is a rotor of its own behind a gap: Stribeck friction at the rotor, backlash between rotor and link, a motor
fed by a limited voltage (so that torque falls with speed), a command that comes late, and a coarse, noisy encoder.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from trueup.arrays import Array
from trueup.errors import ModelError, RecordingError, unknown_name
from trueup.recording import Channel, Recording
from trueup.samples import between
from trueup.trial import SETTLE, Trial


@dataclass(frozen=True)
class Drive:
    """One servo's truth, at its output shaft. Friction after Armstrong-Helouvry et al., Automatica 30(7), 1994."""

    stiffness: float = 17.0
    """Torque per rad of servo error while the voltage is not at its limit, in N m/rad."""
    stall: float = 2.9
    """Torque at full voltage and standstill, in N m."""
    no_load_speed: float = 6.5
    """Speed at full voltage without load, in rad/s; torque falls linearly up to there."""
    inertia: float = 0.012
    """Rotor inertia, in kg m2."""
    coulomb: float = 0.10
    """In N m."""
    breakaway: float = 0.05
    """Static above Coulomb friction, in N m."""
    stribeck: float = 0.12
    """Speed at which the breakaway part has faded to 1/e, in rad/s."""
    viscous: float = 0.04
    """In N m s/rad."""
    backlash: float = 0.008
    """Gap between rotor and link, end to end, in rad."""
    delay: float = 0.021
    """From command to servo, in s."""


_DRIVES = (
    Drive(stiffness=19.0, coulomb=0.12),
    Drive(stiffness=16.0, coulomb=0.14, breakaway=0.06),
    Drive(stiffness=17.5, coulomb=0.09, backlash=0.010),
    Drive(stiffness=14.0, coulomb=0.07, inertia=0.009, stall=2.4),
)


class StandInArm:
    """A simulated Robot. `path` is an MJCF of hinges in series, whose own drive values are ignored.

    The truth differs from it in `drives` (one for each actuated joint, in the model's order) and in body masses, which
    are `heavier` times the model's; it moves in steps of `step` s. Encoder: `grid` in rad, `noise` (standard deviation before
    rounding) in rad; what it draws depends on `seed` and the trial's name alone. Raises ModelError where drives and actuators
    do not correspond.
    """

    def __init__(
        self, path: str | Path, *, seed: int = 0, drives: tuple[Drive, ...] = _DRIVES, heavier: float = 1.1,
        grid: float = 2 * np.pi / 4096, noise: float = 4e-4, step: float = 1e-3,
    ) -> None:  # fmt: skip
        self._model = _bare(Path(path), heavier, step)
        m = self._model
        if m.nu != len(drives) or m.nv != m.nu or m.nq != m.nu:
            raise ModelError(f"'{path}' has {m.nu} actuators and {m.nv} degrees of freedom for {len(drives)} drives")
        self.joints = tuple(m.joint(i).name for i in range(m.njnt))
        self._drives = drives
        self._grid, self._noise = grid, noise
        self._seed = seed

    @property
    def repeatable(self) -> bool:
        """True: the same trial gives the same recordings."""
        return True

    def perform(self, trial: Trial) -> list[Recording]:
        """See Robot. Observes 'position' and 'velocity' of any joints; commands beyond a joint's range are cut.

        Raises RecordingError for a trial without commands, UnknownNameError for other joints or channels.
        """
        if trial.command is None:
            raise RecordingError(f"trial '{trial.name}': this arm needs a command channel")
        for label in {*trial.command.labels, *(x for o in trial.observed.values() for x in o.labels)}:
            if label not in self.joints:
                raise unknown_name("joint", label, self.joints, "this arm")
        for name in trial.observed:
            if name not in ("position", "velocity"):
                raise unknown_name("channel", name, ("position", "velocity"), "what this arm measures")
        sent = trial.command.replace(name="command_sent", values=self._within(trial.command))
        time, position, velocity = self._run(trial, sent)
        rng = np.random.default_rng([self._seed, zlib.crc32(trial.name.encode())])
        return [self._recording(name, trial, sent, time, position, velocity, rng) for name in trial.runs]

    def _within(self, command: Channel) -> Array:
        rows = [self.joints.index(label) for label in command.labels]
        low, high = self._model.jnt_range[rows].T
        return np.clip(command.values, low, high)

    def _run(self, trial: Trial, sent: Channel) -> tuple[Array, Array, Array]:
        """Times (T,) on the trial's clock and rotor angles and speeds (T, nq) behind the encoder."""
        step = self._model.opt.timestep
        count = int(np.ceil((trial.duration + SETTLE) / step)) + 2
        time = trial.start - SETTLE + step * np.arange(count, dtype=np.float64)
        orders = np.zeros((count, len(self.joints)))
        for label in sent.labels:
            j = self.joints.index(label)
            orders[:, j] = sent.select([label]).at(time - self._drives[j].delay, hold=True)[:, 0]
        motor = _Motors(self._drives, orders[0], step)
        data = mujoco.MjData(self._model)
        data.qpos[:] = orders[0]
        angles, speeds = np.empty_like(orders), np.empty_like(orders)
        for k in range(count):
            angles[k], speeds[k] = motor.angle, motor.speed
            seen = np.round(motor.angle / self._grid) * self._grid
            data.qfrc_applied[:] = motor.advance(orders[k], seen, data.qpos, data.qvel)
            mujoco.mj_step(self._model, data)
        return time, angles, speeds

    def _recording(
        self, name: str, trial: Trial, sent: Channel, time: Array, position: Array, velocity: Array,
        rng: np.random.Generator,
    ) -> Recording:  # fmt: skip
        command = trial.command
        if command is None:
            raise RecordingError(f"trial '{trial.name}' has no command")
        channels = {"command": command.replace(name="command")}
        if not np.array_equal(sent.values, command.values):
            channels["command_sent"] = sent
        for role, o in trial.observed.items():
            truth = position if role == "position" else velocity
            values = between(o.time, time, truth[:, [self.joints.index(x) for x in o.labels]])
            scale = self._noise if role == "position" else 20.0 * self._noise
            values = values + scale * rng.standard_normal(values.shape)
            if role == "position":
                values = np.round(values / self._grid) * self._grid
            channels[role] = Channel(role, o.labels, o.unit, o.time, values)
        return Recording(name, channels, {"source": "stand-in arm"})


class _Motors:
    """Rotors of all drives, stepped together; arrays are (n,)."""

    def __init__(self, drives: tuple[Drive, ...], angle: Array, step: float) -> None:
        self._step, self.angle, self.speed = step, np.array(angle), np.zeros(len(drives))
        names = ("stiffness", "stall", "no_load_speed", "inertia", "coulomb", "breakaway", "stribeck", "viscous")
        self._truth = tuple(np.array([getattr(d, n) for d in drives]) for n in names)
        self._half = 0.5 * np.array([d.backlash for d in drives])

    def advance(self, order: Array, seen: Array, link: Array, link_speed: Array) -> Array:
        """(n,) torque on the links in N m; moves the rotors on by one step."""
        stiffness, stall, fastest, inertia, coulomb, breakaway, stribeck, viscous = self._truth
        gap = self.angle - link
        stretch = gap - np.minimum(np.maximum(gap, -self._half), self._half)
        # Teeth in contact: a stiff spring with some damping; nothing is passed on inside the gap.
        passed = 80.0 * stretch + 0.05 * (self.speed - link_speed) * (stretch != 0.0)
        voltage = np.minimum(np.maximum(stiffness * (order - seen) / stall, -1.0), 1.0)
        torque = stall * (voltage - self.speed / fastest) - viscous * self.speed - passed
        free = self.speed + self._step / inertia * torque
        grip = coulomb + breakaway * np.exp(-((self.speed / stribeck) ** 2))
        # Friction brings a rotor to rest within a step and holds it there: it sticks, without creep.
        self.speed = np.sign(free) * np.maximum(np.abs(free) - self._step / inertia * grip, 0.0)
        self.angle = self.angle + self._step * self.speed
        return passed


def _bare(path: Path, heavier: float, step: float) -> mujoco.MjModel:
    """The links alone: no servo, no friction, no contacts, and other masses than the model says."""
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise ModelError(f"model '{path}' does not load: {' '.join(str(error).split())}") from None
    model.opt.timestep = step
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION) | int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    model.dof_damping[:] = model.dof_frictionloss[:] = model.dof_armature[:] = 0.0
    model.body_mass[:] *= heavier
    model.body_inertia[:] *= heavier
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model
