# SPDX-License-Identifier: Apache-2.0
"""A leg that lands and balances with a controller of its own: friction of the ground and gains are found again."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.controllers.controller import Observation
from trueup.loop.calibrate import Options, calibrate
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.simulators.mujoco.declarations import Declaration, declare
from trueup.simulators.mujoco.model import load
from trueup.simulators.mujoco.rollout import MujocoSimulator

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
TRUE_FRICTION, TRUE_GAINS = 0.45, np.array([60.0, 2.0])
# name, height above the ground [m], sideways speed [m/s], swing of the crouch [rad], duration [s]
RUNS = (("landing", 0.03, 0.0, 0.0, 0.9), ("sliding", 0.02, 0.8, 0.0, 1.2), ("squatting", 0.0, 0.5, 0.15, 1.6))


class Crouch:
    """A PD controller of hip and knee at PERIOD that holds a crouch, or squats; gains (b, 2) are kp and kd."""

    period = PERIOD

    def __init__(self, gains: Array) -> None:
        self._gains = gains
        self._swing = np.zeros(len(gains))

    def reset(self, observation: Observation) -> None:
        # Runs that squat begin a little deeper: the controller reads from the start pose which one it is.
        self._swing = observation.position[:, 3] - CROUCH[1]

    def command(self, observation: Observation) -> Array:
        phase = np.sin(2 * np.pi * 1.5 * observation.time)
        goal = CROUCH + np.stack([-0.5 * self._swing, self._swing], axis=1) * (1.0 - phase)
        error = goal - observation.position[:, 2:]
        return self._gains[:, :1] * error - self._gains[:, 1:] * observation.velocity[:, 2:]


def record(name: str, height: float, speed: float, swing: float, duration: float) -> Recording:
    """The truth in plain MuJoCo, one `mj_step` after the other, with noise on what is measured."""
    model = mujoco.MjModel.from_xml_string(LEG.format(friction=TRUE_FRICTION))
    data = mujoco.MjData(model)
    data.qpos[2:] = CROUCH + np.array([-0.5 * swing, swing])
    mujoco.mj_forward(model, data)
    data.qpos[1] -= data.geom("foot").xpos[2] - 0.02 - height
    data.qvel[0] = speed
    controller = Crouch(TRUE_GAINS[None])
    count = round(duration / model.opt.timestep)
    rows = np.empty((count, 2, 4))
    for k in range(count):
        rows[k] = data.qpos, data.qvel
        if k % round(PERIOD / model.opt.timestep) == 0:
            seen = Observation(data.time, data.qpos[None], data.qvel[None], {})
            if k == 0:
                controller.reset(seen)
            data.ctrl[:] = controller.command(seen)[0]
        mujoco.mj_step(model, data)
    rng = np.random.default_rng(len(name))
    time = model.opt.timestep * np.arange(count, dtype=np.float64)[::5]
    position = rows[::5, 0] + 3e-4 * rng.standard_normal((len(time), 4))
    velocity = rows[::5, 1] + 1e-2 * rng.standard_normal((len(time), 4))
    units = ("rad", "rad/s")
    channels = {
        role: Channel(role, JOINTS, unit, time, values)
        for role, unit, values in zip(("position", "velocity"), units, (position, velocity), strict=True)
    }
    return Recording(name, channels)


@pytest.mark.parametrize("search", ["auto"])
def test_friction_and_gains_of_a_leg_that_lands_and_balances_are_found(tmp_path: Path, search: str) -> None:
    recordings = [record(*run) for run in RUNS]
    assert len({len(r.time) for r in recordings}) == 3
    slid = recordings[1].channel("position").column("x")
    assert slid[-1] - slid[0] > 0.02
    path = tmp_path / "leg.xml"
    path.write_text(LEG.format(friction=1.0), encoding="utf-8")
    model = load(path)
    space, quantities = declare(model, [Declaration("contact_friction", ("floor",))])
    gains = ParameterSpace((
        Parameter("controller.kp", "N m/rad", 40.0, 10.0, 200.0, "log"),
        Parameter("controller.kd", "N m s/rad", 1.2, 0.2, 10.0, "log"),
    ))  # fmt: skip
    simulator = MujocoSimulator(model, space, quantities, step=0.001, controller=Crouch, controller_parameters=gains)
    result = calibrate(simulator, recordings, options=Options(search=search, seed=1))
    values = {e.name: e.value for e in result.estimates}
    assert values["controller.kp"] == pytest.approx(TRUE_GAINS[0], rel=0.1)
    assert values["controller.kd"] == pytest.approx(TRUE_GAINS[1], rel=0.1)
    assert values["floor.contact_friction"] == pytest.approx(TRUE_FRICTION, rel=0.1)
