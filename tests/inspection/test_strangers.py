# SPDX-License-Identifier: Apache-2.0
"""A log that holds more joints than the model: those of another robot go, one that may be a joint of the model stays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.inspection.strangers import several_robots, without_strangers
from trueup.recording import Channel, Recording

_ARM = {"shoulder": "", "elbow": ""}


def _log(labels: Sequence[str]) -> Recording:
    time = np.arange(0.0, 1.0, 0.1)
    values = np.tile(np.arange(float(len(labels))), (10, 1))
    channels = [Channel(name, tuple(labels), "rad", time, values) for name in ("command", "position")]
    imu = Channel("imu", ("x",), "", time, np.zeros((10, 1)))
    return Recording("log", {c.name: c for c in (*channels, imu)})


def _left(labels: Sequence[str]) -> tuple[tuple[str, ...], list[str]]:
    (taken,), notes = without_strangers([_log(labels)], _ARM)
    assert taken.has("imu")
    assert taken.channel("command").labels == taken.channel("position").labels
    return taken.channel("position").labels, notes


def test_the_other_arm_of_a_log_is_left_out_and_named() -> None:
    labels, notes = _left(["shoulder", "right_shoulder", "right_elbow", "elbow"])
    assert labels == ("shoulder", "elbow")
    assert notes == ["not in the model, and left out: right_shoulder, right_elbow"]


def test_a_gripper_that_the_model_lacks_is_left_out() -> None:
    assert _left(["shoulder", "gripper"])[0] == ("shoulder",)


def test_a_drive_of_several_joints_that_it_may_be_is_offered() -> None:
    _, (note,) = without_strangers([_log(["shoulder", "gripper_width"])], _ARM, ("grip",))
    assert "if one is theirs, say so in [joints]" in note
    assert ": grip;" in note


def test_where_the_log_has_every_joint_of_the_model_the_rest_is_another_machine() -> None:
    assert _left(["shoulder", "elbow", "conveyor"])[0] == ("shoulder", "elbow")


def test_a_joint_that_may_have_another_name_in_the_model_stays_to_be_asked_about() -> None:
    labels, notes = _left(["shoulder", "elbw"])
    assert labels == ("shoulder", "elbw")
    assert not notes


def test_commands_that_all_have_other_names_stay_to_be_asked_about() -> None:
    log = _log(["shoulder", "elbow"])
    log = log.with_channel(log.channel("command").replace(labels=("v_shoulder", "drive_2")))
    (taken,), _ = without_strangers([log], {"shoulder": "", "elbow": ""})
    assert taken.channel("command").labels == ("v_shoulder", "drive_2")


def test_two_robots_of_which_either_may_be_the_model_are_said() -> None:
    said = several_robots(["left_elbow", "right_elbow", "left_shoulder", "right_shoulder"], _ARM)
    assert "several robots (left_shoulder, right_shoulder)" in said
    assert not several_robots(["arm_elbow", "arm_shoulder"], _ARM)
