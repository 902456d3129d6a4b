# SPDX-License-Identifier: Apache-2.0
"""The stand-in vehicle: obeys mechanics, differs from its simulator, and hands back what a robot would."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from trueup.errors import RecordingError, TrialAbortedError, UnknownNameError
from trueup.paths.courses import hairpin
from trueup.recording import Channel
from trueup.robots.stand_in_vehicle import StandInVehicle, VehicleTruth
from trueup.tasks.follow_path import FollowPath
from trueup.tasks.task import robot_scores, robot_trials
from trueup.trial import Observed, Trial

QUIET = dataclasses.replace(
    VehicleTruth(), position_noise=0.0, heading_noise=0.0, drift=0.0, latency=0.0, steering_offset=0.0, wheel_scale=1.0,
    steering_scale=1.0, steering_slack=0.0,
)  # fmt: skip


def circle(truth: VehicleTruth, speed: float, steering: float) -> float:
    """Curvature in 1/m of the steady circle."""
    time = np.arange(1001) / 50.0
    command = Channel("command", ("speed", "steering"), "", time, np.tile([speed, steering], (len(time), 1)))
    observed = {"position": Observed(("x", "y"), "m", time), "heading": Observed(("heading",), "rad", time)}
    (run,) = StandInVehicle(truth).perform(Trial("circle", 0.0, 20.0, command, observed))
    heading = run.channel("heading").values[:, 0]
    gone = np.hypot(*np.diff(run.channel("position").values[-300:], axis=0).T).sum()
    return float((heading[-1] - heading[-300]) / gone)


def test_with_stiff_tyres_it_drives_the_circle_of_its_geometry() -> None:
    stiff = dataclasses.replace(QUIET, front_stiffness=3000.0, rear_stiffness=3000.0, forward=0.275, friction=5.0)
    assert circle(stiff, 0.3, 0.2) == pytest.approx(np.tan(0.2) / 0.55, rel=0.01)


def test_it_understeers_when_the_front_tyres_are_softer() -> None:
    soft = dataclasses.replace(QUIET, front_stiffness=400.0, rear_stiffness=1500.0, forward=0.275)
    gradient = 50.0 / 0.55 * (0.275 / 400.0 - 0.275 / 1500.0)  # rad s^2/m, linear theory
    expected = 1.0 / (1.0 + gradient * 0.8**2 / 0.55)
    assert circle(soft, 0.8, 0.15) / circle(soft, 0.2, 0.15) == pytest.approx(expected, rel=0.02)


def test_each_seed_is_a_robot_of_its_own() -> None:
    rows = np.array([VehicleTruth.of_seed(s).row for s in range(20)])
    assert len(np.unique(rows[:, 8])) == 20
    assert VehicleTruth.of_seed(3) == VehicleTruth.of_seed(3)


def test_it_follows_a_path_with_the_gains_of_the_trial() -> None:
    task = FollowPath([hairpin((0.6,))], names=("k1", "k2", "k3", "lead"))
    robot = StandInVehicle(1)
    scores = [robot_scores(task, [robot.perform(t) for t in robot_trials(task, np.array(v))])[0]
              for v in ([1.0, 1.0, 1.0, 0.0], [2.0, 2.0, 2.0, 0.25])]  # fmt: skip
    assert 0.005 < scores[1] < 0.5 * scores[0] < 0.1


def test_noise_is_what_the_truth_says() -> None:
    robot = StandInVehicle(dataclasses.replace(QUIET, position_noise=0.008, heading_noise=0.003))
    task = FollowPath([hairpin((0.6,))])
    drive = robot.drive(task.trials[0], np.ones((2, 3)))
    apart = drive.measured - drive.truth
    assert apart[:, :, 0].std() == pytest.approx(0.008, rel=0.05)
    assert apart[:, :, 2].std() == pytest.approx(0.003, rel=0.05)
    assert not np.array_equal(drive.measured[0], drive.measured[1])


def test_a_run_that_is_stopped_leaves_no_recording_and_says_so() -> None:
    trial = robot_trials(FollowPath([hairpin((0.6,))]), np.ones(3))[0]
    with pytest.raises(TrialAbortedError, match="stood in the way after"):
        StandInVehicle(0, failing=1.0).perform(trial)
    (run,) = StandInVehicle(0, failing=0.0).perform(trial)
    assert run.provenance["settings"] == "k1=1 k2=1 k3=1"


def test_repeats_are_recordings_of_their_own() -> None:
    trial = dataclasses.replace(FollowPath([hairpin((0.6,))]).trials[0], repeats=2)
    first, second = StandInVehicle(0).perform(trial)
    assert first.name != second.name
    assert not np.array_equal(first.channel("position").values, second.channel("position").values)


def test_what_it_cannot_do_is_refused() -> None:
    time = np.zeros(1)
    with pytest.raises(RecordingError, match="neither a reference 'path' nor a command"):
        StandInVehicle(0).perform(Trial("nothing", 0.0, 1.0, None, {"position": Observed(("x", "y"), "m", time)}))
    with pytest.raises(UnknownNameError, match="channel 'torque'"):
        StandInVehicle(0).perform(Trial("odd", 0.0, 1.0, None, {"torque": Observed(("x",), "N m", time)}))
