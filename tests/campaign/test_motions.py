# SPDX-License-Identifier: Apache-2.0
"""A transition of one's own humanoid is made from its file's keyframes; what cannot be is named."""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from trueup.campaign.kinds import TASKS
from trueup.campaign.making import instance
from trueup.campaign.motions import transition
from trueup.campaign.plan import templates
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.errors import ModelError, ParameterError, TrialError, UnknownNameError
from trueup.tasks.transitions import Transition
from trueup.typed_toml import Component

ARM = Path(str(resources.files("trueup"))) / "studies" / "servo_arm" / "arm.xml"
SMALL = templates()["motion"] / "small_humanoid.xml"


@pytest.fixture
def changed(tmp_path: Path) -> Callable[[str, str], Path]:
    """The small humanoid with something else in its file."""

    def make(old: str, new: str) -> Path:
        text = SMALL.read_text("utf-8")
        assert old in text
        (tmp_path / "changed.xml").write_text(text.replace(old, new), encoding="utf-8")
        return tmp_path / "changed.xml"

    return make


def test_poses_degrees_and_start_come_from_the_file() -> None:
    _, task = transition(
        SMALL, "sit", "stand", between=["lean"], searched=["hip", "knee", "ankle"], intervals=[0.2, 0.4]
    )
    assert task.name == "sit-to-stand"
    assert task.parameters.names == (
        "keyframe1.hip", "keyframe1.knee", "keyframe1.ankle", "interval1", "interval2"
    )  # fmt: skip
    np.testing.assert_allclose(task.parameters.nominal, [-1.9, 1.5, 0.0, 0.2, 0.4])
    assert task.parameters["keyframe1.hip"].lower == -2.1  # of both servos, one of which turns the other way
    assert task.final_height == pytest.approx(0.35, abs=0.005)
    assert float(task.start["base_position"].column("z")[0]) == pytest.approx(0.235, abs=0.01)
    (planned,) = task.planned(task.parameters.nominal)
    assert planned.command is not None
    np.testing.assert_allclose(planned.command.values[:, [2, 7]].sum(axis=1), 0.0, atol=1e-12)  # hips, mirrored


def test_a_plan_can_name_it() -> None:
    component = Component("transition", {"start": "sit", "goal": "stand", "between": 2}, "plan.toml, [task]")
    task = instance(component, "task", TASKS, {"simulator": MujocoSimulator(load(SMALL), step=0.004)}, SMALL.parent)
    assert isinstance(task, Transition)
    assert len(task.motion.seeds) == 2
    hips = task.motion.seeds[:, 1]
    np.testing.assert_allclose(hips, [-1.0, -0.55], atol=1e-9)  # evenly from -1.45 to -0.1


def test_no_motion_asks_for_more_than_a_servo_can() -> None:
    _, task = transition(SMALL, "sit", "stand", speeds={"hip": 4.0}, intervals=[0.5, 0.5], searched=["hip"], reach=3.0)
    rng = np.random.default_rng(0)
    values = task.parameters.from_unit(rng.uniform(size=(50, len(task.parameters))))
    asked = [task.motion.fastest(v) for v in values]
    assert max(a["left_hip"] for a in asked) <= 4.0 + 1e-9
    assert max(a["left_hip"] for a in asked) > 3.9  # they may go to the limit
    with pytest.raises(
        ParameterError, match=r"interval 1 of 0\.1 s .* '(left|right)_hip' would need .* can do 4 rad/s; give"
    ):
        transition(SMALL, "sit", "stand", speeds={"hip": 4.0}, intervals=[0.1, 0.5])
    with pytest.raises(UnknownNameError, match="joint 'waist'"):
        transition(SMALL, "sit", "stand", speeds={"waist": 4.0})


def test_a_start_inside_something_is_named_with_what_it_is_in(changed: Callable[[str, str], Path]) -> None:
    inside = changed('"sit" qpos="0 0 0.24', '"sit" qpos="0 0 0.12')
    with pytest.raises(TrialError, match=r"pose 'sit' penetrates .* keyframe 'sit' .* mm inside '(floor|chair)'"):
        transition(inside, "sit", "stand")


def test_a_pose_that_falls_over_is_named(changed: Callable[[str, str], Path]) -> None:
    on_its_heels = changed("0 -0.1 0.2 -0.1  0 0.1 -0.2 0.1", "0 -0.1 0.2 0.7  0 0.1 -0.2 -0.7")
    with pytest.raises(TrialError, match=r"pose 'stand' falls over or sinks: .* in the keyframe it is 0\.35 m"):
        transition(on_its_heels, "sit", "stand")


def test_what_is_not_in_the_file_is_named(changed: Callable[[str, str], Path]) -> None:
    with pytest.raises(UnknownNameError, match=r"keyframe 'handstand' .*sit, stand"):
        transition(SMALL, "sit", "handstand")
    with pytest.raises(UnknownNameError, match=r"angle 'elbow' .*ankle, hip, hip_roll, knee, shoulder"):
        transition(SMALL, "sit", "stand", searched=["elbow"])
    with pytest.raises(ModelError, match="is held: a transition needs one with a free joint"):
        transition(ARM, "sit", "stand")
    beyond = changed("0 -1.45 1.35 0.1  0 1.45", "0 -2.45 1.35 0.1  0 2.45")
    with pytest.raises(ParameterError, match=r"keyframe 0: joint 'left_hip' at -2\.45 rad is outside its range -2\.1"):
        transition(beyond, "sit", "stand")


def test_a_humanoid_whose_drives_take_torques_is_told_to_have_servos(changed: Callable[[str, str], Path]) -> None:
    motor = changed('<position name="left_knee" joint="left_knee"/>', '<motor name="left_knee" joint="left_knee"/>')
    with pytest.raises(ModelError, match=r"drives of left_knee of .*take torques.*<position joint=\"left_knee\" kp="):
        transition(motor, "sit", "stand")
