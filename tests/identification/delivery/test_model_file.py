# SPDX-License-Identifier: Apache-2.0
"""What was identified comes back from the URDF or MJCF it was written to, and the rest of the file is as it was."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from trueup.cli import main
from trueup.formats import write
from trueup.identification.delivery.model_file import write_model_file
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.result import Identification
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.model_file import load_tree
from trueup.recording import Channel, Recording

URDF = """<?xml version="1.0"?>
<robot name="arm">
  <!-- the base: nobody touches this comment -->
  <link name="base"/>
  <joint name="joint1" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="3" effort="200"/></joint>
  <link name="upper">
    <visual><geometry><mesh filename="package://arm/upper.stl"/></geometry></visual>
    <inertial><origin xyz="0.1 0 0" rpy="0 0 0.3"/><mass value="9"/>
      <inertia ixx="0.2" ixy="0" ixz="0" iyy="0.3" iyz="0" izz="0.3"/></inertial>
  </link>
  <joint name="joint2" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.2 0 0" rpy="1.5707963 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="3" effort="150"/><dynamics damping="0.0" friction="0.0"/></joint>
  <link name="lower">
    <inertial><origin xyz="0.2 0 0"/><mass value="6"/>
      <inertia ixx="0.05" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/></inertial>
  </link>
  <joint name="joint3" type="revolute"><parent link="lower"/><child link="hand"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="3" effort="60"/></joint>
  <link name="hand">
    <inertial><origin xyz="0.05 0 0.1"/><mass value="3"/>
      <inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.02"/></inertial>
  </link>
  <joint name="flange" type="fixed"><parent link="hand"/><child link="tool"/><origin xyz="0 0 0.1"/></joint>
  <link name="tool"><inertial><mass value="0.4"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
</robot>
"""

MJCF = """<mujoco model="arm">
  <!-- the base: nobody touches this comment -->
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper" pos="0 0 0.3">
      <joint name="joint1" axis="0 0 1" range="-3 3" actuatorfrcrange="-200 200"/>
      <inertial pos="0.1 0 0" mass="9" diaginertia="0.2 0.3 0.3"/>
      <body name="lower" pos="0.2 0 0" euler="1.5707963 0 0">
        <joint name="joint2" axis="0 0 1" pos="0.01 0 0" range="-3 3" actuatorfrcrange="-150 150"/>
        <inertial pos="0.2 0 0" mass="6" diaginertia="0.05 0.2 0.2"/>
        <body name="hand" pos="0.4 0 0">
          <joint name="joint3" axis="0 1 0" range="-3 3" actuatorfrcrange="-60 60"/>
          <inertial pos="0.05 0 0.1" mass="3" diaginertia="0.03 0.03 0.02"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(params=["urdf", "xml"])
def model(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A three-joint arm as URDF and as MJCF."""
    path = tmp_path / f"arm.{request.param}"
    path.write_text(URDF if request.param == "urdf" else MJCF)
    return path


def _truth(tree: KinematicTree) -> KinematicTree:
    """The arm with bodies half as heavy again in places, as nobody told the file."""
    return tree.replace(inertial=np.asarray(tree.inertial) * np.array([[1.2], [0.8], [1.4]]))


@pytest.fixture
def found(model: Path, arms: SimpleNamespace) -> tuple[KinematicTree, Identification]:
    """The arm identified from a log of the heavier one."""
    tree = load_tree(model)
    run = _log(tree, arms)
    return tree, identify(tree, [run], options=Options(hold_out=0.3))


def _log(tree: KinematicTree, arms: SimpleNamespace) -> Recording:
    real = _truth(tree)
    rng, time = np.random.default_rng(0), np.arange(3000) / 200.0
    q, v, a = arms.sines(rng, time, 3)
    from trueup.identification.regressors import inverse_dynamics

    loads = inverse_dynamics(real, np.asarray(real.inertial), q, v, a) + 3.0 * np.tanh(v / 0.02) + 1.5 * v
    loads += 0.1 * rng.normal(size=q.shape)
    channels = {"position": Channel("position", tree.joints, "rad", time, q),
                "torque": Channel("torque", tree.joints, "N m", time, loads)}  # fmt: skip
    return Recording("run", channels)


def test_the_written_file_holds_what_was_identified(
    found: tuple[KinematicTree, Identification], model: Path, tmp_path: Path
) -> None:
    tree, result = found
    target = tmp_path / "out" / model.name
    write_model_file(result.for_file, tree, model, target)
    again = load_tree(target)
    assert result.for_file is not None
    assert np.allclose(again.inertial, result.for_file.inertial, rtol=1e-5, atol=1e-6)
    assert np.allclose(result.for_file.inertial[:, 0], np.asarray(_truth(tree).inertial)[:, 0], rtol=0.6)


def test_what_hangs_on_a_link_gets_lighter_where_less_was_identified_than_its_file_says(
    found: tuple[KinematicTree, Identification], model: Path, tmp_path: Path
) -> None:
    _, result = found
    assert result.for_file is not None
    heavy, tool = tmp_path / f"heavy{model.suffix}", '<inertial pos="0 0 0" mass="30" diaginertia="1 1 1"/>'
    text = model.read_text().replace('mass value="0.4"', 'mass value="30"')
    text = text.replace('0.03 0.02"/>', f'0.03 0.02"/><body name="tool" pos="0 0 0.1">{tool}</body>')
    heavy.write_text(text)
    target = tmp_path / "out" / heavy.name
    notes = write_model_file(result.for_file, load_tree(heavy), heavy, target)
    assert np.allclose(load_tree(target).inertial, result.for_file.inertial, rtol=1e-5, atol=1e-6)
    assert any("hangs on it (tool)" in note for note in notes)


def test_nothing_but_numbers_changes_in_the_text(
    found: tuple[KinematicTree, Identification], model: Path, tmp_path: Path
) -> None:
    tree, result = found
    target = tmp_path / "out" / model.name
    write_model_file(result.for_file, tree, model, target)
    text = target.read_text()
    assert "<!-- the base: nobody touches this comment -->" in text
    assert ("package://arm/upper.stl" in text) == (model.suffix == ".urdf")
    assert re.sub(r'"[^"]*"', "", text).count("<link") == re.sub(r'"[^"]*"', "", model.read_text()).count("<link")


def test_friction_is_written_where_the_format_has_a_place(
    found: tuple[KinematicTree, Identification], model: Path, tmp_path: Path
) -> None:
    tree, result = found
    target = tmp_path / "out" / model.name
    write_model_file(result.for_file, tree, model, target)
    friction = [float(x) for x in re.findall(r'friction(?:loss)?="([\d.]+)"', target.read_text())]
    assert np.allclose(friction, 3.0, atol=0.4)
    assert np.allclose([float(x) for x in re.findall(r'damping="([\d.]+)"', target.read_text())], 1.5, atol=0.4)
    assert result.for_file is not None
    assert np.allclose(load_tree(target).armature, result.for_file.armature, rtol=1e-6, atol=1e-12)


def test_the_command_writes_model_report_and_numbers_and_never_over_them(
    model: Path, arms: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.parquet"
    write(_log(load_tree(model), arms), log)  # type: ignore[arg-type]
    call = ["identify", str(model), str(log), "--hold-out", "30%", "--out", str(tmp_path / "fit"), "--json", "-q"]
    assert main(call) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["held_out"]["fitted"]["relative_error"] < 0.05
    assert {"report.html", "identification.json", model.name} <= {f.name for f in (tmp_path / "fit").iterdir()}
    page = (tmp_path / "fit" / "report.html").read_text()
    for question in ("How well does it predict torque?", "Which file is for what", "Can these bodies exist?"):
        assert question in page
    before = (tmp_path / "fit" / "report.html").read_bytes()
    assert main(call) == 0
    assert (tmp_path / "fit-2" / "report.html").is_file()
    assert (tmp_path / "fit" / "report.html").read_bytes() == before


def test_a_mistake_is_one_line_and_exit_code_one(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", str(model), str(tmp_path / "no.csv"), "--out", str(tmp_path / "fit")]) == 1
    assert "no such file" in capsys.readouterr().err


def test_a_torsion_spring_is_written_where_the_file_has_a_place_for_it_and_said_where_not(
    model: Path, arms: SimpleNamespace, tmp_path: Path
) -> None:
    tree, target = load_tree(model), tmp_path / "out" / model.name
    run = _log(tree, arms)
    q, torque = run.channel("position").values, run.channel("torque")
    loads = torque.values + 20.0 * (q - 0.3) * (np.arange(3) == 1)
    run = run.replace(channels={**run.channels, "torque": torque.replace(values=loads)})
    drives = Drives.from_dict({"joints": {"joint2": {"spring": "torsion"}}}, tree.joints)
    fit = identify(tree, [run], drives=drives, options=Options(hold_out=0.3)).for_file
    notes = write_model_file(fit, tree, model, target)
    again, lacking = load_tree(target), [note for note in notes if "no place for the spring of joint2" in note]
    held = model.suffix == ".xml"
    assert np.allclose(again.stiffness, [0.0, 20.0 * held, 0.0], rtol=0.02)
    assert np.allclose(again.slack, [0.0, 0.3 * held, 0.0], atol=0.02)
    assert bool(lacking) != held
