# SPDX-License-Identifier: Apache-2.0
"""A stand-in for a worn NAO on carpet: the robot's own model with a hidden truth, and runs that are never quite alike."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType

import numpy as np

from trueup.arrays import Array
from trueup.articulated.assignments import Assignment
from trueup.articulated.declarations import Declaration, declare
from trueup.chance import Buffeting, StartScatter
from trueup.controllers.controller import Controller, Observation
from trueup.controllers.playback import Playback
from trueup.controllers.walk_engine.engine import PARAMETERS, WalkEngine
from trueup.ends import LOW, TILT, Fallen
from trueup.engines.mujoco.model import Model, load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.errors import unknown_name
from trueup.parameters import ParameterSpace
from trueup.recording import Channel, Recording
from trueup.studies.walk.scenes import MOTORS, NAO, NOISE, STEP, biped
from trueup.trial import Observed, Trial

PERIOD = 0.01
"""s from one command to the next."""
_SOLES = tuple(f"{s}_{p}_{q}" for s in "LR" for p in ("front", "mid", "rear") for q in ("out", "in"))
_DRAWN: Mapping[str, tuple[float, float]] = MappingProxyType({
    "kp": (41.0, 48.0),  # N m/rad of the leg motors: at 80 walks transfer by themselves, at 30 nothing walks
    "friction": (0.06, 0.10),  # N m in the legs' gears
    "delay": (0.026, 0.036),  # s from command to motor
    "contact_friction": (0.65, 0.90),  # of soles on carpet
    "contact_softness": (0.016, 0.024),  # s
    "mass": (1.00, 1.10),  # kg of the torso, with its battery
    "com_x": (-0.007, -0.001),  # m, of the torso
})  # fmt: skip
"""Ranges from which stand-ins are drawn, in which what a simulator promises does not simply hold on the robot."""
_ZERO = 0.008  # rad by which the zeros of joints are off, one deviation
_SCATTER = {"kp": 0.03, "delay": 0.03, "contact_friction": 0.06}
"""By which share these vary from run to run: battery, temperature, where on the carpet."""
_PUSH = 1.0  # N
_SLOPE = 0.004  # rad by which the floor is off level, from run to run


@dataclass(frozen=True)
class Truth:
    """What is hidden in one robot."""

    values: Mapping[str, float]
    """By the names of `hidden`'s parameters, in their units."""
    play: float
    """rad to each side by which a gear lags behind its reversed command."""

    @classmethod
    def random(cls, rng: np.random.Generator) -> Truth:
        """A robot as it may come."""
        values = {name: float(rng.uniform(*span)) for name, span in _DRAWN.items()}
        zeros = {f"{motor}.zero": float(_ZERO * rng.standard_normal()) for motor in MOTORS}
        return cls({**values, **zeros}, float(rng.uniform(0.010, 0.014)))


@cache
def hidden() -> tuple[Model, ParameterSpace, tuple[Assignment, ...]]:
    """The robot's model, and what of it the truth sets: names as in `Truth.values`, and the floor's slope."""
    model = load(NAO)
    tied = {"kp": MOTORS, "friction": MOTORS, "delay": ("*",), "contact_friction": _SOLES, "contact_softness": _SOLES,
            "mass": ("torso",), "com_x": ("torso",)}  # fmt: skip
    lines = [Declaration(q, of, tie="all", name=q) for q, of in tied.items()]
    lines += [Declaration("zero", MOTORS), Declaration("tilt_roll"), Declaration("tilt_pitch")]
    return (model, *declare(model, lines))


class StandInNao:
    """A simulated Robot that walks by its own engine, told the parameters, or plays a trial's command.

    What it draws depends on `seed` and the trial's name alone; repeats differ as runs of a robot do. It logs joints,
    commands and its inertial unit at `log` Hz beside what a trial observes (0: only that); where it is on the field
    ('base_position', 'base_orientation') it knows as if it were filmed.
    """

    def __init__(
        self, truth: Truth, *, seed: int = 0, step: float = STEP, threads: int | None = None, log: float = 100.0
    ) -> None:
        self.model, space, quantities = hidden()
        self.truth, self._seed, self._log = truth, seed, log
        self._simulator = MujocoSimulator(self.model, space, quantities, step=step, threads=threads)
        self._biped = biped(self.model)

    @property
    def repeatable(self) -> bool:
        """True: the same trial gives the same recordings."""
        return True

    def perform(self, trial: Trial) -> list[Recording]:
        """See Robot. Where a run starts is the robot's own standing pose, whatever the trial says.

        Raises TrialError for a trial that says neither where to walk nor what to command, UnknownNameError for settings
        that are no parameters of its walk.
        """
        rng = np.random.default_rng([self._seed, zlib.crc32(trial.name.encode())])
        values = self._values(rng, trial.repeats)
        drives: list[_Drives] = []

        def drives_of(rows: Array) -> Controller:
            drives.append(_Drives(self._software(trial, len(rows)), self.truth.play))
            return drives[-1]

        mine = self._own(trial, rng)
        (rollout,) = self._simulator.rollout([replace(mine, controller=drives_of)], values)
        return [self._recording(name, rollout.recording(i), drives[0], i) for i, name in enumerate(trial.runs)]

    def _values(self, rng: np.random.Generator, runs: int) -> Array:
        """(runs, n) of `hidden`'s parameters."""
        _, space, _ = hidden()
        own = {**self.truth.values, "tilt_roll": 0.0, "tilt_pitch": 0.0}
        values = np.tile([own[name] for name in space.names], (runs, 1))
        for name, share in _SCATTER.items():
            values[:, space.index(name)] *= 1.0 + share * rng.standard_normal(runs)
        for name in ("tilt_roll", "tilt_pitch"):
            values[:, space.index(name)] = _SLOPE * rng.standard_normal(runs)
        return values

    def _software(self, trial: Trial, rows: int) -> Controller:
        if trial.command is not None:
            return Playback(self._all_motors(trial.command), rows, period=PERIOD, start=trial.start)
        for name in trial.settings:
            if name not in PARAMETERS.names:
                raise unknown_name("setting", name, PARAMETERS.names, "this robot's walk")
        own = dict(zip(PARAMETERS.names, PARAMETERS.nominal.tolist(), strict=True))
        values = np.tile(list({**own, **trial.settings}.values()), (rows, 1))
        return WalkEngine(self._biped, values, period=PERIOD)

    def _all_motors(self, command: Channel) -> Channel:
        """The command with the motors that it leaves out at rest."""
        names = self.model.names("actuator")
        values = np.repeat(self._biped.rest[None], len(command.time), axis=0)
        for k, label in enumerate(command.labels):
            if label not in names:
                raise unknown_name("motor", label, names, "this robot")
            values[:, names.index(label)] = command.values[:, k]
        return command.replace(labels=names, values=values)

    def _own(self, trial: Trial, rng: np.random.Generator) -> Trial:
        """The trial as this robot meets it."""
        time = np.arange(int(trial.duration * self._log + 1e-9) + 1) / self._log if self._log else np.zeros(0)
        logged = {
            "position": Observed(self.model.scalar_joints(), "rad", trial.start + time),
            "gyro": Observed(("gyro.x", "gyro.y", "gyro.z"), "rad/s", trial.start + time),
            "accelerometer": Observed(tuple(f"accelerometer.{a}" for a in "xyz"), "m/s^2", trial.start + time),
        }  # fmt: skip
        height = LOW * float(self.model.compiled.key_qpos[0, 2])
        ends = (*(e for e in trial.ends if not isinstance(e, Fallen)), Fallen(height=height, tilt=TILT))
        return replace(
            trial, command=None, initial={}, ends=ends, observed={**(logged if self._log else {}), **trial.observed},
            disturbances=(Buffeting("torso", _PUSH), StartScatter("position", 0.01)),
            sensing=NOISE.sensing(PERIOD),
        ).seeded(rng)  # fmt: skip

    def _recording(self, name: str, run: Recording, drives: _Drives, row: int) -> Recording:
        time, orders = drives.log(row)
        command = Channel("command", self.model.names("actuator"), "rad", run.start + time, orders)
        kept = command.time <= run.stop + 1e-9
        command = command.replace(time=command.time[kept], values=command.values[kept])
        made = run.with_channel(command)
        return made.replace(name=name, provenance={**made.provenance, "source": "stand-in NAO"})


class _Drives:
    """A Controller between the robot's software and its motors: remembers what was asked, and lets gears play."""

    def __init__(self, software: Controller, play: float) -> None:
        self._software, self._play, self.period = software, play, software.period
        self._orders: list[Array] = []
        self._times: list[float] = []
        self._last: Array | None = None

    def log(self, row: int) -> tuple[Array, Array]:
        """Times (T,) in s and commands (T, nu) of one run."""
        return np.array(self._times), np.array([o[row] for o in self._orders])

    def reset(self, observation: Observation) -> None:
        """See Controller."""
        self._software.reset(observation)

    def command(self, observation: Observation) -> Array:
        """See Controller."""
        order = self._software.command(observation)
        self._times.append(observation.time)
        self._orders.append(order)
        before = order if self._last is None else self._last
        self._last = np.clip(before, order - self._play, order + self._play)
        return self._last
