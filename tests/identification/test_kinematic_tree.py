# SPDX-License-Identifier: Apache-2.0
"""What can be read, what is refused and why, and that equal robots in other notations are equal trees."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.errors import ModelError, UnknownNameError
from trueup.excitation.problem import Asked, excitation_problem
from trueup.identification.inertial import from_com, from_pseudo_inertia, moved, pseudo_inertia, tensor
from trueup.identification.kinematic_tree import from_dh
from trueup.identification.model_file import load_tree
from trueup.identification.poses import link_poses

_ARM = """<robot name="two">
  <link name="base"/><link name="upper">{inertial}</link><link name="tool">{inertial}</link><link name="lower"/>
  <joint name="shoulder" type="{kind}"><parent link="base"/><child link="upper"/><axis xyz="0 0 2"/>
    <limit lower="-1" upper="2" velocity="3" effort="0"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="1 0 0" rpy="0 0 0"/>
    <limit velocity="3" effort="40"/></joint>
  <joint name="mount" type="fixed"><parent link="lower"/><child link="tool"/><origin xyz="0 0 .5" rpy="0 0 1.5"/></joint>
</robot>"""
_INERTIAL = (
    "<inertial><origin xyz='0 0 .1'/><mass value='2'/>"
    "<inertia ixx='.1' iyy='.1' izz='.1' ixy='0' ixz='0' iyz='0'/></inertial>"
)


def arm(folder: Path, inertial: str = _INERTIAL, kind: str = "revolute") -> Path:
    file = folder / "two.urdf"
    file.write_text(_ARM.format(inertial=inertial, kind=kind))
    return file


def test_fixed_links_are_merged_and_limits_are_those_of_the_file(tmp_path: Path) -> None:
    tree = load_tree(arm(tmp_path))
    assert (tree.joints, tree.links) == (("shoulder", "elbow"), ("upper", "lower"))
    np.testing.assert_allclose(tree.axis, [[0, 0, 1], [1, 0, 0]])
    np.testing.assert_array_equal(tree.lower, [-1, np.nan])
    np.testing.assert_array_equal(tree.effort, [np.nan, 40])
    np.testing.assert_allclose(tree.weighed()[1, :4], [2, 0, 0, 2 * 0.6])  # the tool, 0.5 m up


def test_a_urdf_without_inertia_gives_motion_but_no_torque(tmp_path: Path) -> None:
    tree = load_tree(arm(tmp_path, inertial=""))
    assert link_poses(tree, np.zeros((1, 2)))[1][0, 1, 0] == pytest.approx(1.0)
    with pytest.raises(ModelError, match=r"no inertia for 2 of 2 links: upper, lower.*<inertial>"):
        tree.weighed()


def test_masses_of_zero_are_no_masses(tmp_path: Path) -> None:
    tree = load_tree(arm(tmp_path, inertial=_INERTIAL.replace("mass value='2'", "mass value='0'")))
    assert any("mass is 0 in the file: upper, lower" in note for note in tree.notes)
    with pytest.raises(ModelError, match="no inertia for 2 of 2 links"):
        tree.weighed()


def test_a_floating_base_is_refused_unless_it_is_welded(tmp_path: Path) -> None:
    file = arm(tmp_path, kind="floating")
    with pytest.raises(ModelError, match=r"joint 'shoulder' is 'floating'.*fix_base=True"):
        load_tree(file)
    assert load_tree(file, fix_base=True).joints == ("elbow",)
    free = tmp_path / "free.xml"
    free.write_text(
        '<mujoco><worldbody><body><freejoint name="root"/><geom size=".1"/><body><joint name="hip"/><geom size=".1"/>'
        "</body></body></worldbody></mujoco>"
    )
    with pytest.raises(ModelError, match=r"joint 'root' of 'free' is free.*fix_base=True"):
        load_tree(free)
    assert load_tree(free, fix_base=True).joints == ("hip",)


def test_a_ball_joint_and_a_missing_file_are_named(tmp_path: Path) -> None:
    file = tmp_path / "ball.xml"
    file.write_text(
        '<mujoco><worldbody><body><joint name="eye" type="ball"/><geom size=".1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(ModelError, match="joint 'eye' of 'ball' is ball"):
        load_tree(file, fix_base=True)
    with pytest.raises(ModelError, match=r"no\.urdf: no such file"):
        load_tree(tmp_path / "no.urdf")


def test_locking_an_unknown_joint_lists_the_joints(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"joint 'elbw' is not in .*did you mean 'elbow'"):
        load_tree(arm(tmp_path)).lock(["elbw"])


def test_standard_and_modified_tables_of_one_arm_put_the_wrist_in_one_place(rng: np.random.Generator) -> None:
    a, alpha, d = (0.3, 0.7, 0.185), (np.pi / 2, 0.0, -np.pi / 2), (0.6, 0.05, 0.1)
    standard = from_dh([*a, 0.0], [*alpha, 0.0], [*d, 0.0])
    modified = from_dh([0.0, *a], [0.0, *alpha], [*d, 0.0], convention="modified")
    q = rng.uniform(-3, 3, (5, 4))
    # A standard link frame i has its origin at O_{i-1}; the last one of the modified table is the same point.
    np.testing.assert_allclose(link_poses(standard, q)[1][:, 3], link_poses(modified, q)[1][:, 3], atol=1e-12)


def test_a_body_moved_to_another_frame_is_the_same_body(rng: np.random.Generator) -> None:
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    R, p = Q * np.sign(np.linalg.det(Q)), rng.normal(size=3)
    com, inertia = rng.normal(size=3), np.diag([0.3, 0.4, 0.5])
    body = from_com(2.0, com, inertia)
    expected = from_com(2.0, R @ com + p, R @ inertia @ R.T)
    np.testing.assert_allclose(moved(body, R, p), expected, atol=1e-12)
    np.testing.assert_allclose(from_pseudo_inertia(pseudo_inertia(body)), body, atol=1e-12)
    assert np.linalg.eigvalsh(pseudo_inertia(body)).min() > 0.0
    np.testing.assert_allclose(np.trace(tensor(body)), 2 * np.trace(pseudo_inertia(body)[:3, :3]), atol=1e-12)


def test_a_loop_that_an_mjcf_closes_is_told_of_and_no_motion_is_designed_for_it(tmp_path: Path) -> None:
    """Joints of a five-bar arm were moved one by one, as no such arm can."""
    bar = '<body name="{0}" pos="{1} 0 0"><joint name="{0}" axis="0 1 0" range="-1 1"/><geom size=".02" pos="0 0 .1"/>'
    bar += "{2}</body>"
    left, right = (bar.format(x, at, bar.format(f"{x}2", 0.1, "")) for x, at in (("left", 0), ("right", 0.3)))
    tie = '<equality><connect body1="left2" body2="right2" anchor=".1 0 .1"/></equality>'
    for name, tied in (("open", ""), ("closed", tie)):
        options = '<compiler angle="radian"/>'
        (tmp_path / f"{name}.xml").write_text(f"<mujoco>{options}<worldbody>{left}{right}</worldbody>{tied}</mujoco>")
    assert load_tree(tmp_path / "open.xml").loops == ()
    tree = load_tree(tmp_path / "closed.xml")
    assert tree.loops == (("left", "left2", "right", "right2"),)
    assert any("a loop is closed over left" in note for note in tree.notes)
    excitation_problem(tmp_path / "open.xml", Asked())
    with pytest.raises(ModelError, match=r"closes a loop over left.*cannot move freely.*--lock"):
        excitation_problem(tmp_path / "closed.xml", Asked())


def test_torque_limits_of_an_mjcf_are_those_of_its_joints_or_drives(tmp_path: Path) -> None:
    drives = {
        "none": "",
        "force": '<position joint="force" kp="100" forcerange="-40 40"/>',
        "control": '<motor joint="control" ctrlrange="-87 87"/>',
        "geared": '<motor joint="geared" gear="-50" ctrlrange="-1 1"/>',
        "share": '<motor joint="share" ctrlrange="-1 1"/>',
        "two": '<motor joint="two" ctrlrange="-5 6"/><motor joint="two" gear="2" forcerange="-3 3"/>',
        "joint": '<motor joint="joint" ctrlrange="-87 87"/>',
    }
    limited = 'actuatorfrcrange="-12 12"'
    bodies = "".join(
        f'<body><joint name="{name}" axis="0 1 0" {limited if name == "joint" else ""}/>'
        f'<geom size=".1" mass="1" contype="0"/>'
        for name in drives
    )
    path = tmp_path / "arm.xml"
    world = f"<worldbody>{bodies}{'</body>' * len(drives)}</worldbody>"
    path.write_text(f"<mujoco>{world}<actuator>{''.join(drives.values())}</actuator></mujoco>")
    effort = load_tree(path).effort
    assert np.allclose(effort, [np.nan, 40.0, 87.0, 50.0, np.nan, 11.0, 12.0], equal_nan=True)
