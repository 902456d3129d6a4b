# SPDX-License-Identifier: Apache-2.0
"""Joints that follow their commands further beside them than a servo's zero is: sensors that were not homed."""

from __future__ import annotations

import re

import numpy as np
import pytest

from trueup.inspection.zeros import far_beside, zeros_off
from trueup.recording import Channel, Recording

TIME = np.arange(0.0, 8.0, 0.02)


def _log(name: str, told: np.ndarray, measured: np.ndarray) -> Recording:
    return Recording(name, {
        "command": Channel("command", ("hip", "knee"), "rad", TIME, np.stack([told, told], axis=1)),
        "position": Channel("position", ("hip", "knee"), "rad", TIME, np.stack([told, measured], axis=1)),
    })  # fmt: skip


@pytest.mark.parametrize(
    ("apart", "follows", "said"),
    [
        (0.57, 0.95, True),
        (-0.57, 0.95, True),
        (0.1, 0.95, False),
        (0.57, 0.0, False),
    ],  # held by something, as a gripper
)
def test_a_joint_far_beside_its_command_all_along_is_named_with_the_offset(
    apart: float, follows: float, said: bool
) -> None:
    told = 0.7 * np.sin(1.5 * TIME)
    late = 0.7 * np.sin(1.5 * (TIME - 0.05))
    notes = far_beside([_log("a", told, apart + follows * late + 1e-3 * np.sin(40.0 * TIME))])
    assert bool(notes) == said
    if said:
        named = re.search(r"knee is measured (\S+) rad.*about (\S+) rad", notes[0])
        assert named is not None
        assert [float(number) for number in named.groups()] == pytest.approx([apart, -apart], abs=0.01)


def test_large_distances_at_rest_are_plain_numbers() -> None:
    told = np.floor(TIME) % 3 / 3.0
    found = zeros_off([_log("a", told, told + 0.6 + 0.01 * told)], ["knee"])
    assert found is not None
    assert "knee +602.9 mrad" in str(found)


def test_actions_of_a_policy_are_named_with_their_scale_and_the_pose_they_are_beside() -> None:
    angle = 0.6 * np.sin(1.5 * TIME)
    log = _log("a", (angle + 1.5) / 0.25, angle)
    log = log.replace(channels={**log.channels, "position": Channel(
        "position", ("hip", "knee"), "rad", TIME, np.stack([angle + 1.2, angle], axis=1))})  # fmt: skip
    (note,) = far_beside([log])
    named = re.search(r"scale = (\S+) and offset = \[(\S+), (\S+)\]", note)
    assert named is not None
    assert [float(number) for number in named.groups()] == pytest.approx([0.25, -0.3, -1.5], abs=0.01)
