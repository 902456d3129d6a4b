# SPDX-License-Identifier: Apache-2.0
"""Arms with closed loops and grippers whose fingers follow: what no encoder sees begins where the constraints have it."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording
from trueup.trial import Trial

FOUR_BAR = """<mujoco><option timestep=".002" integrator="implicitfast"/>
<default><joint damping=".05"/><geom contype="0" conaffinity="0"/></default><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .3" size=".02"/>
<body name="fore" pos="0 0 .3"><joint name="elbow" axis="0 1 0"/>
<geom type="capsule" fromto="-.12 0 0 .3 0 0" size=".02"/></body></body>
<body name="crank" pos="0 .05 0"><joint name="crank" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 -.12 0 0" size=".015"/>
<body name="rod" pos="-.12 0 0"><joint name="rod" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 .3" size=".01"/></body></body></worldbody>
<equality><connect body1="rod" body2="fore" anchor="0 0 .3"/></equality>
<actuator><position joint="shoulder" kp="200" kv="10"/><position joint="crank" kp="200" kv="10"/></actuator></mujoco>"""
GRIPPER = """<mujoco><option timestep=".002"/><default><geom contype="0" conaffinity="0"/></default><worldbody>
<body><joint name="left" type="slide" axis="0 1 0"/><geom size=".01" mass=".1"/></body>
<body><joint name="right" type="slide" axis="0 -1 0"/><geom size=".01" mass=".1"/></body></worldbody>
<equality><joint joint1="right" joint2="left"/></equality>
<actuator><position joint="left" kp="60" kv="3"/></actuator></mujoco>"""


def _recorded(xml: str, driven: list[str], start: list[float], unit: str) -> Recording:
    """What encoders at the drives see of 0.6 s that begin with settled joints, on a way to somewhere else."""
    m = mujoco.MjModel.from_xml_string(xml)
    d = mujoco.MjData(m)
    d.ctrl[:] = start
    mujoco.mj_step(m, d, 3000)
    columns = [int(m.joint(name).qposadr[0]) for name in driven]
    time, seen, told = np.linspace(0.0, 0.598, 300), [], []
    for t in time:
        d.ctrl[:] = np.array(start) * (1.0 - 0.5 * t)
        seen.append(d.qpos[columns])
        told.append(np.array(d.ctrl))
        mujoco.mj_step(m, d)
    return Recording("run", {name: Channel(name, tuple(driven), unit, time, np.array(values))
                             for name, values in (("command", told), ("position", seen))})  # fmt: skip


@pytest.mark.parametrize(("xml", "driven", "start", "unit"), [
    (FOUR_BAR, ["shoulder", "crank"], [0.4, -0.7], "rad"), (GRIPPER, ["left"], [0.03], "m"),
])  # fmt: skip
def test_joints_without_encoders_begin_where_the_loop_has_them(
    tmp_path: Path, xml: str, driven: list[str], start: list[float], unit: str
) -> None:
    """Left at the model's rest they were torn to their places, and the driven joints with them."""
    (tmp_path / "arm.xml").write_text(xml)
    ready = prepare(tmp_path / "arm.xml", [_recorded(xml, driven, start, unit)], propose=False, step=0.002)
    (run,) = ready.recordings
    (rollout,) = ready.simulator.rollout([Trial.of(run)], np.zeros((1, 0)))
    error = rollout.channels["position"][0] - run.channel("position").values
    assert np.abs(error).max() < 5e-3 * max(map(abs, start))
