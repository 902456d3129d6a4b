# SPDX-License-Identifier: Apache-2.0
"""The calibrated MJCF: the same file with other values, which any MuJoCo replays like the simulator did."""

from __future__ import annotations

import errno
import os
import re
import struct
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.writing.write import simulated_model, write_model
from trueup.errors import ModelError, OutputError
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]

ARM = """<?xml version="1.0"?>
<!-- a note of the maker -->
<mujoco model="arm">
  <compiler angle="{angle}" meshdir="parts"/>
  <default>
    <default class="servo">
      <joint damping="0.6" frictionloss="0.05" armature="0.02"/>   <!-- from the data sheet -->
      <position kp="20" kv="0.5" forcerange="-3 3"/>
    </default>
  </default>
  <asset><mesh name="link" file="link.stl"/></asset>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint class="servo" name='shoulder'   axis="0 1 0"/><!-- odd spacing stays -->
      <inertial pos="0.1 0 0" mass="0.4" diaginertia="0.001 0.002 0.002"/>
      <geom type="mesh" mesh="link" contype="0" conaffinity="0" mass="0"/>
      <body name="lower" pos="0.2 0 0">
        <joint class="servo" name="elbow" axis="0 1 0"/>
        <geom name="tip" type="capsule" size="0.01" fromto="0 0 0 0.2 0 0" mass="0.2"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position class="servo" name="shoulder" joint="shoulder"/>
    <position class="servo" name="elbow" joint="elbow" kp="15"/>
  </actuator>
</mujoco>
"""
ALL = (
    Declaration("kp"), Declaration("kv"), Declaration("zero"), Declaration("force_limit"),
    Declaration("delay", tie="all"),
    Declaration("damping"), Declaration("damping_quadratic", ("elbow",)), Declaration("friction"),
    Declaration("friction_creep", tie="all"), Declaration("armature"), Declaration("backlash", ("elbow",)),
    Declaration("gear_backlash", ("shoulder",)), Declaration("gear_compliance", ("shoulder",)),
    Declaration("mass", ("upper",)), Declaration("com_x", ("lower",)), Declaration("inertia_d1", ("lower",)),
    Declaration("spread_x", ("upper",)), Declaration("spread_z", ("upper",)),
    Declaration("tilt_roll"), Declaration("contact_friction", ("tip",)), Declaration("contact_softness", ("tip",)),
)  # fmt: skip


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    return make_arm(tmp_path / "robot", "radian")


def make_arm(folder: Path, angle: str) -> Path:
    (folder / "parts").mkdir(parents=True)
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], dtype="<f4")
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    body = b"".join(struct.pack("<3f", 0, 0, 0) + corners[list(f)].tobytes() + b"\0\0" for f in faces)
    (folder / "parts" / "link.stl").write_bytes(bytes(80) + struct.pack("<I", len(faces)) + body)
    (folder / "arm.xml").write_text(ARM.format(angle=angle))
    return folder / "arm.xml"


def simulator(path: Path, lines: Sequence[Declaration]) -> tuple[MujocoSimulator, Array]:
    """A simulator with all values moved a third of the way through their bounds."""
    model = load(path)
    space, quantities = declare(model, lines)
    values = space.from_unit(0.7 * space.to_unit(space.nominal) + 0.3 * np.full(int(space.free.sum()), 0.7))
    return MujocoSimulator(model, space, quantities), values


def test_a_thin_body_that_rounding_makes_impossible_is_written_all_the_same(tmp_path: Path) -> None:
    """The moments of a plate to six digits: 0.00853439 + 0.0019849 is less than 0.0105193."""
    inertia = '<inertia ixx="0.0105192900" iyy="0.0085343901" izz="0.0019849002" ixy="0" ixz="0" iyz="0"/>'
    (tmp_path / "plate.urdf").write_text(
        '<robot name="plate"><link name="base"/><link name="plate"><inertial><origin xyz="0 0 .1"/><mass value="2"/>'
        f'{inertia}</inertial></link><joint name="j" type="continuous"><parent link="base"/><child link="plate"/>'
        '<axis xyz="0 1 0"/></joint></robot>'
    )
    model = load(tmp_path / "plate.urdf")
    simulator = MujocoSimulator(model, *declare(model, [Declaration("damping", nominal=0.3)]))
    write_model(simulator, [0.3], tmp_path / "fit.xml")
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "fit.xml"))
    assert sorted(written.body("plate").inertia) == pytest.approx([0.0019849, 0.00853439, 0.01051929], rel=1e-5)


def test_a_value_that_urdf_does_not_hold_to_six_digits_is_written_as_it_is(tmp_path: Path) -> None:
    """What stays at its start value, too: MuJoCo prints six digits, 2e-6 off here, and the file was refused for that."""
    (tmp_path / "disc.urdf").write_text(
        '<robot name="disc"><link name="base"/><link name="disc"><inertial><mass value="1"/><inertia ixx=".01" iyy=".01" '
        'izz=".02" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="continuous"><parent link="base"/>'
        '<child link="disc"/><axis xyz="0 0 1"/></joint></robot>'
    )
    model = load(tmp_path / "disc.urdf")
    spec = model.spec.copy()
    spec.joint("j").armature = 0.0001516645158
    model = model.changed(spec, "with a rotor", "")
    simulator = MujocoSimulator(model, *declare(model, [Declaration("armature", frozen=True)]))
    write_model(simulator, simulator.parameters.nominal, tmp_path / "fit.xml")
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "fit.xml"))
    assert written.dof_armature[0] == pytest.approx(0.0001516645158, rel=1e-8)


def test_only_the_calibrated_attributes_change(arm: Path, tmp_path: Path) -> None:
    sim, values = simulator(arm, [Declaration("kp"), Declaration("friction", ("elbow",))])
    out = tmp_path / "fit" / "arm.xml"
    write_model(sim, values, out)
    plain = out.read_text()
    assert "<!-- a note of the maker -->" in plain
    assert "name='shoulder'   axis=\"0 1 0\"/><!-- odd spacing stays -->" in plain
    for found in (r' kp="[^"]*"(?=/>)', r' frictionloss="[^"]*"(?=/>)', r'\s*<option integrator="implicitfast"/>'):
        plain = re.sub(found, "", plain)
    plain = plain.replace('meshdir="../robot/parts"', 'meshdir="parts"')
    shipped = ARM.format(angle="radian")
    for found in (r' kp="15"(?=/>)',):
        shipped = re.sub(found, "", shipped)
    assert plain == shipped


def test_a_default_class_stays_as_it_was(arm: Path, tmp_path: Path) -> None:
    sim, values = simulator(arm, ALL)
    write_model(sim, values, tmp_path / "arm.xml")
    block = re.compile(r"<default>.*</default>", re.DOTALL)
    found, shipped = block.search((tmp_path / "arm.xml").read_text()), block.search(arm.read_text())
    assert found is not None
    assert shipped is not None
    assert found.group() == shipped.group()


@pytest.mark.parametrize("angle", ["radian", "degree"])
def test_every_kind_is_written_as_it_was_simulated(tmp_path: Path, angle: str) -> None:
    sim, values = simulator(make_arm(tmp_path / "robot", angle), ALL)
    out = tmp_path / "deep" / "er" / "arm.xml"
    notes = write_model(sim, values, out)
    assert not any("layout" in note for note in notes), notes
    written, wanted = mujoco.MjModel.from_xml_path(str(out)), simulated_model(sim, values)
    for field in ("dof_damping", "dof_dampingpoly", "dof_frictionloss", "dof_armature", "actuator_gainprm", "body_mass",
                  "actuator_biasprm", "actuator_forcerange", "body_ipos", "jnt_range", "jnt_solref",
                  "dof_solimp"):  # fmt: skip
        assert getattr(written, field) == pytest.approx(getattr(wanted, field), rel=1e-6, abs=1e-12), field
    assert written.njnt == 4
    assert written.opt.gravity == pytest.approx(wanted.opt.gravity)


def test_nothing_is_changed_where_values_are_those_of_the_model(arm: Path) -> None:
    model = load(arm)
    space, quantities = declare(model, [Declaration("kp"), Declaration("damping"), Declaration("mass", ("upper",))])
    write_model(MujocoSimulator(model, space, quantities), space.nominal, arm.with_name("same.xml"))
    text = arm.with_name("same.xml").read_text()
    assert re.sub(r'\s*<option integrator="implicitfast"/>', "", text) == ARM.format(angle="radian")


def test_the_written_model_replays_in_plain_mujoco(arm: Path, tmp_path: Path) -> None:
    lines = [
        Declaration("kp", nominal=25.0), Declaration("damping", nominal=0.3), Declaration("friction", nominal=0.08),
        Declaration("delay", tie="all", nominal=0.0173), Declaration("mass", ("upper",), nominal=0.5),
        Declaration("zero", nominal=0.03),
    ]  # fmt: skip
    model = load(arm)
    space, quantities = declare(model, lines)
    sim = MujocoSimulator(model, space, quantities)
    out = tmp_path / "fit.xml"
    write_model(sim, space.nominal, out)
    recording = _sweep()
    simulated = sim.rollout([Trial.of(recording)], space.nominal[None])[0].channels["position"][0]
    plain = _replayed(out, recording.channel("command").values)
    assert np.abs(simulated - plain).max() < 1e-3
    assert np.ptp(plain[:, 1]) > 0.5


def test_a_calibrated_file_is_replayed_with_its_delay_once_with_its_parameters_or_without(arm: Path) -> None:
    lines = [Declaration("delay", tie="all"), Declaration("zero")]
    space, quantities = declare(load(arm), lines)
    sim = MujocoSimulator(load(arm), space, quantities)
    values = np.array([[0.0173, 0.03, -0.02]])
    recording, out = _sweep(), arm.with_name("fit.xml")
    write_model(sim, values[0], out)
    again = MujocoSimulator(load(out), *declare(load(out), lines))
    assert again.parameters.nominal == pytest.approx(values[0])
    runs = [(sim, values), (again, values), (MujocoSimulator(load(out)), np.zeros((1, 0)))]
    wanted, *others = (s.rollout([Trial.of(recording)], v)[0].channels["position"] for s, v in runs)
    for other in others:
        assert np.abs(other - wanted).max() < 1e-9
    write_model(again, np.array([0.0, 0.03, -0.02]), arm.with_name("none.xml"))
    assert not load(arm.with_name("none.xml")).compiled.actuator_delay.any()


def _sweep() -> Recording:
    """A command at each step of the model."""
    time, joints = np.arange(0.0, 3.0, 0.002), ("shoulder", "elbow")
    command = np.stack([0.6 * np.sin(4 * time), 0.5 * np.sign(np.sin(2.5 * time)) * (time > 0.5)], axis=1)
    return Recording("sweep", {
        "command": Channel("command", joints, "rad", time, command),
        "position": Channel("position", joints, "rad", time, np.zeros_like(command)),
    }, {})  # fmt: skip


def _replayed(path: Path, command: Array) -> Array:
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for i in range(model.nu):
        samples = int(model.actuator_history[i, 0])
        mujoco.mj_initCtrlHistory(model, data, i, None, np.full((samples, 1), command[0, i]))
    found = []
    for row in command:
        found.append(data.qpos.copy())
        data.ctrl[:] = row
        mujoco.mj_step(model, data)
    return np.array(found)


def test_what_mjcf_cannot_say_is_said(arm: Path, tmp_path: Path) -> None:
    sim, values = simulator(arm, [Declaration("bias"), Declaration("dead_band", ("elbow",)), Declaration("kp")])
    notes = " ".join(write_model(sim, values, tmp_path / "arm.xml"))
    assert "dead band (elbow)" in notes
    assert "position sensor" in notes
    assert "parameters.toml" in notes


def test_elements_of_an_included_file_are_written_in_its_place_with_all_comments(arm: Path, tmp_path: Path) -> None:
    text = ARM.format(angle="radian")
    actuators = re.search(r"<actuator>.*</actuator>", text, re.DOTALL)
    assert actuators is not None
    (arm.parent / "servos.xml").write_text(
        f"<!-- by the maker of servos --><mujoco>{actuators.group()}<!-- end --></mujoco>"
    )
    arm.write_text(text.replace(actuators.group(), '<include file="servos.xml"/>'))
    sim, values = simulator(arm, [Declaration("kp"), Declaration("damping")])
    notes = write_model(sim, values, tmp_path / "fit" / "arm.xml")
    assert not any("comments and layout" in note for note in notes)
    text = (tmp_path / "fit" / "arm.xml").read_text()
    assert all(f"<!-- {c} -->" in text for c in ("a note of the maker", "by the maker of servos", "end"))
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "fit" / "arm.xml"))
    assert written.actuator_gainprm[:, 0] == pytest.approx(values[:2])


def test_a_full_disk_leaves_the_old_file(arm: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sim, values = simulator(arm, [Declaration("kp")])
    out = tmp_path / "arm.xml"
    out.write_text("old")

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="No space left"):
        write_model(sim, values, out)
    assert out.read_text() == "old"
    assert list(tmp_path.glob(".*")) == []


def test_a_wrong_number_of_values_is_refused(arm: Path, tmp_path: Path) -> None:
    sim, values = simulator(arm, [Declaration("kp")])
    with pytest.raises(ModelError, match="expected 2 values"):
        write_model(sim, values[:1], tmp_path / "arm.xml")
