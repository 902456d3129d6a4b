# SPDX-License-Identifier: Apache-2.0
"""The model of the small humanoid agrees with the published figures, is symmetric, and stands."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import mujoco
import numpy as np
import pytest

PATH = Path(str(resources.files("trueup") / "studies" / "balance" / "bioloid_gp.xml"))
LEFT = {  # m, from the torso's origin at zero angles, x forward
    "l_shoulder": (0.0038, 0.0561, 0.0003), "l_arm": (0.0038, 0.0791, -0.0177), "l_hand": (0.0217, 0.0791, -0.0751),
    "l_hip": (0.0, 0.0160, -0.0765), "l_thigh": (0.0004, 0.0160, -0.1183), "l_shin": (0.0241, 0.0160, -0.1905),
    "l_heel": (-0.0009, 0.0160, -0.2627), "l_foot": (-0.0009, 0.0281, -0.2630),
}  # fmt: skip


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(PATH))


def at_zero(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def test_joints_lie_where_the_published_model_has_them(model: mujoco.MjModel) -> None:
    data = at_zero(model)
    origin = data.body("torso").xpos
    for name, where in LEFT.items():
        np.testing.assert_allclose(data.xanchor[model.joint(name).id] - origin, where, atol=1e-9)
    sole = data.geom("l_sole").xpos - origin
    assert sole[2] - 0.006 == pytest.approx(-0.295, abs=5e-4)
    assert model.body_mass.sum() == pytest.approx(1.562)
    assert model.nu == 16


def test_the_right_side_mirrors_the_left(model: mujoco.MjModel) -> None:
    data = at_zero(model)
    for name in LEFT:
        left, right = model.joint(name).id, model.joint(f"r{name[1:]}").id
        np.testing.assert_allclose(data.xanchor[left] * [1, -1, 1], data.xanchor[right], atol=1e-12)
        roll = name in ("l_arm", "l_hip", "l_foot")
        mirrored = -model.jnt_range[left][::-1] if roll else model.jnt_range[left]
        np.testing.assert_allclose(model.jnt_range[right], mirrored)
        bodies = model.jnt_bodyid[left], model.jnt_bodyid[right]
        assert model.body_mass[bodies[0]] == pytest.approx(model.body_mass[bodies[1]])
        np.testing.assert_allclose(model.body_ipos[bodies[0]] * [1, -1, 1], model.body_ipos[bodies[1]], atol=1e-9)


def test_positive_angles_turn_as_the_published_sheet_says(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    for joint, geom, axis, sign in (
        ("l_shoulder", "l_hand", 2, 1), ("l_hand", "l_hand", 2, 1), ("l_arm", "l_arm", 1, -1), ("l_hip", "l_sole", 1, -1),
        ("l_thigh", "l_sole", 0, 1), ("l_shin", "l_sole", 0, 1),
    ):  # fmt: skip
        mujoco.mj_resetData(model, data)
        mujoco.mj_forward(model, data)
        before = data.geom(geom).xpos[axis]
        data.joint(joint).qpos = 0.2
        mujoco.mj_forward(model, data)
        assert sign * (data.geom(geom).xpos[axis] - before) > 1e-3, joint


def test_it_stands_still_and_no_start_pose_touches_itself(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert {model.geom(c.geom1).name for c in data.contact} == {"floor"}
    for _ in range(1500):
        mujoco.mj_step(model, data)
    w, x, y, z = data.qpos[3:7]
    assert abs(np.arcsin(2 * (w * y - z * x))) < 0.03  # the trial that the figures come from: -0.015 rad
    assert data.qpos[2] == pytest.approx(0.302, abs=1e-3)
    assert np.abs(data.qvel).max() < 1e-2
