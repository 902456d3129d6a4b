# SPDX-License-Identifier: Apache-2.0
"""Batches leave out what a simulation does not need, and nothing that it does."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.trial import Observed, Trial

ARM = """<mujoco>
  <asset><texture name="wood" type="2d" builtin="checker" width="200" height="200"/><material name="m" texture="wood"/>
    <mesh name="link" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .4  .1 .1 .3"/></asset>
  <worldbody>{floor}
    <body name="a" pos="0 0 1"><joint name="j" type="hinge" axis="0 1 0" damping="0.1"/>
      <geom name="seen" type="mesh" mesh="link" contype="0" conaffinity="0" material="m"/>
      <geom name="hard" type="mesh" mesh="link"/><site name="tip" pos="0 0 -.2" zaxis="0 0 -1"/></body>
  </worldbody>
  <actuator><position joint="j" kp="20"/></actuator>
  <sensor><jointpos name="angle" joint="j"/>{sensor}</sensor>
</mujoco>"""


def simulator(tmp_path: Path, floor: str = "", sensor: str = "") -> MujocoSimulator:
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(floor=floor, sensor=sensor))
    return MujocoSimulator(load(path))


def test_copies_of_a_model_in_which_nothing_touches_carry_no_shapes_but_the_same_masses(tmp_path: Path) -> None:
    sim = simulator(tmp_path)
    whole = sim.batches.get(2, contacts=True, sensors=True).model
    bare = sim.batches.get(2, contacts=False, sensors=True).model
    assert (whole.ngeom, whole.nmesh, whole.ntex) == (1, 1, 0)
    assert (bare.ngeom, bare.nmesh, bare.ntex) == (0, 0, 0)
    for field in ("body_mass", "body_inertia", "body_ipos", "body_iquat"):
        assert np.array_equal(getattr(bare, field), getattr(load(tmp_path / "arm.xml").compiled, field))


def test_masses_that_the_compiler_takes_from_visual_shapes_are_kept_too(tmp_path: Path) -> None:
    simulator(tmp_path)
    path = tmp_path / "arm.xml"
    path.write_text(path.read_text().replace("<mujoco>", "<mujoco><compiler inertiafromgeom='true'/>"))
    sim = MujocoSimulator(load(path))
    assert sim.batches.get(2, contacts=False, sensors=True).model.body_mass[1] == load(path).compiled.body_mass[1]


def test_a_simulation_without_shapes_is_the_same_as_one_with_them(tmp_path: Path) -> None:
    sim = simulator(tmp_path)
    ends = []
    for contacts in (True, False):
        batch = sim.batches.get(1, contacts=contacts, sensors=True)
        batch.reset()
        batch.rollout(300, np.full((1, 300, 1), 0.4), control_spec=int(mujoco.mjtState.mjSTATE_CTRL))
        ends.append(np.array(batch.bind("qpos")))
    assert abs(ends[0][0, 0]) > 0.05
    assert np.array_equal(ends[0], ends[1])


@pytest.mark.parametrize("contacts", [True, False])
def test_a_sensor_that_sees_shapes_still_sees_them(tmp_path: Path, contacts: bool) -> None:
    sim = simulator(tmp_path, floor='<geom type="plane" size="2 2 .1"/>', sensor='<rangefinder name="r" site="tip"/>')
    batch = sim.batches.get(1, contacts=contacts, sensors=True)
    batch.reset()
    seen = batch.bind("sensordata")
    batch.rollout(1, np.zeros((1, 1, 1)), control_spec=int(mujoco.mjtState.mjSTATE_CTRL))
    assert seen[0, 1] == pytest.approx(0.8, abs=0.02)


def test_a_coarser_step_has_batches_of_its_own(tmp_path: Path) -> None:
    sim = simulator(tmp_path)
    coarse = sim.at_step(0.005)
    trial = Trial("t", 0.0, 0.5, None, {"position": Observed(("j",), "rad", np.linspace(0.0, 0.5, 11))})
    assert coarse.compiled.opt.timestep == 0.005
    assert sim.compiled.opt.timestep == 0.002
    assert coarse.rollout([trial], np.zeros((1, 0)))[0].channels["position"].shape == (1, 11, 1)
