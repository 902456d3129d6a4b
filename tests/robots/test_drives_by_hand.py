# SPDX-License-Identifier: Apache-2.0
"""A log of a drive that was asked for: taken where the robot started there, in its frame, and the log holds what drove it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.recording import Channel, Recording
from trueup.robots.by_hand.check import mismatches
from trueup.trial import Observed, Reference, Trial

Array = NDArray[np.float64]

TIME = np.arange(0.0, 30.0, 0.05)
WAY = np.linspace(0.0, 12.0, len(TIME))


def wanted(size: float = 1.0) -> Trial:
    """A winding path of 12 m (times `size`) that begins at the origin, and a start half a metre before it."""
    path = np.stack([WAY, 2.0 * np.sin(0.5 * WAY)], axis=1) * size
    begin = {"position": Channel("position", ("x", "y"), "m", np.zeros(1), size * np.array([[-0.35, -0.35]]))}
    observed = {
        "position": Observed(("x", "y"), "m", TIME), "heading": Observed(("heading",), "rad", TIME),
        "command": Observed(("speed", "steering"), "", TIME),
    }  # fmt: skip
    return Trial("trial-001", 0.0, float(TIME[-1]), None, observed, begin,
                 references={"path": Reference(("x", "y"), ("m", "m"), path)})  # fmt: skip


def driven(place: Array, heading: Array, command: Array) -> Recording:
    return Recording("log", {
        "position": Channel("position", ("x", "y"), "m", TIME, place),
        "heading": Channel("heading", ("heading",), "rad", TIME, heading[:, None]),
        "command": Channel("command", ("speed", "steering"), "", TIME, command),
    })  # fmt: skip


def along(size: float = 1.0, off: tuple[float, float] = (0.0, 0.0)) -> tuple[Array, Array, Array]:
    """Place, heading and commands of a robot that drives along the path from where it was to start, a little beside it."""
    x = np.linspace(-0.35, 12.0, len(TIME))
    y = np.where(x < 0.0, x, 2.0 * np.sin(0.5 * x)) + 0.05
    heading = np.where(x < 0.0, np.pi / 4, np.arctan(np.cos(0.5 * x)))
    steering = -0.2 * np.sin(0.5 * x)
    return size * np.stack([x, y], axis=1) + np.array(off), heading, np.stack([0.4 + 0.0 * x, steering], axis=1)


@pytest.mark.parametrize("size", [1.0, 0.05, 30.0])
def test_a_robot_is_placed_as_well_as_people_can(size: float) -> None:
    """A toy within centimetres, a car within metres, and none of them at the other end of the hall."""
    close, far = (size * share * 12.0 for share in (0.04, 0.3))
    assert not mismatches(wanted(size), driven(*along(size, (0.0, close))))
    (said,) = mismatches(wanted(size), driven(*along(size, (0.0, -far))))
    assert "from where the run was to start" in said


def test_a_drive_in_another_frame_begins_elsewhere() -> None:
    (said,) = mismatches(wanted(), driven(*along(off=(2.4, -1.0))))
    assert said.startswith(
        "it begins 2.6 m from where the run was to start (at x 2.09, y -1.26 m, not x -0.35, y -0.35 m)"
    )


@pytest.mark.parametrize(
    ("frame", "words"), [("y", "sign = [1, -1]"), ("x", "sign = [-1, 1]"), ("both", "x and y exchanged")]
)
def test_a_mirror_image_of_the_path_is_called_so(frame: str, words: str) -> None:
    place, heading, command = along()
    turned = {
        "y": (place * (1.0, -1.0), -heading), "x": (place * (-1.0, 1.0), np.pi - heading),
        "both": (place[:, ::-1], np.pi / 2 - heading),
    }  # fmt: skip
    (said,) = mismatches(wanted(), driven(*turned[frame], command * (1.0, -1.0)))
    assert "it is a mirror image of the path" in said
    assert words in said


def test_a_straight_path_is_its_own_mirror_image() -> None:
    place, heading, command = along()
    flat = wanted().references["path"]
    straight = Reference(flat.labels, flat.units, flat.values * (1.0, 0.0))
    trial = Trial("trial-001", 0.0, float(TIME[-1]), None, wanted().observed, references={"path": straight})
    wobbly = 0.02 * np.sin(WAY)
    command = np.stack([command[:, 0], -wobbly], axis=1)
    assert not mismatches(trial, driven(np.stack([place[:, 0], -wobbly], axis=1), 0.0 * heading, command))


@pytest.mark.parametrize(
    ("factors", "said"),
    [
        ((0.0, 0.0), "speed stays at 0 and steering stays at 0 while it goes 1"),
        ((0.0, 1.0), "speed stays at 0 while"),
        ((1.0, 0.0), "steering stays at 0 while"),
    ],
    ids=["neither", "no speed", "no steering"],
)
def test_commands_that_stand_while_the_robot_drives_are_none(factors: tuple[float, float], said: str) -> None:
    place, heading, command = along()
    (found,) = mismatches(wanted(), driven(place, heading, command * factors))
    assert said in found
    assert not mismatches(wanted(), driven(place, heading, command))
