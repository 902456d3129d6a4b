# SPDX-License-Identifier: Apache-2.0
"""Logs of a servo at several of its own gains: one stiffness explains them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.calibration import Calibration
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.loop.calibrate import Options
from trueup.loop.prepare import Preparation, prepare, simulator_for
from trueup.recording import Channel, Recording

_PENDULUM = """
<mujoco><option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body><joint name="arm" axis="0 1 0" damping="0.04" frictionloss="0.02" armature="0.001"/>
    <inertial pos="0 0 -0.1" mass="0.5" diaginertia="2e-4 2e-4 2e-4"/></body></worldbody>
  <actuator><position name="arm" joint="arm" kp="{kp}"/></actuator></mujoco>
"""
_PER_UNIT = 0.0021  # N m/rad of each unit of the servo's own gain


def _log(setting: float, kind: str, name: str) -> Recording:
    model = mujoco.MjModel.from_xml_string(_PENDULUM.format(kp=_PER_UNIT * setting))
    data = mujoco.MjData(model)
    time = np.arange(0.0, 4.0, 0.01)
    command = np.sin(2.0 * time) if kind == "sine" else np.where(time % 2.0 < 1.0, 0.8, -0.2)
    position = []
    for wanted in command:
        position.append(float(data.qpos[0]))
        data.ctrl[:] = wanted
        mujoco.mj_step(model, data, 5)
    noisy = np.array(position) + np.random.default_rng(int(setting)).normal(0.0, 5e-4, len(time))
    channels = {n: Channel(n, ("arm",), "rad", time, v) for n, v in (("command", command), ("position", noisy))}
    return Recording(name, channels, {"kp": f"{setting:g}"})


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "pendulum.xml"
    path.write_text(_PENDULUM.format(kp=1.0).replace('damping="0.04" frictionloss="0.02" armature="0.001"', ""))
    return path


def _fitted(model: Path, logs: Sequence[Recording], held: Sequence[Recording]) -> tuple[Preparation, Calibration]:
    ready = prepare(model, logs, held)
    return ready, ready.calibrate(Options(cross_validate=False))


def test_a_gain_that_was_never_fitted_is_replayed_nearly_to_the_noise(model: Path, tmp_path: Path) -> None:
    logs = [_log(100.0, "sine", "soft"), _log(400.0, "steps", "stiff")]
    ready, found = _fitted(model, logs, [_log(200.0, "steps", "between")])
    (between,) = found.held_out()
    assert np.std(between.after - between.measured) < 3e-3
    assert any("100, 200, 400" in note for note in ready.notes)
    (kp,) = [e for e in found.estimates if e.name == "arm.kp"]
    assert kp.value == pytest.approx(400.0 * _PER_UNIT, rel=0.03)
    # The file says for which gain it holds: alone with a log at another one it still replays it.
    ready.family.write(ready.simulator, found, tmp_path / "fit.xml", tmp_path / "parameters.toml")
    again, _ = simulator_for(tmp_path / "fit.xml", [_log(200.0, "sine", "soft alone")])
    assert isinstance(again, MujocoSimulator)
    assert again.gains.factors["kp"] == {"soft alone": pytest.approx(0.5)}
    again, _ = simulator_for(model, [_log(200.0, "sine", "soft alone")], tmp_path / "parameters.toml")
    assert isinstance(again, MujocoSimulator)
    assert again.gains.factors["kp"] == {"soft alone": pytest.approx(0.5)}


def test_logs_of_which_one_names_no_gain_are_taken_as_one_servo(model: Path) -> None:
    silent = replace(_log(400.0, "steps", "stiff"), provenance={})
    simulator, notes = simulator_for(model, [_log(100.0, "sine", "soft"), silent])
    assert isinstance(simulator, MujocoSimulator)
    assert simulator.gains.factors == {}
    assert not any("gain" in note for note in notes)
