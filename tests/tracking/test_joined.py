# SPDX-License-Identifier: Apache-2.0
"""Poses that are told in several frames, as where odometry is reset: one way again, and nothing else is moved."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.recording import Channel, Recording
from trueup.samples import wrapped
from trueup.tracking.cleaned import cleaned

STEP, NOISE = 0.05, 0.004  # s, m
TIME = STEP * np.arange(600, dtype=np.float64)


def _way(speed: Array) -> Array:
    """(T, 3) x, y and yaw of a robot that winds at this speed in m/s."""
    yaw = np.cumsum(STEP * 0.9 * np.sin(0.6 * TIME))
    return np.stack([np.cumsum(STEP * speed * np.cos(yaw)), np.cumsum(STEP * speed * np.sin(yaw)), yaw], axis=1)


def _drive(way: Array, speed: Array) -> Recording:
    """The log of a way, with the speed of its wheels."""
    rng = np.random.default_rng(0)
    channels = (
        Channel("command", ("throttle", "steering"), "", TIME, np.stack([0.1 * speed, 0.0 * speed], axis=1)),
        Channel("position", ("x", "y"), "m", TIME, way[:, :2] + rng.normal(0.0, NOISE, (len(TIME), 2))),
        Channel("heading", ("heading",), "rad", TIME, wrapped(way[:, 2:] + rng.normal(0.0, NOISE, (len(TIME), 1)))),
        Channel("speed", ("speed",), "m/s", TIME, speed[:, None]),
    )
    return Recording("drive", {c.name: c for c in channels})


def _in_another_frame(way: Array, first: int, turn: float, shift: tuple[float, float]) -> Array:
    """The way as it is told from row `first` on after its frame was turned about that place and moved."""
    told = way.copy()
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    told[first:, :2] = (way[first:, :2] - way[first, :2]) @ rotation.T + way[first, :2] + shift
    told[first:, 2] += turn
    return told


def _off(found: Recording, way: Array) -> tuple[float, float]:
    """How far pose and heading are from a way at most, in m and rad."""
    place = np.linalg.norm(found.channel("position").values - way[:, :2], axis=1)
    return float(place.max()), float(np.abs(wrapped(found.channel("heading").values[:, 0] - way[:, 2])).max())


def _warnings(found: Recording) -> str:
    return found.provenance.get("warnings", "")


@pytest.mark.parametrize(("turn", "shift"), [(-1.3, (-4.0, 2.0)), (0.05, (0.07, -0.12)), (0.0, (0.4, 0.3))])
def test_a_pose_that_is_told_in_another_frame_goes_on_as_the_robot_drove(
    turn: float, shift: tuple[float, float]
) -> None:
    """Odometry that is reset, a localisation that is set right, a receiver that fixes its carrier phase."""
    speed = 0.6 + 0.3 * np.sin(0.9 * TIME)
    way = _way(speed)
    found = cleaned(_drive(_in_another_frame(way, 330, turn, shift), speed))
    place, heading = _off(found, way)
    assert place < 0.05  # 4 m further, which are 15 mrad
    assert heading < 0.03
    assert "the pose jumps (16.5 s after its first sample)" in _warnings(found)


def test_a_compass_turns_its_frame_the_same_way_round() -> None:
    """What was recorded grows to the right; what is moved is not turned the wrong way."""
    speed = 0.6 + 0.3 * np.sin(0.9 * TIME)
    way = _way(speed)
    drive = _drive(_in_another_frame(way, 330, 0.8, (1.0, 1.0)), speed)
    compass = drive.channel("heading")
    found = cleaned(drive.with_channel(compass.replace(values=wrapped(0.5 * np.pi - compass.values))))
    assert _off(found, way)[0] < 0.05


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("rows", [1, 8, 40])
def test_what_a_tracker_shows_for_a_while_before_it_comes_back_is_no_new_frame(rows: int, known: bool) -> None:
    """Markers that changed places: taken for a jump there and another back, each with an error of its own, for ever."""
    speed = 0.6 + 0.3 * np.sin(0.9 * TIME)
    way = _way(speed)
    told, away = way.copy(), np.zeros(len(TIME), dtype=bool)
    for first, aside in ((120, (0.2, 0.2)), (220, (-0.17, 0.1)), (400, (0.1, -0.2))):
        told[first : first + rows, :2] += aside
        away[first : first + rows] = True
    drive = _drive(told, speed)
    drive = drive.replace(
        channels={n: c for n, c in drive.channels.items() if n != "speed" and (known or n != "heading")}
    )
    found = cleaned(drive)
    off = np.linalg.norm(found.channel("position").values - way[:, :2], axis=1)
    assert np.isnan(off[away]).all()
    assert np.mean(np.isnan(off[~away])) < 0.02
    assert np.nanmax(off) < 0.05
    assert "jump away" in _warnings(found)
    assert "moved to where the drive went on" not in _warnings(found)


def test_neither_hard_braking_nor_a_sample_that_is_off_is_a_jump() -> None:
    ago = TIME % 6.0  # up to 4 m/s at 4 m/s^2, and down again at 8
    speed = np.where(ago < 3.0, np.minimum(4.0 * ago, 4.0), np.maximum(4.0 - 8.0 * (ago - 3.0), 0.0))
    way = _way(speed)
    way[[150, 310], :2] += [0.1, -0.1]
    found = cleaned(_drive(way, speed))
    assert "jumps" not in _warnings(found)


def test_a_tracker_that_loses_the_robot_and_finds_it_again_has_one_frame() -> None:
    speed = 0.6 + 0.3 * np.sin(0.9 * TIME)
    way = _way(speed)
    lost = way.copy()
    lost[200:230, :2] = 7.0
    found = cleaned(_drive(lost, speed))
    places = found.channel("position").values
    assert np.isnan(places[200:230]).all()
    assert np.nanmax(np.abs(places - way[:, :2])) < 0.03
    assert "jumps " not in _warnings(found)


def test_a_place_that_is_repeated_until_the_robot_is_far_away_is_no_place_where_it_stood() -> None:
    """A logger that writes the last fix on through an outage; where a robot stands it goes on from there."""
    speed = np.where((TIME > 20.0) & (TIME < 24.0), 0.0, 2.0)
    way = _way(speed)
    drive = _drive(way, speed).without("speed").without("heading")
    points = np.array(drive.channel("position").values)
    stands, lost = (TIME > 20.0) & (TIME < 24.0), (TIME > 8.0) & (TIME < 16.0)
    points[stands] = points[np.argmax(stands)]
    points[lost] = points[np.argmax(lost)]
    found = cleaned(drive.with_channel(drive.channel("position").replace(values=points))).channel("position").values
    known = np.isfinite(found[:, 0])
    assert not known[lost][1:].any()
    assert known[stands].all()
    assert known[~lost].mean() > 0.9


@pytest.mark.parametrize("shift", [(1.1, 1.1), (-1.1, 0.9), (-0.7, -0.8)])
def test_a_receiver_of_few_fixes_that_jumps_less_far_than_a_vehicle_drives_is_seen_to_jump(
    shift: tuple[float, float],
) -> None:
    """A metre or two within 0.2 s, at 2 m/s; poses behind are moved to where the drive went on, or left out."""
    speed, late = np.full(len(TIME), 2.0), 0.06 * np.random.default_rng(1).random(150)
    way = _way(speed)
    told = _in_another_frame(way, 300, 0.0, shift)
    drive = _drive(told, speed).without("speed").without("heading")
    slow = {
        c.name: c.replace(
            time=c.time[::4] + late, values=c.values[::4] + np.random.default_rng(2).normal(0.0, 0.02, (150, 2))
        )
        for c in (drive.channel("position"),)
    }
    found = cleaned(drive.replace(channels={**drive.channels, **slow})).channel("position").values
    still = cleaned(_drive(way, speed).without("speed").without("heading")).channel("position").values
    off = np.linalg.norm(found - way[::4, :2], axis=1)
    before, behind = np.isfinite(off[:75]).mean(), np.isfinite(off[75:]).mean()
    assert max(before, behind) > 0.85
    assert np.nanstd(off) < 0.1  # one frame for all that is left
    assert np.isfinite(still[:, 0]).mean() > 0.95


def test_poses_that_were_not_measured_are_not_said_to_jump() -> None:
    speed = 0.6 + 0.3 * np.sin(0.9 * TIME)
    way = _way(speed)
    way[200:240] = np.nan
    assert "jump away" not in _warnings(cleaned(_drive(way, speed)))
