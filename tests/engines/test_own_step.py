# SPDX-License-Identifier: Apache-2.0
"""A model is calibrated at the step that it will be simulated with: the one that its file names."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

_PENDULUM = """<mujoco><option {option}/><worldbody><body name="pole"><joint name="a" axis="0 1 0" damping="{damping}"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".01" mass=".2" contype="0"/></body></worldbody>
<actuator><motor name="a" joint="a"/></actuator></mujoco>"""


def _swung(option: str, damping: float) -> Recording:
    """2 s of a pendulum that a torque swings, measured every 10 ms."""
    model = mujoco.MjModel.from_xml_string(_PENDULUM.format(option=option, damping=damping))
    data, time = mujoco.MjData(model), np.arange(0.0, 2.0, 0.01)
    torque, seen = 0.15 * np.sin(5.0 * time), []
    for now in torque.tolist():
        seen.append(float(data.qpos[0]))
        data.ctrl[:] = now
        mujoco.mj_step(model, data, round(0.01 / model.opt.timestep))
    noisy = np.array(seen)[:, None] + np.random.default_rng(0).normal(0.0, 1e-4, (len(time), 1))
    position = Channel("position", ("a",), "rad", time, noisy)
    return Recording("swung", {"position": position, "command_torque": Channel("command_torque", ("a",), "N m", time,
                                                                               torque[:, None])})  # fmt: skip


@pytest.mark.parametrize(
    ("option", "step"),
    [("", 0.002), ('timestep="0.0005"', 0.0005), ('timestep="0.004"', 0.004), ('timestep="0.02"', 0.005)],
)
def test_a_model_is_simulated_at_its_own_step_of_five_milliseconds_at_most(
    tmp_path: Path, option: str, step: float
) -> None:
    (tmp_path / "pendulum.xml").write_text(_PENDULUM.format(option=option, damping=2e-3))
    recording = _swung('timestep="0.001"', 2e-3)
    ready = prepare(tmp_path / "pendulum.xml", [recording])
    assert ready.simulator.step == pytest.approx(step)
    told = " ".join(ready.family.advice(ready.simulator))
    assert ("the model steps by 20 ms; here it is simulated at 5 ms" in told) == (step == 0.005)
    asked = prepare(tmp_path / "pendulum.xml", [recording], step=0.001)
    assert asked.simulator.step == 0.001
    assert "here it is simulated at 1 ms" in " ".join(asked.family.advice(asked.simulator))


def test_damping_of_a_robot_that_steps_otherwise_than_usual_is_found(tmp_path: Path) -> None:
    """At 2 ms it would be a tenth off: steps of first order damp or drive, as they are long."""
    option = 'timestep="0.005" integrator="implicitfast"'
    (tmp_path / "pendulum.xml").write_text(_PENDULUM.format(option=option, damping=4e-3))
    (tmp_path / "damping.toml").write_text('[[parameter]]\nquantity = "damping"\nof = "a"\n')
    ready = prepare(tmp_path / "pendulum.xml", [_swung(option, 2e-3)], parameters=tmp_path / "damping.toml")
    (found,) = ready.calibrate().estimates
    assert found.value == pytest.approx(2e-3, rel=0.01)
