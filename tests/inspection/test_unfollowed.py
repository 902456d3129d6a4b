# SPDX-License-Identifier: Apache-2.0
"""Commands that no joint follows are told of, and slow or soft servos are not."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.inspection.unfollowed import unfollowed
from trueup.recording import Channel, Recording

JOINTS = ("a", "b", "c")
TIME: Array = np.linspace(0.0, 20.0, 401)
PACE, PHASE = np.array([0.4, 0.6, 0.8]), np.array([0.0, 1.0, 2.0])
THERE = np.sin(PACE * TIME[:, None] + PHASE)


def logged(command: Array, seed: int = 0) -> Recording:
    noise = np.random.default_rng(seed).normal(0.0, 1e-4, THERE.shape)
    channels = {
        "position": Channel("position", JOINTS, "rad", TIME, THERE + noise),
        "command": Channel("command", JOINTS, "rad", TIME, command),
    }
    return Recording(name="log", channels=channels)


def test_steps_and_motions_of_a_tool_are_no_commands_of_joints() -> None:
    steps = 0.05 * PACE * np.cos(PACE * TIME[:, None] + PHASE)
    assert "no joint goes where it is commanded" in unfollowed([logged(steps)])[0]
    of_a_tool = steps @ np.array([[0.3, 1.0, -0.5], [1.0, -0.4, 0.2], [-0.6, 0.1, 1.0]])
    assert len(unfollowed([logged(np.clip(8.0 * of_a_tool, -1.0, 1.0))])) == 1


def test_legs_that_give_way_under_a_command_that_never_changes_say_nothing_of_it() -> None:
    assert unfollowed([logged(np.tile([0.0413466, 0.0765372, -2.28759], (len(TIME), 1)))]) == ()


def test_recordings_shorter_than_a_servo_may_be_late_are_looked_at() -> None:
    steps = 0.05 * PACE * np.cos(PACE * TIME[:, None] + PHASE)
    short = logged(steps).slice(3.0, 3.3)
    assert unfollowed([short, logged(steps)])


def test_servos_that_are_late_weak_or_partly_held_follow() -> None:
    earlier = np.sin(PACE * (TIME[:, None] + 0.2) + PHASE)
    assert unfollowed([logged(earlier)]) == ()
    assert unfollowed([logged(3.0 * earlier + 0.4)]) == ()
    held = np.column_stack([earlier[:, 0], np.cos(9.0 * TIME), np.sin(7.0 * TIME)])
    assert unfollowed([logged(held)]) == ()
