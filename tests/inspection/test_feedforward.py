# SPDX-License-Identifier: Apache-2.0
"""Positions stand for the speeds and torques that drives were told beside them, where the log names their gains."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.inspection.feedforward import with_feedforward
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]
TIME = np.arange(0.0, 5.0, 0.01)
KP, KD = 20.0, 0.5
WANTED, PACE = np.sin(2.0 * TIME), 2.0 * np.cos(2.0 * TIME)
POSITION = np.sin(2.0 * (TIME - 0.02)) - 0.02
HELP = 3.0 + np.cos(1.3 * TIME)  # N m


def log(**channels: tuple[str, Array]) -> Recording:
    whole = {"command": ("rad", WANTED), "position": ("rad", POSITION), **channels}
    return Recording("log", {name: Channel(name, ("hip",), unit, TIME, values) for name, (unit, values) in whole.items()},
                     {"kp": f"{KP}", "kd": f"{KD}"})  # fmt: skip


def pull(torque: Array) -> Array:
    """N m of the drive's law."""
    return KP * (WANTED - POSITION) + KD * (PACE - np.gradient(POSITION, TIME)) + torque


def test_a_command_moved_by_what_was_added_asks_a_servo_for_the_same() -> None:
    (made,), notes = with_feedforward([log(command_torque=("N m", HELP), command_velocity=("rad/s", PACE))])
    moved = made.channel("command").column("hip")
    np.testing.assert_allclose(KP * (moved - POSITION) - KD * np.gradient(POSITION, TIME), pull(HELP), atol=1e-9)
    assert list(made.channels) == ["command", "position"]
    assert "moved by (kd speed + torque) / kp" in notes[0]


def test_torques_that_are_zero_all_along_leave_the_robot_to_its_positions() -> None:
    (made,), notes = with_feedforward([log(command_torque=("N m", 0.0 * TIME))])
    assert list(made.channels) == ["command", "position"]
    assert "zero all along (log)" in notes[0]


def test_torques_that_are_zero_all_along_are_left_out_beside_speeds_that_are_not() -> None:
    """A model with motors would be driven by them alone: let go."""
    bare = log(command_torque=("N m", 0.0 * TIME), command_velocity=("rad/s", PACE)).replace(provenance={})
    (made,), notes = with_feedforward([bare])
    assert set(made.channels) == {"command", "position", "command_velocity"}
    assert "zero all along (log)" in notes[0]
    assert "does not name gains (log)" in notes[1]


def test_only_speeds_are_said_to_be_zero_where_torques_are_not() -> None:
    _, notes = with_feedforward([log(command_torque=("N m", HELP), command_velocity=("rad/s", 0.0 * TIME))])
    assert "torque, is taken as positions moved" in notes[0]
    assert notes[1] == "speeds commanded beside positions are zero all along (log): they are left out"


@pytest.mark.parametrize("measured", [False, True])
def test_torques_that_are_all_that_acts_stay_a_command_of_their_own(measured: bool) -> None:
    """A controller on the computer that logs what its gains make of positions."""
    whole = pull(HELP if measured else 0.0 * TIME)
    more = {"torque": ("N m", whole + 0.01 * np.sin(9.0 * TIME))} if measured else {}
    before = log(command_torque=("N m", whole), command_velocity=("rad/s", PACE), **more)
    (made,), notes = with_feedforward([before])
    assert made is before
    assert not notes


def test_a_weight_that_a_controller_holds_beside_its_gains_is_part_of_all_that_acts() -> None:
    """Its torque shows the noise of the positions that it was made of, which one that is only added does not."""
    seen = POSITION + 2e-4 * np.random.default_rng(0).standard_normal(len(TIME))
    for torque, stays in ((KP * (WANTED - seen) - KD * np.gradient(seen, TIME) + HELP, True), (HELP, False)):
        (made,), _ = with_feedforward([log(command_torque=("N m", torque), position=("rad", seen))])
        assert made.has("command_torque") == stays


@pytest.mark.parametrize(
    ("kind", "unit", "limit"),
    [("torque", "N m", 0.0 * TIME + 4.0), ("velocity", "rad/s", 0.0 * TIME + 4.0), ("velocity", "rad/s", np.abs(PACE))],
)
def test_greatest_torques_and_speeds_are_not_added(kind: str, unit: str, limit: Array) -> None:
    before = log(**{f"command_{kind}": (unit, limit)})
    (made,), _ = with_feedforward([before])
    assert made is before


def test_torques_beside_positions_without_gains_are_said_to_be_unused() -> None:
    before = log(command_torque=("N m", HELP)).replace(provenance={})
    (made,), notes = with_feedforward([before])
    assert made is before
    assert "does not name gains (log)" in notes[0]
