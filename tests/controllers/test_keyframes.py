# SPDX-License-Identifier: Apache-2.0
"""Keyframed motions: they pass where they were told to, when they were told to, and nowhere beyond."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from trueup.controllers.controller import Observation
from trueup.controllers.keyframes import Degree, Motion, mirrored, pitch_of
from trueup.errors import ParameterError, UnknownNameError

Array = NDArray[np.float64]
JOINTS = ("l_hip", "r_hip", "l_knee", "r_knee", "neck")


def motion(**changes: Any) -> Motion:
    plain = Motion(
        JOINTS, first=np.zeros(5), last=np.array([0.2, 0.2, 0.6, 0.6, -0.4]),
        degrees=(*mirrored(("hip",), "l_", "r_"), Degree("knee", ("l_knee", "r_knee"), (1.0, -1.0))),
        seeds=np.array([[0.5, 0.3], [-0.2, 0.8]]), intervals=np.array([0.2, 0.3, 0.5]),
        lower=np.full(5, -1.5), upper=np.full(5, 1.5),
    )  # fmt: skip
    return replace(plain, **changes)


def seen(time: float, count: int, tilt: float = 0.0, rate: float = 0.0) -> Observation:
    position, velocity = np.zeros((count, 7)), np.zeros((count, 6))
    position[:, 3], position[:, 5] = np.cos(tilt / 2), np.sin(tilt / 2)
    velocity[:, 4] = rate
    return Observation(time, position, velocity, {})


def driven(plan: Motion, values: Array, times: Array) -> Array:
    controller = plan.controller(values)
    controller.reset(seen(0.0, len(values)))
    return np.stack([controller.command(seen(float(t), len(values))) for t in times], axis=1)


@pytest.mark.parametrize("interpolation", ["linear", "smooth"])
def test_every_row_passes_its_own_keyframes_at_its_own_times(interpolation: str) -> None:
    plan = motion(interpolation=interpolation)
    rng = np.random.default_rng(0)
    values = plan.parameters().from_unit(rng.uniform(size=(6, len(plan.parameters()))))
    poses, times = plan.knots(values)
    for row in range(6):
        passed = driven(plan, values, times[row])[row]
        np.testing.assert_allclose(passed, poses[row], atol=1e-12)
    np.testing.assert_array_equal(poses[:, 0], np.zeros((6, 5)))
    np.testing.assert_allclose(driven(plan, values, np.array([9.0]))[:, 0], np.tile(plan.last, (6, 1)))


def test_linear_motion_is_that_of_interp() -> None:
    plan, grid = motion(), np.linspace(0.0, 1.2, 97)
    poses, times = plan.knots(plan.nominal[None])
    wanted = np.stack([np.interp(grid, times[0], poses[0, :, j]) for j in range(5)], axis=1)
    np.testing.assert_allclose(driven(plan, plan.nominal[None], grid)[0], wanted, atol=1e-12)


def test_smooth_motion_keeps_between_neighbouring_keyframes_and_agrees_with_scipy_inside() -> None:
    plan = motion(interpolation="smooth", seeds=np.array([[0.1, 0.2], [0.15, 0.5]]))
    poses, times = plan.knots(plan.nominal[None])
    grid = np.linspace(0.0, times[0, -1], 400)
    path = driven(plan, plan.nominal[None], grid)[0]
    for k in range(3):
        inside = (grid >= times[0, k]) & (grid <= times[0, k + 1])
        low, high = np.minimum(poses[0, k], poses[0, k + 1]), np.maximum(poses[0, k], poses[0, k + 1])
        assert np.all(path[inside] >= low - 1e-9)
        assert np.all(path[inside] <= high + 1e-9)
    # Only the ends differ: ours start and stop at rest.
    middle = (grid >= times[0, 1]) & (grid <= times[0, 2])
    np.testing.assert_allclose(path[middle], PchipInterpolator(times[0], poses[0])(grid)[middle], atol=1e-9)
    speed = np.gradient(path, grid, axis=0)
    assert np.abs(speed[[0, -1]]).max() < 0.05 * np.abs(speed).max()


def test_sides_are_symmetric_with_their_signs_and_others_go_evenly() -> None:
    plan = motion()
    poses, times = plan.knots(plan.nominal[None])
    np.testing.assert_array_equal(poses[0, 1:-1, 0], poses[0, 1:-1, 1])
    np.testing.assert_array_equal(poses[0, 1:-1, 2], -poses[0, 1:-1, 3])
    np.testing.assert_allclose(poses[0, :, 4], -0.4 * times[0] / times[0, -1])


def test_what_is_searched_keeps_within_the_range_of_all_joints_of_a_degree() -> None:
    plan = motion(upper=np.array([1.5, 0.6, 1.5, 1.5, 1.5]), lower=np.array([-1.5, -1.5, -1.5, -0.9, -1.5]))
    space = plan.parameters()
    assert space["keyframe1.hip"].upper == 0.6
    assert space["keyframe2.knee"].upper == 0.9  # the right knee turns the other way
    assert space.names[-3:] == ("interval1", "interval2", "interval3")


def test_a_keyframe_outside_its_joint_is_named_with_value_and_range() -> None:
    with pytest.raises(ParameterError, match=r"keyframe 2: joint 'l_knee' at 0\.8 rad .* \.\.\. 0\.7 rad"):
        motion(upper=np.array([1.5, 1.5, 0.7, 1.5, 1.5]))
    with pytest.raises(UnknownNameError, match="l_knee"):
        motion(degrees=(Degree("hip", ("l_hip", "hip_r")), Degree("knee", ("l_knee",))))
    with pytest.raises(ParameterError, match=r"3 intervals"):
        motion(seeds=np.zeros((1, 2)))


def test_the_time_alone_can_be_searched() -> None:
    plan = motion(seeds=np.zeros((0, 2)), intervals=np.array([0.1]))
    assert plan.parameters().names == ("interval1",)
    np.testing.assert_allclose(driven(plan, np.array([[0.4]]), np.array([0.2]))[0, 0], 0.5 * plan.last)


def test_feedback_adds_in_proportion_to_tilt_and_rate_on_both_sides() -> None:
    plan = motion(feedback={"knee": (2.0, 0.5)})
    values = np.tile(plan.nominal, (2, 1))
    values[1, -2:] = [1.5, 0.2]
    controller = plan.controller(values, tilt=pitch_of())
    upright, tilted = controller.command(seen(0.1, 2)), controller.command(seen(0.1, 2, 0.3, -1.0))
    np.testing.assert_allclose(tilted[0], upright[0])
    added = 1.5 * 0.3 - 0.2
    np.testing.assert_allclose(tilted[1] - upright[1], [0.0, 0.0, added, -added, 0.0], atol=1e-12)


def test_what_a_robot_is_sent_is_what_the_simulator_plays() -> None:
    plan = motion()
    channel = plan.command(plan.nominal, rate=100.0, lasting=0.5)
    assert channel.labels == JOINTS
    assert channel.time[-1] == pytest.approx(1.5)
    np.testing.assert_allclose(channel.values, driven(plan, plan.nominal[None], channel.time)[0], atol=1e-12)
    assert plan.fastest(plan.nominal)["l_hip"] == pytest.approx(0.5 / 0.2)


def test_feedback_leads_no_joint_beyond_its_range() -> None:
    plan = motion(feedback={"knee": (2.0, 0.5)})
    values = plan.nominal[None].copy()
    values[0, -2:] = 2.0, 0.0
    commanded = plan.controller(values, tilt=pitch_of()).command(seen(0.1, 1, 1.4))
    assert commanded[0, 2] == 1.5
    assert np.all(np.abs(commanded) <= 1.5)


@pytest.mark.parametrize("interpolation", ["linear", "smooth"])
def test_no_motion_is_faster_than_its_servos_on_the_way_either(interpolation: str) -> None:
    speeds = np.array([3.0, 3.0, 4.0, 4.0, np.inf])
    plan = motion(interpolation=interpolation, speeds=speeds, intervals=np.array([0.6, 0.6, 0.6]))
    values = plan.parameters().from_unit(np.random.default_rng(0).uniform(size=(20, len(plan.parameters()))))
    grid = np.arange(0.0, plan.latest, 1e-3)
    paths = driven(plan, values, grid)
    fastest = np.abs(np.diff(paths, axis=1) / 1e-3).max(axis=1)
    assert np.all(fastest[:, :4] <= speeds[:4] + 1e-6)
    assert np.all(fastest.max(axis=0)[:4] > 0.8 * speeds[:4])
