# SPDX-License-Identifier: Apache-2.0
"""Factors on motors' torques that all say the same may as well be masses: that is said, with what they would be."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.loop.calibrate import Options
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

JOINTS = ("shoulder", "elbow")


def _arm(times: float) -> str:
    links = [f'<inertial mass="{m * times}" pos="0 0 -0.15" diaginertia="{i * times} {i * times} {i * times}"/>'
             for m, i in ((1.0, 0.01), (0.6, 0.006))]  # fmt: skip
    return f"""<mujoco><compiler angle="radian"/><option timestep="0.002"/>
    <default><joint damping="0.1" armature="0.005"/></default>
    <worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/>{links[0]}
    <body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0"/>{links[1]}</body></body></worldbody>
    <actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/></actuator></mujoco>"""


def _log(times: float, seed: int) -> Recording:
    rng, model = np.random.default_rng(seed), mujoco.MjModel.from_xml_string(_arm(times))
    data, time = mujoco.MjData(model), np.arange(0.0, 6.0, 0.01)
    pace, phase = rng.uniform(1.0, 6.0, (2, 3)), rng.uniform(0.0, 6.0, (2, 3))
    told = np.array([2.0, 0.7]) * np.sum(np.sin(pace * time[:, None, None] + phase), axis=2)
    rows = []
    for torque in told:
        rows.append(data.qpos + rng.normal(0.0, 3e-4, 2))
        data.ctrl[:] = torque
        mujoco.mj_step(model, data, 5)
    return Recording(f"log{seed}", {
        "command_torque": Channel("command_torque", JOINTS, "N m", time, told),
        "position": Channel("position", JOINTS, "rad", time, np.array(rows)),
    })  # fmt: skip


def test_factors_on_all_torques_are_said_to_be_masses_as_well(tmp_path: Path) -> None:
    (file := tmp_path / "arm.xml").write_text(_arm(1.0))
    ready = prepare(file, [_log(1.4, 0)])
    found = ready.calibrate(Options(cross_validate=False))
    (note,) = [n for n in ready.family.advice(ready.simulator, found) if "factors on the motors' torques" in n]
    (said,) = re.findall(r"these bodies are about ([\d.]+) times as heavy", note)
    assert float(said) == pytest.approx(1.4, rel=0.05)
