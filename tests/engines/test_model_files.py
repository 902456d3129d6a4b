# SPDX-License-Identifier: Apache-2.0
"""Model files as teams have them: parts without names, missing pictures, impossible inertias, foreign prefixes."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.articulated.declarations import Declaration, declare
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.mujoco.setup.proposal import propose
from trueup.engines.mujoco.writing.write import write_model
from trueup.errors import ModelError
from trueup.identification.urdf import tree_from_urdf
from trueup.model_files.urdf import root_tag

NAMELESS = """<mujoco>
  <worldbody>
    <body name="upper">
      <body name="fore" pos="0 0 0.3">
        <joint axis="0 1 0"/> <!-- below -->
        <geom size="0.05" mass="0.4" pos="0.1 0 0"/>
      </body>
      <joint name="shoulder" axis="0 1 0"/>
      <geom size="0.05" mass="1"/>
    </body>
  </worldbody>
  <actuator>
    <position joint="shoulder" kp="20"/> <!-- no name -->
    <motor joint="shoulder" gear="2"/>
  </actuator>
</mujoco>
"""
LINK = """<link name="{name}"><inertial><mass value="0.5"/>{inertia}</inertial></link>"""
URDF = """<robot name="r"><link name="base"/>{links}
<joint name="a" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 1 0"/>
  <limit drake:acceleration="2" lower="-1" upper="1" effort="3" velocity="2"/></joint>
<joint name="b" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="3" velocity="2"/></joint>
</robot>"""


def written(folder: Path, text: str, name: str = "robot.xml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_what_has_no_name_is_proposed_calibrated_and_written(tmp_path: Path) -> None:
    path = written(tmp_path, NAMELESS)
    model = load(path)
    assert model.scalar_joints() == ("shoulder", "fore_joint")
    assert model.names("actuator") == ("shoulder", "shoulder_2")
    assert any("fore_joint" in note for note in model.notes)
    space, _ = declare(model, propose(model, []))
    assert "shoulder.kp" in space.names
    space, quantities = declare(model, [Declaration("kp", ("shoulder",)), Declaration("damping", ("fore_joint",))])
    notes = write_model(MujocoSimulator(model, space, quantities), [33.0, 0.25], tmp_path / "fit.xml")
    text = (tmp_path / "fit.xml").read_text()
    for comment in ("<!-- no name -->", "<!-- below -->"):
        assert comment in text, notes
    fitted = mujoco.MjModel.from_xml_path(str(tmp_path / "fit.xml"))
    assert fitted.actuator("shoulder").gainprm[0] == 33.0
    assert fitted.dof_damping[fitted.joint("fore_joint").dofadr[0]] == 0.25


def test_a_prefix_that_nobody_declared_does_not_matter(tmp_path: Path) -> None:
    inertia = '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>'
    links = LINK.format(name="one", inertia=inertia) + LINK.format(name="two", inertia=inertia)
    path = written(tmp_path, URDF.format(links=links), "robot.urdf")
    assert load(path).scalar_joints() == ("a", "b")
    assert tree_from_urdf(path).joints == ("a", "b")


@pytest.mark.parametrize(
    ("inertia", "said"),
    [
        ('<inertia ixx="-1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>', "no body can have"),
        ('<inertia ixx="1e-3" iyy="1e-3" izz="9e-3" ixy="0" ixz="0" iyz="0"/>', "no body can have"),
        ('<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>', "balls as dense as links are"),
        ("", "balls as dense as links are"),
    ],
)
def test_inertias_that_cannot_be_are_mended_and_said(tmp_path: Path, inertia: str, said: str) -> None:
    sound = '<inertia ixx="2e-3" iyy="1e-3" izz="1.5e-3" ixy="1e-4" ixz="0" iyz="0"/>'
    links = LINK.format(name="one", inertia=inertia) + LINK.format(name="two", inertia=sound)
    model = load(written(tmp_path, URDF.format(links=links), "robot.urdf"))
    assert sum(said in note and "one" in note for note in model.notes) == 1
    a, b, c = np.sort(model.compiled.body("one").inertia)
    assert a > 0.0
    assert c <= a + b
    tensor = np.sort(np.linalg.eigvalsh([[2e-3, 1e-4, 0], [1e-4, 1e-3, 0], [0, 0, 1.5e-3]]))
    assert np.allclose(np.sort(model.compiled.body("two").inertia), tensor), "what was sound stays"


def test_missing_pictures_and_meshes_cost_pictures_and_contacts_only(tmp_path: Path) -> None:
    pictures = '<texture name="t" type="2d" file="t.png"/><material name="m" texture="t"/>'
    assets = f'<asset>{pictures}<mesh name="k" file="k.stl"/></asset>'
    text = NAMELESS.replace("<worldbody>", assets + "<worldbody>").replace(
        '<geom size="0.05" mass="1"/>',
        '<geom size="0.05" mass="1" material="m"/><geom type="mesh" mesh="k" contype="0" conaffinity="0"/>',
    )
    model = load(written(tmp_path, text))
    assert [n for n in model.notes if "1 meshes could not be found" in n and "upper" in n]
    assert model.compiled.body("upper").mass[0] == 1.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            '<robot name="a" xmlns:xacro="x"><xacro:arm/></robot>',
            r"is xacro \(<xacro:arm>\), from which.*`xacro robot\.xml > robot\.urdf`",
        ),
        ('<sdf version="1.6"><model name="a"/></sdf>', "SDF is not read: give the URDF"),
        ("#usda 1.0", "USD is not read"),
    ],
)
def test_what_a_model_is_yet_to_be_made_of_is_said(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=said):
        load(written(tmp_path, text))


def test_a_urdf_that_xacro_made_says_so_in_a_comment_only(tmp_path: Path) -> None:
    text = '<robot name="a" xmlns:xacro="x"><!-- <xacro:arm/> --><link name="base"/></robot>'
    assert root_tag(written(tmp_path, text)) == "robot"


def test_a_part_of_a_model_is_told_from_a_model(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="a part that a whole model includes"):
        load(written(tmp_path, "<mujocoinclude><body/></mujocoinclude>"))
    with pytest.raises(ModelError, match="nowhere"):
        load(written(tmp_path, '<mujoco><include file="nowhere.xml"/></mujoco>'))


@pytest.mark.parametrize("place", ["0 0 -inf", "nan 0 0"])
def test_a_body_that_is_nowhere_is_named(tmp_path: Path, place: str) -> None:
    with pytest.raises(ModelError, match=r"body 'fore' is at|does not compile"):
        load(written(tmp_path, NAMELESS.replace("0 0 0.3", place)))


def test_a_joint_that_mimics_one_that_is_not_there_is_named(tmp_path: Path) -> None:
    inertia = '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>'
    link = f'<link name="{{0}}"><inertial><mass value=".1"/>{inertia}</inertial></link>'
    limit = '<limit lower="0" upper=".04" effort="9" velocity="1"/>'
    joint = f'<joint name="{{0}}" type="prismatic"><parent link="palm"/><child link="{{1}}"/>{limit}{{2}}</joint>'
    mimic = '<mimic joint="{0}"/>'
    for leader, told in (("left", 0), ("lefft", 1)):
        parts = [link.format(n) for n in ("palm", "l", "r")]
        parts += [joint.format("left", "l", ""), joint.format("right", "r", mimic.format(leader))]
        (tmp_path / "hand.urdf").write_text(f'<robot name="hand">{"".join(parts)}</robot>')
        notes = [n for n in load(tmp_path / "hand.urdf").notes if "mimics 'lefft', which is no joint" in n]
        assert len(notes) == told
