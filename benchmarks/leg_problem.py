# SPDX-License-Identifier: Apache-2.0
"""A leg that lands, slides and squats under a controller of its own at 100 Hz: what the leg benchmark and tests fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.controllers.controller import Observation
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]

LEG = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast" cone="elliptic"/>
  <default><geom solref="0.01 1"/><joint damping="0.3" armature="0.01"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1" friction="{friction} 0.005 0.0001" priority="1"/>
    <body name="trunk" pos="0 0 0.42">
      <joint name="x" type="slide" axis="1 0 0" damping="0" armature="0"/>
      <joint name="z" type="slide" axis="0 0 1" damping="0" armature="0"/>
      <geom type="box" size="0.1 0.06 0.05" mass="3" contype="0" conaffinity="0"/>
      <body name="thigh">
        <joint name="hip" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
        <body name="shank" pos="0 0 -0.2">
          <joint name="knee" axis="0 1 0"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.015" mass="0.2" contype="0" conaffinity="0"/>
          <geom name="foot" type="sphere" pos="0 0 -0.2" size="0.02" mass="0.05"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="hip" joint="hip"/><motor name="knee" joint="knee"/></actuator>
</mujoco>
"""
JOINTS = ("x", "z", "hip", "knee")
PERIOD = 0.01  # s between two commands: 100 Hz, ten steps of the simulation
CROUCH = np.array([-0.5, 1.0])  # hip, knee [rad]; the foot is below the hip


@dataclass(frozen=True)
class Run:
    """One recording: height above the ground [m], sideways speed [m/s], swing of the crouch [rad], duration [s]."""

    name: str
    height: float
    speed: float
    swing: float
    duration: float


RUNS = (
    Run("landing", 0.03, 0.0, 0.0, 0.9), Run("sliding", 0.02, 0.8, 0.0, 1.2), Run("squatting", 0.0, 0.5, 0.15, 1.6),
)  # fmt: skip


@dataclass(frozen=True)
class Truth:
    """What the recordings were made with."""

    friction: float = 0.45
    kp: float = 60.0
    """N m/rad."""
    kd: float = 2.0
    """N m s/rad."""

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Truth:
        """Another robot: from slippery to rubber, from soft to stiff."""
        return cls(float(rng.uniform(0.25, 0.6)), *np.exp(rng.uniform(np.log([35.0, 1.2]), np.log([110.0, 3.5]))))


class Crouch:
    """A PD controller of hip and knee at PERIOD that holds a crouch, or squats; gains (b, 2) are kp and kd."""

    period = PERIOD

    def __init__(self, gains: Array) -> None:
        self._gains = gains
        self._swing, self._begun = 0.0, 0.0

    def reset(self, observation: Observation) -> None:
        """Which run it is, and at which instant of it a replay begins."""
        trial = observation.trial
        self._swing = next(run.swing for run in RUNS if trial is not None and run.name == trial.name)
        self._begun = 0.0 if trial is None else trial.start

    def command(self, observation: Observation) -> Array:
        """(b, 2) torques in N m."""
        phase = np.sin(2 * np.pi * 1.5 * (self._begun + observation.time))
        goal = CROUCH + np.array([-0.5, 1.0]) * self._swing * (1.0 - phase)
        error = goal - observation.position[:, 2:]
        return self._gains[:, :1] * error - self._gains[:, 1:] * observation.velocity[:, 2:]


def record(run: Run, truth: Truth, rng: np.random.Generator) -> Recording:
    """The truth in plain MuJoCo, one `mj_step` after the other, with noise on what is measured."""
    model = mujoco.MjModel.from_xml_string(LEG.format(friction=truth.friction))
    data = mujoco.MjData(model)
    data.qpos[2:] = CROUCH + np.array([-0.5 * run.swing, run.swing])
    mujoco.mj_forward(model, data)
    data.qpos[1] -= data.geom("foot").xpos[2] - 0.02 - run.height
    data.qvel[0] = run.speed
    controller = Crouch(np.array([[truth.kp, truth.kd]]))
    trial = Trial(run.name, 0.0, run.duration, None, {})
    count = round(run.duration / model.opt.timestep)
    rows = np.empty((count, 2, 4))
    for k in range(count):
        rows[k] = data.qpos, data.qvel
        if k % round(PERIOD / model.opt.timestep) == 0:
            seen = Observation(data.time, data.qpos[None], data.qvel[None], {}, trial)
            if k == 0:
                controller.reset(seen)
            data.ctrl[:] = controller.command(seen)[0]
        mujoco.mj_step(model, data)
    time = model.opt.timestep * np.arange(count, dtype=np.float64)[::5]
    noisy = {
        ("position", "rad"): rows[::5, 0] + 3e-4 * rng.standard_normal((len(time), 4)),
        ("velocity", "rad/s"): rows[::5, 1] + 1e-2 * rng.standard_normal((len(time), 4)),
    }
    return Recording(run.name, {role: Channel(role, JOINTS, unit, time, v) for (role, unit), v in noisy.items()})


def recordings(truth: Truth, rng: np.random.Generator, runs: Sequence[Run] = RUNS) -> list[Recording]:
    """All runs, of different lengths."""
    return [record(run, truth, rng) for run in runs]


def simulator(folder: Path) -> MujocoSimulator:
    """The leg as a user has it: ground friction 1, kp 40, kd 1.2, all three to be found."""
    path = folder / "leg.xml"
    path.write_text(LEG.format(friction=1.0), encoding="utf-8")
    model = load(path)
    gains = ParameterSpace((
        Parameter("controller.kp", "N m/rad", 40.0, 10.0, 200.0, "log"),
        Parameter("controller.kd", "N m s/rad", 1.2, 0.2, 10.0, "log"),
    ))  # fmt: skip
    space, quantities = declare(model, [Declaration("contact_friction", ("floor",))])
    return MujocoSimulator(model, space, quantities, step=0.001, controller=Crouch, controller_parameters=gains)
