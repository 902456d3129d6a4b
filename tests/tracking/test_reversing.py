# SPDX-License-Identifier: Apache-2.0
"""A vehicle that backs off where nothing but its way tells the heading: its nose stays where it was."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.recording import Channel, Recording
from trueup.samples import wrapped
from trueup.tracking.cleaned import cleaned

STEP = 0.02  # s
TIME = STEP * np.arange(3000, dtype=np.float64)
LATE = 60  # samples until the vehicle has stopped and goes the other way
RNG = np.random.default_rng(0)


def _driven() -> tuple[Recording, Array]:
    """A log with a course over ground (compass, degrees) beside fixes at 5 Hz, and (T,) the true heading."""
    told = np.where((TIME % 20.0 > 12.0) & (TIME % 20.0 < 17.0), -0.8, 1.2)
    speed = np.convolve(np.pad(told, (LATE, 0), mode="edge"), np.ones(LATE) / LATE, mode="full")[: len(TIME)]
    speed *= np.clip(TIME - 1.0, 0.0, 1.0)
    heading = 0.4 + np.cumsum(STEP * speed * 0.3 * np.sin(0.5 * TIME))
    way = np.cumsum(STEP * speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    over_ground = np.where(speed < 0.0, heading + np.pi, heading)
    over_ground[speed == 0.0] = 2.0  # nothing moves: whatever the receiver says
    slow = slice(None, None, 10)
    fixes = (way + RNG.normal(0.0, 0.01, way.shape))[slow]
    channels = (
        Channel("command", ("speed", "steering"), "", TIME, np.stack([told, 0.0 * told], axis=1), ("m/s", "rad")),
        Channel("position", ("x", "y"), "m", TIME[slow], fixes),
        Channel("heading", ("heading",), "rad", TIME[slow], (0.5 * np.pi - over_ground)[slow, None] % (2.0 * np.pi)),
        Channel("yaw_rate", ("yaw_rate",), "rad/s", TIME, np.gradient(heading, TIME)[:, None] + 0.004),
    )
    return Recording("drive", {c.name: c for c in channels}), heading[slow]


@pytest.mark.parametrize("without", [("yaw_rate",), ("heading",), ("heading", "yaw_rate")])
def test_backing_off_turns_no_heading_that_the_way_tells(without: tuple[str, ...]) -> None:
    """A course over ground, a gyroscope set right by the way, and the way alone."""
    recording, truth = _driven()
    for name in without:
        recording = recording.without(name)
    found = cleaned(recording)
    off = np.abs(wrapped(found.channel("heading").values[:, 0] - truth))
    moving = (TIME[::10] > 3.0) & np.isfinite(off)
    assert moving.mean() > 0.9
    assert np.mean(off[moving] < 0.3) > 0.95
    assert ("is the direction of motion: turned round" in found.provenance["warnings"]) == ("heading" not in without)


def test_a_heading_of_the_robots_own_is_left_as_it_is_where_it_backs_off() -> None:
    recording, truth = _driven()
    own = recording.channel("heading").replace(values=truth[:, None])
    found = cleaned(recording.without("yaw_rate").with_channel(own))
    assert found.channel("heading").values[:, 0] == pytest.approx(np.unwrap(truth))


def test_a_robot_that_turns_round_where_it_stands_may_back_off_the_way_it_went_on() -> None:
    """The way goes straight on, the nose does not: taken for driving on, all poses behind had their heading wrong."""
    phase = TIME % 20.0
    speed = np.select([phase < 6.0, (phase > 10.0) & (phase < 16.0)], [0.8, -0.8], 0.0)
    turn = np.select([(phase > 7.0) & (phase < 9.0), (phase > 17.0) & (phase < 19.0)], [0.5 * np.pi, -0.5 * np.pi], 0.0)
    heading = np.cumsum(STEP * (turn + 0.2 * speed * np.sin(0.5 * TIME)))
    way = np.cumsum(STEP * speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    slow = slice(None, None, 10)
    channels = (
        Channel("command", ("speed", "turn"), "", TIME, np.stack([speed, turn], axis=1), ("m/s", "rad/s")),
        Channel("position", ("x", "y"), "m", TIME[slow], (way + RNG.normal(0.0, 0.01, way.shape))[slow]),
        Channel("yaw_rate", ("yaw_rate",), "rad/s", TIME, np.gradient(heading, TIME)[:, None]),
    )
    found = cleaned(Recording("drive", {c.name: c for c in channels}))
    off = np.abs(wrapped(found.channel("heading").values[:, 0] - heading[slow]))
    known = np.isfinite(off)
    assert known.mean() > 0.9
    assert np.mean(off[known] < 0.3) > 0.95
