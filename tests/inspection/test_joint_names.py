# SPDX-License-Identifier: Apache-2.0
"""Joints of logs are found in the model by name, by what drives them, or by order; and what is not certain is said."""

from __future__ import annotations

import numpy as np

from trueup.inspection.joint_names import match_joints, named_as, sure_names, ways
from trueup.recording import Channel, Recording

ARM = {"joint_1": "joint_1", "joint_2": "joint_2", "right_carriage": "", "left_carriage": "left_gripper"}


def test_names_are_alike_but_for_capitals_and_filling_words() -> None:
    drives = {"FL_hip_joint": "FL_hip", "FL_knee_joint": "FL_knee"}
    assert match_joints(["fl_knee", "flHip"], drives) == (
        {"fl_knee": "FL_knee_joint", "flHip": "FL_hip_joint"},
        "by name",
    )


def test_a_gripper_is_the_joint_that_its_actuator_drives() -> None:
    names, how = match_joints(["Joint1", "Joint2", "gripper"], ARM)
    assert names == {"Joint1": "joint_1", "Joint2": "joint_2", "gripper": "left_carriage"}
    assert how == "by name"


def test_what_shares_no_name_goes_by_the_order_of_the_driven_joints() -> None:
    names, how = match_joints(["a", "b", "c"], ARM)
    assert list(names.values()) == ["joint_1", "joint_2", "left_carriage"]
    assert "check" in how


def test_what_all_names_begin_or_end_with_does_not_count() -> None:
    model = {"base": "", "elbow": "", "wrist": ""}
    for label in ("motor_{}_act", "r_arm_{}", "{}_state"):
        labels = [label.format(name) for name in ("wrist", "base", "elbow")]
        names, how = match_joints(labels, model)
        assert list(names.values()) == ["wrist", "base", "elbow"]
        assert how == "by name"


def test_labels_that_merely_count_are_sure_in_order_and_other_names_are_not() -> None:
    model = {"quill": "", "arm1": "arm1", "arm2": "arm2"}
    assert sure_names(["q0", "q1"], model)[0] == {"q0": "arm1", "q1": "arm2"}
    assert sure_names(["left", "right"], model)[0] == {}


def test_what_cannot_be_known_stays_open() -> None:
    names, _ = match_joints(["elbow", "joint_1"], {"joint_1": "", "x": "", "y": ""})
    assert names == {"joint_1": "joint_1"}


def test_joints_that_logs_count_from_zero_and_models_from_one_are_not_mistaken_for_each_other() -> None:
    model = {"joint_1": "", "joint_2": "", "joint_3": "", "gripper": ""}
    names, how = match_joints(["joint_0", "joint_1", "joint_2", "grip"], model)
    assert names == {"joint_0": "joint_1", "joint_1": "joint_2", "joint_2": "joint_3", "grip": "gripper"}
    assert "check" in how
    assert match_joints(["joint_1", "joint_2", "joint_3"], model)[1] == "by name"
    assert match_joints(["j1", "j2"], {"a0": "", "a1": ""})[0] == {"j1": "a0", "j2": "a1"}


def _logged(commands: tuple[str, ...]) -> Recording:
    """Three joints that lag 40 ms behind their commands, which are listed in another order."""
    time = np.arange(0.0, 6.0, 0.01)
    speeds, order = (1.1, 1.7, 2.3), (2, 0, 1)
    position = np.stack([np.sin(s * (time - 0.04)) for s in speeds], axis=1)
    command = np.stack([np.sin(speeds[k] * time) for k in order], axis=1)
    channels = (Channel("position", ("hip", "knee", "toe"), "rad", time, position),
                Channel("command", commands, "rad", time, command))  # fmt: skip
    return Recording("run", {c.name: c for c in channels})


def test_commands_that_only_count_belong_to_the_joints_that_follow_them() -> None:
    (named,), notes = named_as([_logged(("joint_0", "joint_1", "joint_2"))], dict.fromkeys(("hip", "knee", "toe"), ""))
    assert named.channel("command").labels == ("toe", "hip", "knee")
    assert "by the motion" in notes[0]
    assert named_as([named], dict.fromkeys(("hip", "knee", "toe"), "")) == ([named], [])


def test_a_gripper_that_is_counted_behind_an_arm_does_not_hide_its_joints() -> None:
    arm = {f"panda_joint{k}": f"m{k}" for k in range(1, 5)}
    names, _ = sure_names([f"joint_{k}" for k in range(1, 6)], arm)
    assert names == {f"joint_{k}": f"panda_joint{k}" for k in range(1, 5)}
    names, _ = sure_names(["gripper_1", "joint_0", "joint_1", "joint_2", "joint_3"], arm)
    assert names == {f"joint_{k}": f"panda_joint{k + 1}" for k in range(4)}
    fingers = dict.fromkeys(("finger_joint1", "finger_joint2"), "")
    names, _ = sure_names([f"joint_{k}" for k in range(1, 6)], {**arm, **fingers})
    assert names == {f"joint_{k}": f"panda_joint{k}" for k in range(1, 5)}


def test_numbered_joints_of_an_arm_are_not_those_of_its_wrist() -> None:
    arm = [
        "shoulder_pan_joint",
        "shoulder_lift_joint",
        "elbow_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ]
    for start in (0, 1):
        labels = [f"joint_{start + k}" for k in range(6)]
        names, how = match_joints(labels, dict.fromkeys(arm, "driven"))
        assert list(names.values()) == arm
        assert "check" in how


def test_names_that_are_alike_are_not_among_those_that_go_by_order() -> None:
    names = {"Shoulder": "shoulder", "left": "lift", "elbow": "elbow"}
    assert ways(names, "by order") == ["by name: Shoulder -> shoulder", "by order: left -> lift"]
    assert ways({"joint_0": "joint_1", "joint_1": "joint_2"}, "by order") == [
        "by order: joint_0 -> joint_1, joint_1 -> joint_2"
    ]
    assert not ways({"elbow": "elbow"}, "by name")
