# SPDX-License-Identifier: Apache-2.0
"""The two models of a NAO, and walking tasks for the SimSpark-like one, quiet or noisy."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TypeVar

from trueup.articulated.declarations import Declaration, declare
from trueup.campaign.walks import Unrest, walking
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


TIPS = (0.04 / 0.27, 0.08 / 0.27)
"""rad of roll and pitch at which SimSpark's NAO stands on the edge of its sole: half of the sole over the height of its
centre of mass."""
_SOLES = ("L_sole", "R_sole")
DOUBTS = (
    Declaration("kp", MOTORS, tie="all", name="kp", lower=30.0, upper=250.0),
    Declaration("kv", MOTORS, tie="all", name="kv", lower=0.05, upper=8.0),
    Declaration(
        "friction", (*LEFT, *RIGHT), tie="all", name="friction", nominal=0.001, lower=0.0005, upper=0.12, scale="linear",
    ),
    Declaration("delay", ("*",), tie="all", name="delay", lower=0.0, upper=0.045),
    Declaration("contact_friction", _SOLES, tie="all", name="carpet", lower=0.5, upper=1.3),
    Declaration("contact_softness", _SOLES, tie="all", name="carpet", lower=0.01, upper=0.045),
    Declaration("com_x", ("torso",), tie="all", name="torso", lower=-0.03, upper=0.03),
)  # fmt: skip
"""What nobody knows of a robot whose simulator is SimSpark's: how stiff, damped, sticky and late its motors are, what it
walks on, and where its centre of mass lies. Servos of its size have 30 to 250 N m/rad and are 10 to 40 ms late."""


def doubtful(step: float = STEP, threads: int | None = None) -> MujocoSimulator:
    """The SimSpark-like simulator with `DOUBTS` open."""
    model = load(SIMSPARK)
    return MujocoSimulator(model, *declare(model, DOUBTS), step=step, threads=threads)


def task(kind: type[AnyWalk] = WalkFront, *, noisy: bool = True, period: float = CYCLE, **more: object) -> AnyWalk:
    """A walking task of the SimSpark-like model; `more` are fields of the task (`share`, `runs`, `seed`, ...)."""
    return walking(load(SIMSPARK), LEFT, RIGHT, kind, unrest=NOISE if noisy else None, period=period, **more)
