# SPDX-License-Identifier: Apache-2.0
"""A hopper on a boom is carried by its foot, as what has a free base is: an arm, or the hopper hung up, is not."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.discrepancies.weighted import Weighted
from trueup.loop.prepare import prepare
from trueup.loop.problem import Problem
from trueup.loop.windows import carried
from trueup.recording import Channel, Recording

HOPPER = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><geom type="plane" size="5 5 1"/>
<body pos="0 0 {height}"><joint name="boom" axis="0 -1 0"/>
<geom type="capsule" fromto="0 0 0 1 0 0" size=".01" mass=".3" contype="0" conaffinity="0"/>
<body pos="1 0 0"><joint name="knee" axis="0 1 0" damping=".05"/>
<geom type="capsule" fromto="0 0 0 .1 0 -.2" size=".02" mass=".3" contype="0" conaffinity="0"/>
<geom type="sphere" pos=".1 0 -.2" size=".02" mass=".1"/></body></body></worldbody>
<actuator><position name="knee" joint="knee" kp="20" kv=".5"/>{boom}</actuator></mujoco>"""


@pytest.mark.parametrize(
    ("height", "boom", "by_contacts"),
    [(0.22, "", True), (2.0, "", False), (0.22, '<position name="boom" joint="boom" kp="20" kv="1"/>', False)],
)
def test_contacts_carry_what_hangs_on_joints_that_nothing_drives(
    tmp_path: Path, height: float, boom: str, by_contacts: bool
) -> None:
    (file := tmp_path / "hopper.xml").write_text(HOPPER.format(height=height, boom=boom))
    model = mujoco.MjModel.from_xml_path(str(file))
    data, time, seen, told = mujoco.MjData(model), np.arange(0.0, 1.0, 0.01), [], []
    for t in time:
        data.ctrl[0] = 0.2 * np.sin(6.0 * t)
        told.append(data.ctrl.copy())
        seen.append(data.qpos.copy())
        mujoco.mj_step(model, data, 5)
    driven = ("knee", "boom")[: model.nu]
    run = Recording("run", {
        "command": Channel("command", driven, "rad", time, np.array(told)),
        "position": Channel("position", ("boom", "knee"), "rad", time, np.array(seen)),
    })  # fmt: skip
    simulator = prepare(file, [run]).simulator
    problem = Problem(simulator, [run], Weighted.estimated([run], ["position"]), ("position",))
    problem.start_residual(simulator.parameters.nominal)
    assert carried(problem) == by_contacts
