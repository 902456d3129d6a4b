# SPDX-License-Identifier: Apache-2.0
"""Distances between the parts of an arm are right, nothing is skipped silently, and the search's shapes agree with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trueup.engines.mujoco.clearance import MujocoClearance
from trueup.engines.mujoco.model import load
from trueup.errors import UnknownNameError
from trueup.excitation.feasibility import Feasibility, spread
from trueup.excitation.limits import JointLimits
from trueup.excitation.proximity import Proxies, Proximity
from trueup.excitation.trajectories import Motions, Trajectory
from trueup.identification.model_file import load_tree

ARM = """
<mujoco><compiler angle="radian"/><worldbody>
  <geom name="floor" type="plane" size="5 5 1"/>
  <geom name="post" type="box" size="0.05 0.05 0.4" pos="0.6 0 0.4"/>
  <body name="upper" pos="0 0 0.5">
    <joint name="turn" axis="0 0 1" range="-3 3"/>
    <geom type="capsule" size="0.05" fromto="0 0 0 0 0 0.3"/>
    <body name="middle" pos="0 0 0.3">
      <joint name="lift" axis="0 1 0" range="-2.5 2.5"/>
      <geom type="capsule" size="0.04" fromto="0 0 0 0.4 0 0"/>
      <body name="lower" pos="0.4 0 0">
        <joint name="bend" axis="0 1 0" range="-3 3"/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0.35 0 0"/>
      </body></body></body>
</worldbody></mujoco>
"""
JOINTS = ("turn", "lift", "bend")


def narrow(reach: float, speed: float, acceleration: float) -> JointLimits:
    """The same for all joints, torque unknown."""
    each = (np.full(3, value) for value in (-reach, reach, speed, acceleration, np.nan))
    lower, upper, fast, hard, torque = each
    return JointLimits(JOINTS, lower, upper, fast, hard, torque)


@pytest.fixture
def clearance(tmp_path: Path) -> MujocoClearance:
    (tmp_path / "arm.xml").write_text(ARM)
    return MujocoClearance.of(load(tmp_path / "arm.xml"), JOINTS)


def test_distances_are_those_of_geometry(clearance: MujocoClearance) -> None:
    distance, between = clearance.distances(np.array([[1.5, 0.0, 0.0], [1.5, 2.0, 0.0], [0.0, 0.0, 0.0]]))
    # stretched level at 0.8 m, away from the post: the floor and the post's top are far; lowered by 2 rad the tip is low
    tip = 0.8 - 0.75 * np.sin(2.0) - 0.03
    assert abs(distance[1] - tip) < 1e-3
    assert between[1] == "floor and lower"
    assert distance[2] < 0.0
    assert between[2] in ("lower and post", "middle and post")


def test_neighbours_are_not_checked_but_links_that_can_meet_are(clearance: MujocoClearance) -> None:
    named = {tuple(sorted((clearance.parts[a], clearance.parts[b]))) for a, b in clearance.pairs.tolist()}
    assert ("middle", "upper") not in named
    assert ("lower", "middle") not in named
    assert ("lower", "upper") in named


def test_a_joint_that_is_not_in_the_model_is_named(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    with pytest.raises(UnknownNameError, match=r"joint 'bnd' is not in .*did you mean 'bend'"):
        MujocoClearance.of(load(tmp_path / "arm.xml"), ("bnd",))


def test_nothing_is_missed_by_skipping_postures_that_cannot_be_nearer(clearance: MujocoClearance) -> None:
    limits = narrow(3.0, 2.0, 5.0)
    held = Feasibility(limits, clearance, 0.02)
    rng = np.random.default_rng(0)
    for _ in range(5):
        time = np.linspace(0.0, 1.0, 80)
        q = np.cumsum(rng.normal(size=(80, 3)) * 0.05, axis=0) + rng.uniform(-1, 1, 3)
        path = spread(Trajectory("walk", JOINTS, time, q, np.zeros_like(q), np.zeros_like(q)))[1]
        brute = clearance.distances(path)[0].min()
        assert abs(held.nearest(path)[0] - brute) < 1e-9


def test_the_shapes_of_the_search_agree_with_the_real_ones(clearance: MujocoClearance, tmp_path: Path) -> None:
    tree = load_tree(tmp_path / "arm.xml")
    q = np.random.default_rng(1).uniform(-2.5, 2.5, (300, 1, 3))
    real = clearance.distances(q[:, 0])[0]
    guide = Proximity(tree, Proxies(*clearance.shapes()), 0.03)
    too_near = guide(Motions(np.zeros((300, 1)), q, q, q)) > 0.0
    assert ((too_near == (real < 0.03)) | (np.abs(real - 0.03) < 0.03)).all()
    assert 0.1 < too_near.mean() < 0.9


def test_links_without_shapes_get_capsules_and_a_floor_and_both_are_said(tmp_path: Path) -> None:
    bare = "\n".join(line for line in ARM.splitlines() if "<geom" not in line)
    bare = bare.replace(
        '<joint name="turn"', '<inertial mass="20" pos="0 0 .1" diaginertia=".1 .1 .1"/><joint name="turn"'
    )
    bare = bare.replace(
        '<joint name="lift"', '<inertial mass="10" pos=".2 0 0" diaginertia=".1 .1 .1"/><joint name="lift"'
    )
    bare = bare.replace(
        '<joint name="bend"', '<inertial mass="4" pos=".15 0 0" diaginertia=".1 .1 .1"/><joint name="bend"'
    )
    (tmp_path / "bare.xml").write_text(bare)
    clearance = MujocoClearance.of(load(tmp_path / "bare.xml"), JOINTS)
    assert any("lower" in note and "estimated as capsules" in note for note in clearance.notes)
    assert any("floor at 0 m (assumed" in note for note in clearance.notes)
    low, high = clearance.distances(np.array([[0.0, 1.6, 0.0], [0.0, -1.2, 0.0]]))[0]
    assert low < 0.1 < high
    assert MujocoClearance.of(load(tmp_path / "bare.xml"), JOINTS, floor=None).notes[-1] == "no floor"


def test_each_broken_limit_is_named_with_its_moment(clearance: MujocoClearance) -> None:
    limits = narrow(1.0, 1.0, 2.0)
    time = np.linspace(0.0, 2.0, 201)
    q = np.stack([np.full(201, 0.0), 1.5 * np.sin(time), 0.2 * time], axis=1)
    qd, qdd = np.gradient(q, time, axis=0), np.zeros_like(q)
    found = {p.kind: p for p in Feasibility(limits, clearance).problems(Trajectory("t", JOINTS, time, q, qd, qdd))}
    assert {"range", "speed", "rest", "collision"} <= set(found)
    assert found["range"].where == "lift"
    assert "post" in found["collision"].where
    assert "at least 2.0 cm" in str(found["collision"])
