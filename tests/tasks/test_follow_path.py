# SPDX-License-Identifier: Apache-2.0
"""Path following as a task: distances that geometry gives, and the same score for robots and simulators."""

from __future__ import annotations

import re

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.controllers.controller import Observation
from trueup.controllers.stanley import StanleySettings
from trueup.engines.vehicle import BicycleSimulator, Vehicle, vehicle_space
from trueup.errors import ParameterError, UnknownNameError
from trueup.parameters import Parameter, ParameterSpace
from trueup.paths import Path
from trueup.paths.courses import hairpin
from trueup.recording import Channel, Recording
from trueup.robots.stand_in_vehicle import StandInVehicle
from trueup.tasks.follow_path import FollowPath, too_tight
from trueup.tasks.task import as_rollout, robot_doubts, robot_scores, robot_trials, simulated_scores, unit_of

STRAIGHT = Path.from_points("straight", [[0.0, 0.0], [10.0, 0.0]], speed=0.5)


def drive(task: FollowPath, beside: float, until: float = 10.0, pause: float = 0.0) -> Recording:
    """A robot that keeps `beside` m to the left of the straight, and waits for `pause` s in between."""
    time = task.trials[0].observed["position"].time
    x = np.minimum(0.5 * (time - np.clip(time - 4.0, 0.0, pause)), until)
    xy = np.stack([x - 0.55, np.full_like(x, beside)], axis=1)
    still = np.zeros((len(time), 1))
    return Recording("run", {
        "position": Channel("position", ("x", "y"), "m", time, xy),
        "heading": Channel("heading", ("heading",), "rad", time, still),
        "speed": Channel("speed", ("speed",), "m/s", time, still),
        "command": Channel("command", ("speed", "steering"), "", time, np.zeros((len(time), 2))),
    })  # fmt: skip


@pytest.mark.parametrize("measure", ["rms", "mean", "max"])
def test_a_constant_offset_is_its_own_error_whatever_the_pace(measure: str) -> None:
    task = FollowPath([STRAIGHT], measure=measure)
    runs = [drive(task, 0.07), drive(task, -0.07, pause=2.0)]
    np.testing.assert_allclose(task.score([as_rollout(task.trials[0], runs)]), 0.07, rtol=1e-6)


def test_what_of_a_path_was_not_reached_counts_with_how_far_on_it_lies_a_metre_at_most() -> None:
    task = FollowPath([STRAIGHT], measure="mean")
    (score,) = robot_scores(task, [[drive(task, 0.0, until=7.0)]])
    assert score == pytest.approx((0.5 + 2.0) / 10.0, abs=0.01)
    (score,) = robot_scores(FollowPath([STRAIGHT]), [[drive(task, 0.0, until=7.0)]])
    assert score == pytest.approx(np.sqrt((1 / 3 + 2.0) / 10.0), abs=0.01)


@pytest.mark.parametrize("measure", ["rms", "mean"])
def test_a_log_that_ends_a_hands_breadth_early_scores_as_one_that_does_not_and_is_told_of(measure: str) -> None:
    task = FollowPath([STRAIGHT], measure=measure)
    runs = [drive(task, 0.006), drive(task, 0.006, until=9.94)]
    rollouts = [as_rollout(task.trials[0], runs)]
    whole, early = task.score(rollouts)
    assert whole == pytest.approx(0.006, rel=1e-6)
    assert early == pytest.approx(whole, rel=0.1)
    ((said,),) = task.doubts(rollouts)
    assert "the last 0.06 m of path 'straight' were not reached" in said


def test_stopping_short_never_pays() -> None:
    task = FollowPath([STRAIGHT])
    runs = [drive(task, 0.3, until=u) for u in (10.0, 9.9, 9.5, 9.0, 5.0)]
    scores = task.score([as_rollout(task.trials[0], runs)])
    assert (np.diff(scores) > -1e-9).all()


def test_the_rear_axle_need_not_be_where_the_front_axle_is_at_the_end() -> None:
    task = FollowPath([STRAIGHT], point="rear")
    rollouts = [as_rollout(task.trials[0], [drive(task, 0.07)])]
    np.testing.assert_allclose(task.score(rollouts), 0.07, rtol=0.02)
    assert task.doubts(rollouts) == ((),)


def test_robot_and_simulator_are_scored_alike() -> None:
    task = FollowPath([hairpin((0.6,))])
    vehicle = Vehicle("same", 0.55, 0.698)
    simulator = BicycleSimulator(vehicle, vehicle_space(vehicle, ("steering_delay",)))
    gains = np.array([[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]])
    scores = simulated_scores(task, simulator, np.array([[0.1], [0.3]]), gains)
    rows = np.array([[0.3, *gains[1]]])
    (rollout,) = simulator.rollout(task.trials, rows, task.controllers)
    np.testing.assert_allclose(robot_scores(task, [[rollout.recording()]])[0], scores[1, 1], rtol=1e-12)
    assert scores[1, 0] > scores[0, 0], "later steering is worse"


def test_a_failed_simulation_has_no_score() -> None:
    task = FollowPath([STRAIGHT])
    simulator = BicycleSimulator(
        Vehicle("v", 0.55, 0.698), vehicle_space(Vehicle("v", 0.55, 0.698), ("steering_delay",))
    )
    scores = simulated_scores(task, simulator, np.array([[0.1], [np.nan]]), np.ones((1, 3)))
    assert np.isfinite(scores[0, 0])
    assert np.isnan(scores[1, 0])


def test_the_robot_is_told_its_gains_by_name() -> None:
    task = FollowPath([STRAIGHT, hairpin((0.5,))], names=("k1", "lead"), nominal={"k1": 2.0})
    trials = robot_trials(task, np.array([1.5, 0.1]), ", try 1")
    assert [t.name for t in trials] == ["straight, try 1", "hairpin, try 1"]
    assert dict(trials[0].settings) == {"k1": 1.5, "lead": 0.1}
    assert task.parameters.nominal.tolist() == [2.0, 0.0]


def test_what_cannot_be_judged_is_refused() -> None:
    with pytest.raises(ParameterError, match="at least one path"):
        FollowPath([])
    with pytest.raises(UnknownNameError, match="measure 'rmse'"):
        FollowPath([STRAIGHT], measure="rmse")
    with pytest.raises(UnknownNameError, match="parameter 'k4'"):
        FollowPath([STRAIGHT], names=("k4",))


def test_no_path_rules_over_the_others() -> None:
    """Halving the error of the path that is followed well is worth as much as of the one that is not."""
    task = FollowPath([STRAIGHT, STRAIGHT])

    def score(*apart: float) -> float:
        rollouts = [as_rollout(task.trials[0], [drive(task, d)]) for d in apart]
        return float(task.score(rollouts)[0])

    assert score(0.02, 0.2) == pytest.approx(np.sqrt(0.02 * 0.2), rel=1e-6)
    assert score(0.01, 0.2) == pytest.approx(score(0.02, 0.1), rel=1e-6)
    assert score(0.05, 0.05) == pytest.approx(0.05, rel=1e-6)


def test_whoever_drives_is_told_the_frame_and_at_which_speeds_each_gain_acts() -> None:
    task = FollowPath([STRAIGHT], StanleySettings(wheelbase=0.4, edges=(1.5, 3.0)), names=("k1", "k2", "lead"))
    (trial,) = robot_trials(task, task.parameters.nominal)
    assert [(p.name, p.unit, p.source) for p in trial.tuned][:2] == [
        ("k1", "1/s", "cross-track gain below 1.5 m/s"), ("k2", "1/s", "cross-track gain from 1.5 to 3 m/s"),
    ]  # fmt: skip
    assert "rear axle" in " ".join(trial.notes)
    assert "0.4 m" in " ".join(trial.notes)
    assert "Keep the log going until that point is passed" in " ".join(trial.notes)
    assert unit_of(task) == "m"


def test_gains_are_searched_between_the_bounds_that_the_plan_gives() -> None:
    task = FollowPath([STRAIGHT], names=("k1", "k3"), nominal={"k3": 8.0}, ranges={"k3": (0.1, 20.0)})
    assert [p.lower for p in task.parameters.parameters] == [0.05, 0.1]
    assert [p.upper for p in task.parameters.parameters] == [5.0, 20.0]
    with pytest.raises(UnknownNameError, match="range of parameter 'k2'"):
        FollowPath([STRAIGHT], names=("k1",), ranges={"k2": (0.1, 20.0)})


def test_a_run_that_was_steered_otherwise_than_asked_for_is_told_of() -> None:
    task = FollowPath([hairpin((0.6,))], names=("k1", "k2", "k3", "lead"))
    today, tuned = task.parameters.nominal, np.array([3.0, 4.0, 4.0, 0.3])
    robot = StandInVehicle(3, task.settings, seed=0)
    for driven in (today, tuned):
        runs = [robot.perform(t) for t in robot_trials(task, driven, f"{driven}")]
        assert robot_doubts(task, runs, driven) == ((),)
        assert robot_doubts(task, runs) == ((),)
    runs = [robot.perform(t) for t in robot_trials(task, today, "not set")]
    ((said,),) = robot_doubts(task, runs, tuned)
    assert "what the law commands with the settings of today" in said
    turned = [[r.replace(channels={n: c.replace(values=-c.values) if n == "command" else c for n, c in r.channels.items()})
               for r in repeats] for repeats in runs]  # fmt: skip
    ((said,),) = robot_doubts(task, turned, today)
    assert "is this the log of this run" in said


def test_a_robot_that_stops_just_short_of_the_end_is_not_said_to_steer_otherwise() -> None:
    """By the noise of a pose one law is beyond the path's end and another, from samples between, is not."""
    task = FollowPath([STRAIGHT])
    run = drive(task, 0.0, until=9.9)
    position, command = run.channel("position"), run.channel("command")
    drives = position.values[:, :1] < 9.9 - 0.55
    aside = position.replace(values=np.where(drives, position.values, position.values + np.array([0.0, 0.2])))
    told = command.replace(values=np.where(drives, [0.5, 0.0], [0.0, 0.0]))
    stopped = run.replace(channels={**run.channels, "position": aside, "command": told})
    ((said,),) = robot_doubts(task, [[stopped]], task.parameters.nominal)
    assert "were not reached" in said


def test_a_path_that_no_steering_can_follow_is_named() -> None:
    """A front axle on a circle steers by the arc sine of wheelbase over radius."""
    angle = np.linspace(0.0, 3.0, 200)
    circle = Path.from_points("circle", 2.0 * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1), speed=0.5)
    assert too_tight(circle, StanleySettings(wheelbase=0.9, max_steering=np.arcsin(0.46))) == ""
    said = too_tight(circle, StanleySettings(wheelbase=0.9, max_steering=np.arcsin(0.4)))
    assert re.search(r"'circle' turns more tightly than the vehicle can along 5\.\d+ of its 6 m \(radius 2 m", said)
    assert "drives 2.25 m)" in said
    rounded = Path.from_points("rounded", np.round(circle.points, 3), speed=0.5)
    assert too_tight(rounded, StanleySettings(wheelbase=0.9, max_steering=np.arcsin(0.46))) == ""
    corner = Path.from_points("corner", [[0.0, 0.0], [5.0, 0.0], [5.0, 5.0]], speed=0.5)
    assert too_tight(corner, StanleySettings()) == "", "a corner is no stretch of road"
    back = Path.from_points("back", [[0.0, 0.0], [5.0, 0.0], [2.0, 0.0]])
    assert "turns back on itself near x = 4." in too_tight(back, StanleySettings())


def test_a_path_in_degrees_is_no_path_in_metres() -> None:
    with pytest.raises(ParameterError, match=r"is 0.0001 m long, less than the vehicle .* are its numbers metres"):
        FollowPath([Path.from_points("earth", [[48.1, 11.5], [48.1001, 11.5]])])


class Aiming:
    """A law of a user's own: steers in proportion to how far aside the path's height y = 0 lies."""

    period = 0.02

    def __init__(self, values: Array) -> None:
        self.pull = values[:, 0]

    def reset(self, observation: Observation) -> None:
        """It remembers nothing."""

    def command(self, observation: Observation) -> Array:
        """(b, 2) m/s and rad."""
        return np.column_stack([np.full_like(self.pull, 0.5), -self.pull * observation.position[:, 1]])


class Aimed(FollowPath):
    """The same task for that law."""

    def __init__(self) -> None:
        super().__init__([STRAIGHT])
        self.parameters = ParameterSpace((Parameter("pull", "rad/m", 1.0, 0.0, 9.0),))

    def controllers(self, values: Array) -> Aiming:
        """The law of b copies."""
        return Aiming(values)


def test_a_law_of_ones_own_is_simulated_and_its_runs_are_compared_with_it() -> None:
    task = Aimed()
    vehicle = Vehicle("car", 0.55, 0.698)
    simulator = BicycleSimulator(vehicle, vehicle_space(vehicle, ("steering_delay",)))
    assert simulated_scores(task, simulator, np.array([[0.1]]), np.array([[1.0]]))[0, 0] < 0.01
    run = drive(task, 0.1)
    command = run.channel("command")

    def steered(pull: float) -> Recording:
        return run.with_channel(command.replace(values=np.tile([0.5, -0.1 * pull], (len(command.time), 1))))

    assert robot_doubts(task, [[steered(4.0)]], np.array([4.0])) == ((),)
    ((said,),) = robot_doubts(task, [[steered(1.0)]], np.array([4.0]))
    assert "with the settings of today" in said
