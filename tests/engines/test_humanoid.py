# SPDX-License-Identifier: Apache-2.0
"""What is found to be mirrored in a model is so by its kinematics; named poses and their overlaps are those of the file."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from trueup.articulated.mirror import Mirrored, mirrored_at_best
from trueup.campaign.plan import templates
from trueup.engines.mujoco.base import free_joint
from trueup.engines.mujoco.humanoid import commanded, mirrored, overlap, posture, ranges
from trueup.engines.mujoco.model import Model, load
from trueup.errors import ModelError, UnknownNameError
from trueup.studies.balance.scenes import PATH

SMALL = templates()["motion"] / "small_humanoid.xml"


def posed(model: Model, pairs: tuple[Mirrored, ...], angles: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(model.compiled)
    for angle, pair in zip(angles, pairs, strict=True):
        for joint, sign in zip(pair.joints, pair.signs, strict=True):
            data.qpos[model.compiled.jnt_qposadr[model.index("joint", joint)]] = sign * angle
    mujoco.mj_kinematics(model.compiled, data)
    return data


@pytest.mark.parametrize("path", [PATH, SMALL], ids=lambda p: p.stem)
def test_with_the_signs_found_both_sides_take_mirrored_poses(path: Path) -> None:
    model = load(path)
    pairs = mirrored(model)
    assert sorted(j for p in pairs for j in p.joints) == sorted(commanded(model))
    assert all(len(p.joints) == 2 for p in pairs)
    data = posed(model, pairs, np.random.default_rng(0).uniform(-0.5, 0.5, len(pairs)))
    for pair in pairs:
        left, right = (data.xpos[model.compiled.jnt_bodyid[model.index("joint", j)]] for j in pair.joints)
        np.testing.assert_allclose(left * [1, -1, 1], right, atol=1e-9)
        turned = [data.xmat[model.compiled.jnt_bodyid[model.index("joint", j)]].reshape(3, 3) for j in pair.joints]
        flip = np.diag([1.0, -1.0, 1.0])
        np.testing.assert_allclose(flip @ turned[0] @ flip, turned[1], atol=1e-9)


@pytest.mark.parametrize("sides", [("knee_Left", "knee_Right"), ("L_knee", "R_knee"), ("knee-l", "knee-r")])
def test_a_pair_is_called_by_its_joints_name_without_the_side_however_that_is_written(sides: tuple[str, str]) -> None:
    (pair,) = mirrored_at_best(sides, np.array([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]), np.tile([0.0, 1.0, 0.0], (2, 1)))
    assert (pair.name, pair.joints) == ("knee", sides)


def test_only_what_turns_in_the_plane_of_symmetry_raises_a_body() -> None:
    small = {m.name: m for m in mirrored(load(SMALL))}
    assert {n for n, m in small.items() if m.sagittal} == {"shoulder", "hip", "knee", "ankle"}
    assert small["hip"].joints == ("left_hip", "right_hip")
    assert small["hip"].signs == (1.0, -1.0)  # its right servos turn the other way
    assert small["hip_roll"].signs == (1.0, -1.0)


def test_a_robot_that_looks_along_y_is_recognised_too(tmp_path: Path) -> None:
    text = SMALL.read_text("utf-8").replace("<freejoint/>", '<freejoint/><frame euler="0 0 1.5707963">')
    (tmp_path / "turned.xml").write_text(
        text.replace("</body>\n  </worldbody>", "</frame></body></worldbody>"), "utf-8"
    )
    assert mirrored(load(tmp_path / "turned.xml")) == mirrored(load(SMALL))


def test_poses_ranges_and_overlaps_are_read_from_the_file(tmp_path: Path) -> None:
    model = load(SMALL)
    sit = posture(model, "sit")
    assert sit.joints[list(commanded(model)).index("left_hip")] == -1.45
    assert not sit.inverted
    low, high = ranges(model)
    assert (low[3], high[3]) == (-0.1, 2.2)
    assert overlap(model, posture(model, "stand")) == ""
    (tmp_path / "deep.xml").write_text(
        SMALL.read_text("utf-8").replace('qpos="0.13 0 0.35', 'qpos="0.13 0 0.34'), "utf-8"
    )
    deep = load(tmp_path / "deep.xml")
    assert overlap(deep, posture(deep, "stand")).endswith("mm inside 'floor'")
    with pytest.raises(UnknownNameError, match=r"keyframe 'squat' .*keyframes are: lean, sit, stand"):
        posture(model, "squat")


def test_an_arm_is_no_humanoid(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(
        """<mujoco><worldbody><body name="a"><freejoint/><geom size=".1"/>
        <body name="b"><joint name="j" axis="0 0 1"/><geom size=".1"/></body>
        </body></worldbody><actuator><position joint="j"/></actuator></mujoco>""",
        encoding="utf-8",
    )
    model = load(tmp_path / "arm.xml")
    assert free_joint(model.compiled) >= 0
    with pytest.raises(ModelError, match=r"no two joints of model 'arm\.xml' mirror one another"):
        mirrored(model)
