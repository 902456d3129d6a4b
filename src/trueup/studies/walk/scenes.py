# SPDX-License-Identifier: Apache-2.0
"""The two models of a NAO, and walking tasks for the SimSpark-like one, quiet or noisy."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TypeVar

from trueup.chance import Buffeting, CommandNoise, Disturbance, Sensing
from trueup.controllers.controller import ControllerFactory
from trueup.controllers.walk_engine.engine import PARAMETERS, WalkEngine
from trueup.controllers.walk_engine.legs import Biped
from trueup.engines.mujoco.biped import biped_of
from trueup.engines.mujoco.model import Model, load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.tasks.walking import Walk, WalkFront

NAO, SIMSPARK = (Path(str(resources.files("trueup") / "studies" / "walk" / f"{n}.xml")) for n in ("nao", "simspark"))
LEG = ("HipYawPitch", "HipRoll", "HipPitch", "KneePitch", "AnklePitch", "AnkleRoll")
LEFT, RIGHT = (tuple(f"{side}{n}" for n in LEG) for side in "LR")
MOTORS = (*LEFT, *RIGHT[1:])
"""The eleven motors of both legs: one turns both hip yaw-pitch joints."""
STEP = 0.005
"""s of simulation."""
CYCLE = 0.02
"""s from one command to the next in SimSpark; on the robot it is half of that."""

AnyWalk = TypeVar("AnyWalk", bound=Walk)


def biped(model: Model) -> Biped:
    """What a walk must know of either model."""
    return biped_of(model, LEFT, RIGHT)


def engine(model: Model, period: float) -> ControllerFactory:
    """Makes walks (b, 17) of a model, commanded every `period` s."""
    robot = biped(model)
    return lambda values: WalkEngine(robot, values, period=period)


def simulator(step: float = STEP, threads: int | None = None) -> MujocoSimulator:
    """The SimSpark-like simulator."""
    return MujocoSimulator(load(SIMSPARK), step=step, threads=threads)


def sensing(
    latency: float = CYCLE, gyro: float = 0.0, drift: float = 0.0, accelerometer: float = 0.0
) -> tuple[Sensing, ...]:
    """The inertial unit: noise of gyros (rad/s) and accelerometer (m/s2), what gyros are off by in a run (rad/s)."""
    return Sensing("gyro", gyro, latency, bias=drift), Sensing("accelerometer", accelerometer, latency)


QUIET = sensing()
NOISY = sensing(gyro=0.03, drift=0.01, accelerometer=0.3)
UNREST: tuple[Disturbance, ...] = (Buffeting("torso", 1.0), CommandNoise(0.008, MOTORS, every=1e3))
"""Pushes, and joints whose zero is wrong by half a degree throughout a run."""


def task(kind: type[AnyWalk] = WalkFront, *, noisy: bool = True, period: float = CYCLE, **more: object) -> AnyWalk:
    """A walking task of the SimSpark-like model; `more` are fields of the task (`share`, `runs`, `seed`, ...)."""
    model = load(SIMSPARK)
    fields: dict[str, object] = {
        "parameters": PARAMETERS, "make": engine(model, period), "height": float(model.compiled.key_qpos[0, 2]),
        "disturbances": UNREST if noisy else (), "sensing": NOISY if noisy else QUIET, **more,
    }  # fmt: skip
    return kind(**fields)  # type: ignore[arg-type]
