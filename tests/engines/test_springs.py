# SPDX-License-Identifier: Apache-2.0
"""Joints on springs, as legs have them: what a file says of their stiffness is searched like the rest of a drive."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.loop.calibrate import Options
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

LEG = """<mujoco><compiler angle="radian"/><option timestep=".002" integrator="implicitfast"/><worldbody>
<body><joint name="knee" axis="0 1 0" damping=".6" armature=".02" frictionloss=".05"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.2" mass=".8"/>
<body pos="0 0 -.2"><joint name="tarsus" axis="0 1 0" damping=".1" stiffness="{stiffness}"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3" mass=".6"/></body></body></worldbody>
<actuator><position name="knee" joint="knee" kp="{kp}"/></actuator></mujoco>"""


def log() -> Recording:
    """Three seconds of a leg in the air whose spring is softer than its file says, and whose servo is stiffer."""
    model = mujoco.MjModel.from_xml_string(LEG.format(stiffness=55, kp=90))
    data, rng, rows = mujoco.MjData(model), np.random.default_rng(0), []
    for k in range(1500):
        if k % 5 == 0:
            told = 0.3 * np.sin(5.0 * data.time) + 0.15 * np.sin(13.0 * data.time)
            rows.append([data.time, told, *(data.qpos + rng.normal(0.0, 2e-4, 2))])
            data.ctrl[:] = told
        mujoco.mj_step(model, data)
    time, told, seen = np.split(np.array(rows), [1, 2], axis=1)
    channels = (
        Channel("command", ("knee",), "rad", time[:, 0], told),
        Channel("position", ("knee", "tarsus"), "rad", time[:, 0], seen),
    )
    return Recording("air", {c.name: c for c in channels})


def test_the_stiffness_of_a_spring_in_the_file_is_calibrated(tmp_path: Path) -> None:
    (tmp_path / "leg.xml").write_text(LEG.format(stiffness=90, kp=60))
    ready = prepare(tmp_path / "leg.xml", [log()])
    found = ready.calibrate(Options(cross_validate=False, select=False))
    (spring,) = [e for e in found.estimates if e.name == "tarsus.spring"]
    assert spring.value == pytest.approx(55.0, rel=0.03)
    assert found.replays[0].rmse_after().max() < 1.5e-3
    ready.write(found, tmp_path / "fitted.xml", tmp_path / "fitted.toml")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "fitted.xml")).jnt_stiffness[1] == pytest.approx(spring.value)
