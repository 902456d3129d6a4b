# SPDX-License-Identifier: Apache-2.0
"""Joints that turn on and on are replayed as they moved, wherever their encoders and commands begin anew."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.inspection import inspect
from trueup.inspection.scales import Way
from trueup.inspection.turns import without_wraps
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording

_FREE = {"wrist": Way(slides=False, range=None)}
TIME = np.arange(0.0, 8.0, 0.02)
TURNING = 0.9 * TIME + 0.8 * np.sin(2.0 * TIME)
AHEAD = 0.9 * (TIME + 0.05) + 0.8 * np.sin(2.0 * (TIME + 0.05))


def within(angle: Array, low: float = -math.pi) -> Array:
    return (angle - low) % math.tau + low


def log(position: Array, command: Array, name: str = "run") -> Recording:
    roles = {"position": position, "command": command}
    return Recording(name, {n: Channel(n, ("wrist",), "rad", TIME, v[:, None]) for n, v in roles.items()})


def taken(*recordings: Recording) -> tuple[list[tuple[Array, Array]], list[str]]:
    found, notes = without_wraps(_FREE, {"wrist": "servo"}, recordings)
    return [(r.channel("position").column("wrist"), r.channel("command").column("wrist")) for r in found], notes


@pytest.mark.parametrize("low", [-math.pi, 0.0], ids=["as the positions", "from zero to a turn"])
def test_a_joint_without_limits_goes_on_turning_and_its_command_with_it(low: float) -> None:
    [(position, command)], notes = taken(log(within(TURNING), within(AHEAD, low)))
    assert position == pytest.approx(TURNING)
    assert command == pytest.approx(AHEAD)
    assert len(notes) == 1
    assert notes[0].startswith("positions of wrist jump by a whole turn between samples (run)")


@pytest.mark.parametrize("position", [TURNING, TURNING - 2.0 * math.tau])
def test_commands_of_other_turns_lie_where_the_joint_is(position: Array) -> None:
    for told in (within(AHEAD), AHEAD):
        [(same, command)], notes = taken(log(position, told))
        assert same is position or np.array_equal(same, position)
        assert command - position == pytest.approx(AHEAD - TURNING)
        assert (not notes) == (told is AHEAD and position is TURNING)


def test_a_command_to_turn_by_more_than_half_a_turn_stays_as_it_was_told() -> None:
    steps = np.where(TIME < 2.0, -1.7, np.where(TIME < 6.0, 1.7, 1.7 + math.tau))
    speed = 2.5 * 0.02
    position = [-1.7]
    for wanted in steps[:-1]:
        position.append(position[-1] + float(np.clip(wanted - position[-1], -speed, speed)))
    for also in ([], [log(within(TURNING), within(AHEAD), "turns")]):
        (_, command), *_ = taken(log(np.array(position), steps), *also)[0]
        assert np.array_equal(command, steps)


def test_gaps_and_missing_samples_are_no_turns() -> None:
    holes = np.where(np.arange(len(TIME)) % 50 == 0, np.nan, within(TURNING))
    [(position, command)], _ = taken(log(holes, within(AHEAD)))
    known = np.isfinite(holes)
    assert position[known] == pytest.approx(TURNING[known])
    assert command == pytest.approx(AHEAD)
    lost = np.where(TIME < 4.0, 0.0, 4.0)  # nearer to half a turn than to a whole one
    assert not taken(log(lost, lost))[1]


def test_a_joint_with_limits_is_left_alone_and_so_is_one_whose_edit_is_refused(tmp_path: Path) -> None:
    arm = (
        '<mujoco><worldbody><body><joint name="wrist" {}/><geom size=".05" mass="1" pos=".1 0 0"/></body></worldbody>'
        '<actuator><position name="servo" joint="wrist" kp="5"/></actuator></mujoco>'
    )
    wrapped = log(within(TURNING), within(AHEAD))
    for limits, refuse, jumps in (("", (), False), ("", ("turns",), True), ('range="-190 190"', (), True)):
        path = tmp_path / "arm.xml"
        path.write_text(arm.format(limits))
        (ready,) = prepare(path, [wrapped], propose=False, refuse=refuse).recordings
        for name in ("position", "command"):
            assert (float(np.abs(np.diff(ready.channel(name).column("wrist"))).max()) > 6.0) == jumps


@pytest.mark.parametrize(("unit", "turn", "said"), [("rad", math.tau, "2 pi"), ("", 360.0, "360")])
def test_inspect_says_which_angles_jump_by_a_turn(unit: str, turn: float, said: str) -> None:
    plain = log(within(TURNING), within(AHEAD))
    for name in ("position", "command"):
        channel = plain.channel(name)
        plain = plain.with_channel(channel.replace(unit=unit, values=channel.values * turn / math.tau))
    assert any(f"position, command: wrist jumps by {said} between" in s for s in inspect(plain).findings())
    assert not any("jumps" in s for s in inspect(log(TURNING, AHEAD)).findings())


@pytest.mark.parametrize("centre", [0.2, -0.1, -1.5, 1.7])
@pytest.mark.parametrize("reach", [2.4, math.tau])
def test_a_joint_with_a_range_is_within_it_though_its_encoder_counts_from_zero_to_a_turn(
    centre: float, reach: float
) -> None:
    """Kinova's Gen3 tells all angles from 0 to 360 degrees, also of joints that cannot turn on."""
    moved, told = centre + 0.6 * np.sin(TIME), centre + 0.6 * np.sin(TIME + 0.1)
    log_of = log(within(moved, 0.0), within(told, 0.0))
    found, notes = without_wraps({"wrist": Way(slides=False, range=(-reach, reach))}, {"wrist": "servo"}, [log_of])
    seen = {name: found[0].channel(name).column("wrist") for name in ("position", "command")}
    assert seen["command"] - seen["position"] == pytest.approx(told - moved)
    wraps = bool(np.any(np.abs(np.diff(within(moved, 0.0))) > 1.0))
    beyond = float(within(moved, 0.0).max()) > reach
    assert bool(notes) == (wraps or beyond)
    if wraps or beyond:
        assert seen["position"] == pytest.approx(moved)


def test_a_joint_that_is_in_its_range_stays_there_whatever_turn_that_is() -> None:
    same = log(5.0 + 0.5 * np.sin(TIME), 5.0 + 0.5 * np.sin(TIME + 0.1))
    found, notes = without_wraps({"wrist": Way(slides=False, range=(-math.tau, math.tau))}, {"wrist": "servo"}, [same])
    assert (found, notes) == ([same], [])
