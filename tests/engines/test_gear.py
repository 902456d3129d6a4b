# SPDX-License-Identifier: Apache-2.0
"""A gear behind the encoder twists by the torque that it passes on and lets its link move within the gap, also as written."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.articulated.declarations import Declaration, declare
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.writing.write import write_model

ARM = """
<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast" gravity="0 0 0"/><worldbody>
<body name="upper"><joint name="a" axis="0 1 0" armature="{rotor}" damping="0.5"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1"/>
  <body name="lower" pos="0 0 -.3"><joint name="b" axis="0 1 0" armature="0.01" damping="0.5"/>
    <geom type="capsule" fromto="0 0 0 .2 0 0" size=".03" mass=".6"/></body></body></worldbody>
<actuator><position name="a" joint="a" kp="500" kv="5"/><position name="b" joint="b" kp="500" kv="5"/></actuator></mujoco>
"""


def twisted(
    folder: Path, torque: float, *, rotor: float = 0.02, fitted: float = 0.03, **gear: float
) -> tuple[float, float]:
    """The gear's angle and the drive's, at rest under a torque at the link, in the file that was written."""
    (folder / "arm.xml").write_text(ARM.format(rotor=rotor))
    model = load(folder / "arm.xml")
    lines = [Declaration("armature", ("a",)), *(Declaration(name, ("a",)) for name in gear)]
    simulator = MujocoSimulator(model, *declare(model, lines), step=0.001)
    write_model(simulator, [fitted, *gear.values()], folder / "fit.xml")
    written = mujoco.MjModel.from_xml_path(str(folder / "fit.xml"))
    data = mujoco.MjData(written)
    joint = written.joint("a/gear")
    data.qfrc_applied[joint.dofadr[0]] = data.qfrc_applied[written.joint("a").dofadr[0]] = torque
    for _ in range(4000):
        mujoco.mj_step(written, data)
    return float(data.qpos[joint.qposadr[0]]), float(data.qpos[written.joint("a").qposadr[0]])


@pytest.mark.parametrize("rotor", [0.0, 0.02])
def test_a_gear_twists_in_proportion_to_its_torque(tmp_path: Path, rotor: float) -> None:
    for torque in (1.0, -4.0):
        gear, drive = twisted(tmp_path, torque, rotor=rotor, gear_compliance=2e-3)
        assert gear == pytest.approx(2e-3 * torque, rel=0.1)
        assert drive == pytest.approx(torque / 500.0, rel=0.02), "all of the torque reaches the drive"


def test_a_gap_lets_the_link_go_to_its_end_and_no_further(tmp_path: Path) -> None:
    gear, drive = twisted(tmp_path, 1.0, gear_backlash=0.02)
    assert gear == pytest.approx(0.01, abs=5e-4)
    assert drive == pytest.approx(1.0 / 500.0, rel=0.02)
    both, _ = twisted(tmp_path, 1.0, gear_backlash=0.02, gear_compliance=2e-3)
    assert both == pytest.approx(0.012, rel=0.03)


def test_an_encoder_at_the_drive_does_not_see_the_gear(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM.format(rotor=0.02))
    model = load(tmp_path / "arm.xml")
    simulator = MujocoSimulator(model, *declare(model, [Declaration("gear_backlash", ("a",), nominal=0.02)]))
    assert simulator.compiled.joint("a/gear").id >= 0
    assert np.isclose(model.get("joint.gear_backlash", "a")[0], 0.0)
    from trueup.engines.mujoco.wiring import source_of

    source = source_of(model, simulator.compiled, "position", ("a", "b"))
    assert source is not None
    assert source.second is None
