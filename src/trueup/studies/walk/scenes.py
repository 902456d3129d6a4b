# SPDX-License-Identifier: Apache-2.0
"""The two models of a NAO, and walking tasks for the SimSpark-like one, quiet or noisy."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TypeVar

from trueup.campaign.walks import STILL, Unrest, walking
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
NOISE = Unrest(push=1.0)

AnyWalk = TypeVar("AnyWalk", bound=Walk)


def biped(model: Model) -> Biped:
    """What a walk must know of either model."""
    return biped_of(model, LEFT, RIGHT)


def simulator(step: float = STEP, threads: int | None = None) -> MujocoSimulator:
    """The SimSpark-like simulator."""
    return MujocoSimulator(load(SIMSPARK), step=step, threads=threads)


def task(kind: type[AnyWalk] = WalkFront, *, noisy: bool = True, period: float = CYCLE, **more: object) -> AnyWalk:
    """A walking task of the SimSpark-like model; `more` are fields of the task (`share`, `runs`, `seed`, ...)."""
    return walking(load(SIMSPARK), LEFT, RIGHT, kind, unrest=NOISE if noisy else STILL, period=period, **more)
