# SPDX-License-Identifier: Apache-2.0
"""A table that stops the robot and that the model lacks is noticed, found and written; none is invented."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.engines.mujoco.floor_plane import plane_of, rules
from trueup.engines.mujoco.model import load, prepared
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.setup.floor import reach_of
from trueup.engines.mujoco.writing.write import simulated_model, write_model
from trueup.errors import UnknownNameError
from trueup.inspection.floor import stopped_by_floor
from trueup.loop.calibrate import Options, calibrate
from trueup.loop.fit import DESCENT
from trueup.loop.prepare import prepare, simulator_for
from trueup.recording import Channel, Recording

QUICK = Options(cross_validate=False, lacking=False, stages=DESCENT)

Array = NDArray[np.float64]

STEP, EVERY = 5e-4, 40
JOINTS = ("shoulder", "elbow")
ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default>
    <joint axis="0 1 0" damping="{damping}" frictionloss="0.1" armature="0.02" solimpfriction="0.999 0.999 0.001"/>
    <geom type="capsule" size="0.02" mass="0.3" contype="0" conaffinity="0"/>
    <position kp="{kp}"/>
  </default>
  <worldbody>{table}
    <body name="upper" pos="0 0 0.1">
      <joint name="shoulder"/>
      <geom fromto="0 0 0 0.2 0 0"/>
      <body name="lower" pos="0.2 0 0">
        <joint name="elbow"/>
        <geom fromto="0 0 0 0.2 0 0" contype="1" conaffinity="1"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="shoulder" joint="shoulder"/><position name="elbow" joint="elbow"/></actuator>
</mujoco>
"""
TABLE = '<geom name="table" type="plane" size="0 0 0.1" pos="0 0 {z}" friction="0.2" contype="1" conaffinity="1"/>'


def record(name: str, seed: int, table: float | None) -> Recording:
    """An arm (kp 40, damping 0.8) told to go to postures of which some are below the table, if there is one."""
    xml = ARM.format(kp=40, damping=0.8, table="" if table is None else TABLE.format(z=table))
    model, rng = mujoco.MjModel.from_xml_string(xml), np.random.default_rng(seed)
    model.opt.timestep = STEP
    data = mujoco.MjData(model)
    goals = np.stack([rng.uniform(-0.3, 0.35, 7), rng.uniform(-0.2, 0.5, 7)], axis=1)
    goals[0], goals[3] = 0.0, (0.35, 0.45)
    time = STEP * EVERY * np.arange(round(7.0 / (STEP * EVERY)), dtype=np.float64)
    command = np.stack([np.interp(time, np.arange(7) + 0.3, g) for g in goals.T], axis=1)
    angles = np.empty((len(time), 2))
    for _ in range(2000):
        mujoco.mj_step(model, data)
    for k in range(len(time) * EVERY):
        if k % EVERY == 0:
            angles[k // EVERY] = data.qpos
        data.ctrl[:] = command[k // EVERY]
        mujoco.mj_step(model, data)
    angles += 3e-4 * rng.standard_normal(angles.shape)
    return Recording(name, {"command": Channel("command", JOINTS, "rad", time, command),
                            "position": Channel("position", JOINTS, "rad", time, angles)})  # fmt: skip


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(kp=20, damping=0.4, table=""), encoding="utf-8")
    return path


def test_a_table_is_noticed_found_and_written(arm: Path) -> None:
    recordings = [record(f"r{i}", i, table=-0.08) for i in range(2)]
    simulator, notes = simulator_for(arm, recordings)
    assert any("stopped above where its commands" in n for n in notes)
    # Armatures, zeros and delays are those of the file.
    asked = ("kp", "damping", "friction", "floor_height", "floor_roll", "floor_pitch", "floor_friction")
    space = simulator.parameters
    space = space.left_out([name for name in space.names if name.rpartition(".")[2] not in asked])
    found = calibrate(simulator, recordings[:1], recordings[1:], options=QUICK, space=space)
    values = {e.name: e.value for e in found.estimates}
    # Height and pitch trade where all touches lie on one side of the origin: what counts is the height below the hand.
    touched = 0.36
    assert values["floor_height"] - touched * values["floor_pitch"] == pytest.approx(-0.08, abs=1e-3)
    height = next(e for e in found.estimates if e.name == "floor_height")
    assert height.low <= -0.08 <= height.high
    # Left-out stretches need no tilt of a level table: none, or one of a millimetre in ten metres.
    assert values["floor_roll"] == pytest.approx(0.0, abs=1e-4)
    assert values["floor_pitch"] == pytest.approx(0.0, abs=1e-4)
    assert values["shoulder.kp"] == pytest.approx(40.0, rel=0.1)
    for replay in found.held_out():
        assert replay.rmse_after().max() < 3e-3
    path = arm.with_name("found.xml")
    assert isinstance(simulator, MujocoSimulator)
    write_model(simulator, found.values, path)
    written = mujoco.MjModel.from_xml_path(str(path))
    assert written.geom_pos[plane_of(written), 2] == pytest.approx(values["floor_height"], abs=1e-6)


def test_no_table_is_invented_where_nothing_was_in_the_way(arm: Path) -> None:
    reach = reach_of(load(arm))
    assert reach is not None
    assert stopped_by_floor(reach, [record(f"r{i}", i, table=None) for i in range(2)]) is None


def test_a_diagnosed_floor_is_shown_with_its_height_and_can_be_refused(arm: Path) -> None:
    recordings = [record(f"r{i}", i, table=-0.08) for i in range(2)]
    found = {d.name: d for d in prepare(arm, recordings).diagnoses}
    assert found["floor"].numbers["height"] == pytest.approx(-0.08, abs=0.01)
    assert "one is added" in found["floor"].edit
    refused = prepare(arm, recordings, refuse=["floor", "zero"])
    assert {d.name for d in refused.diagnoses if d.refused} == {"floor"} | ({"zero"} & set(found))
    assert any(note.startswith("refused") and "stopped above where" in note for note in refused.notes)
    assert not [n for n in refused.simulator.parameters.names if "floor" in n or "zero" in n]
    with pytest.raises(UnknownNameError, match=r"diagnosis 'flor'.*floor"):
        prepare(arm, recordings, refuse=["flor"])


@pytest.mark.parametrize("second", ["slack", "gear"])
def test_the_friction_of_a_floor_is_calibrated_beside_gaps_and_springs_of_gears(tmp_path: Path, second: str) -> None:
    """Adding joints has a spec forget which of its shapes is the floor."""
    path, parameters = tmp_path / "arm.xml", tmp_path / "p.toml"
    path.write_text(ARM.format(kp=20, damping=0.4, table=TABLE.format(z=-0.05)), encoding="utf-8")
    parameters.write_text(
        '[[parameter]]\nquantity = "floor_friction"\n[[parameter]]\nquantity = "kp"\n', encoding="utf-8"
    )
    simulator, _ = simulator_for(path, [record("r0", 0, table=-0.08)], parameters)
    assert isinstance(simulator, MujocoSimulator)
    whole = prepared(simulator.model, step=0.002, second={second: ["elbow"]}, sliding=True)
    assert rules(whole, plane_of(whole))


def test_a_model_that_has_a_floor_keeps_its_own(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(kp=20, damping=0.4, table=TABLE.format(z=-0.05)), encoding="utf-8")
    recordings = [record("r0", 0, table=-0.08)]
    assert reach_of(load(path)) is None
    parameters = tmp_path / "p.toml"
    parameters.write_text('[[parameter]]\nquantity = "floor_height"\n[[parameter]]\nquantity = "kp"\n'
                          '[[parameter]]\nquantity = "damping"\n', encoding="utf-8")  # fmt: skip
    simulator, _ = simulator_for(path, recordings, parameters)
    found = calibrate(simulator, recordings, options=Options(select=False, stages=DESCENT))
    assert found.values[0] == pytest.approx(-0.08, abs=3e-3)
    assert isinstance(simulator, MujocoSimulator)
    write_model(simulator, found.values, tmp_path / "found.xml")
    assert 'name="table"' in (tmp_path / "found.xml").read_text(encoding="utf-8")


_PUCK = """
<mujoco model="puck">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="9 9 0.1" friction="0.8" solref="0.01 1"/>
    <body name="puck" pos="0 0 0.02">
      <freejoint/>
      <geom name="foot" type="box" size="0.1 0.1 0.02" mass="1" friction="{friction} 0.02 0.01" condim="4" {priority}/>
    </body>
  </worldbody>
</mujoco>
"""


def _slowed(model: mujoco.MjModel) -> float:
    """Deceleration in units of gravity of what slides over the floor at 2 m/s."""
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 200)
    data.qvel[0] = 2.0
    mujoco.mj_step(model, data, 100)
    return float((2.0 - data.qvel[0]) / (100 * model.opt.timestep * 9.81))


@pytest.mark.parametrize(("friction", "priority"), [(0.8, ""), (1.2, ""), (0.6, 'priority="1"')])
@pytest.mark.parametrize("floor", [0.3, 0.7])
def test_the_friction_of_a_floor_counts_against_that_of_the_feet(
    tmp_path: Path, friction: float, priority: str, floor: float
) -> None:
    (tmp_path / "puck.xml").write_text(_PUCK.format(friction=friction, priority=priority), encoding="utf-8")
    model = load(tmp_path / "puck.xml")
    space, quantities = declare(model, [Declaration("floor_friction")])
    assert space.nominal == pytest.approx([_slowed(model.compiled)], rel=0.1)  # what rules as the model came
    simulator = MujocoSimulator(model, space, quantities, step=0.001)
    kept = simulated_model(simulator, space.nominal)
    assert _slowed(kept) == pytest.approx(_slowed(model.compiled), rel=1e-3)
    assert _slowed(simulated_model(simulator, [floor])) == pytest.approx(floor, rel=0.1)
    write_model(simulator, [floor], tmp_path / "found.xml")
    assert _slowed(mujoco.MjModel.from_xml_path(str(tmp_path / "found.xml"))) == pytest.approx(floor, rel=0.1)


def test_a_floor_without_a_name_is_written(tmp_path: Path) -> None:
    named = _PUCK.format(friction=0.8, priority="")
    nameless = named.replace(' name="floor"', "").replace(
        "<worldbody>", '<worldbody><geom type="sphere" size=".1" pos="2 0 1"/>'
    )
    assert nameless.count("name") == named.count("name") - 1
    (tmp_path / "puck.xml").write_text(nameless, encoding="utf-8")
    model = load(tmp_path / "puck.xml")
    simulator = MujocoSimulator(model, *declare(model, [Declaration("floor_friction")]), step=0.001)
    for friction in (
        0.3,
        *simulator.parameters.nominal,
    ):  # one that was kept is still to count against that of the feet
        write_model(simulator, [friction], tmp_path / "found.xml")
        assert _slowed(mujoco.MjModel.from_xml_path(str(tmp_path / "found.xml"))) == pytest.approx(friction, rel=0.1)
