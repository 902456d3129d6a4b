# SPDX-License-Identifier: Apache-2.0
"""A vehicle commanded by speed on tyres that slip: circles, swings and limits as single-track theory has them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from trueup.campaign.kinds import drives as calibrate_drives
from trueup.controllers.stanley import StanleySettings
from trueup.engines.vehicle import BicycleSimulator, Vehicle
from trueup.paths.courses import hairpin
from trueup.recording import Channel
from trueup.robots.stand_in_vehicle import StandInVehicle, VehicleTruth
from trueup.studies.stanley import chasi
from trueup.tasks.follow_path import FollowPath
from trueup.tasks.task import robot_scores, robot_trials, simulated_scores
from trueup.trial import Observed, Trial

WHEELBASE = 0.55


def run(speed: object, steering: object, duration: float = 8.0, step: float = 0.02, **values: float) -> np.ndarray:
    """(T, 5) x, y, heading, speed, yaw rate under commands at 50 Hz, from the first commanded speed on."""
    time = np.arange(round(duration * 50) + 1) / 50.0
    command = np.stack(np.broadcast_arrays(np.asarray(speed, float), np.asarray(steering, float), time)[:2], axis=1)
    labels = {"position": ("x", "y"), "heading": ("heading",), "speed": ("speed",), "yaw_rate": ("yaw_rate",)}
    zero, first = np.zeros(1), command[0, 0]
    trial = Trial(
        "played", 0.0, duration, Channel("command", ("speed", "steering"), "", time, command),
        {name: Observed(label, "", time) for name, label in labels.items()},
        initial={"position": Channel("position", ("x", "y"), "m", zero, np.zeros((1, 2))),
                 "heading": Channel("heading", ("heading",), "rad", zero, np.zeros((1, 1))),
                 "speed": Channel("speed", ("speed",), "m/s", zero, np.array([[first]]))},
    )  # fmt: skip
    vehicle = Vehicle("on tyres", WHEELBASE, 0.698, values)
    (rollout,) = BicycleSimulator(vehicle, step=step).rollout([trial], np.zeros((1, 0)))
    return np.concatenate([rollout.channels[name][0] for name in labels], axis=1)


@pytest.mark.parametrize("speed", [0.4, 0.9])
def test_a_steady_circle_has_the_curvature_and_the_slip_of_single_track_theory(speed: float) -> None:
    slip, more = 0.04, 0.03
    found = run(speed, 0.12, duration=20.0, rear_slip=slip, understeer=more, relaxation=0.2)
    turning = speed * np.tan(0.12) / (WHEELBASE * (1.0 + more * speed**2))
    assert found[-1, 4] == pytest.approx(turning, rel=0.01)
    (dx, dy), before = np.diff(found[-2:, :2], axis=0)[0], found[-2:, 2].mean()
    assert before - np.arctan2(dy, dx) + 2 * np.pi * round(
        (np.arctan2(dy, dx) - before) / (2 * np.pi)
    ) == pytest.approx(slip * speed * turning, rel=0.02), (
        "the rear axle moves outwards of where it points by its slip angle"
    )


def test_slow_tyres_swing_as_theory_says_at_any_speed() -> None:
    """With equal axles sigma r'' + v r' + r / slip = v delta / (L slip): a damped swing, counted by the way rolled."""
    slip, sigma, wheel = 0.04, 0.4, 0.02
    time = np.arange(401) / 50.0
    for speed in (0.5, 1.0):
        found = run(speed, np.where(time >= 1.0, wheel, 0.0), step=0.005, rear_slip=slip, relaxation=sigma)[:, 4]
        decay, omega = speed / (2.0 * sigma), np.sqrt(1.0 / (slip * sigma) - (speed / (2.0 * sigma)) ** 2)
        since = np.maximum(time - 1.0, 0.0)
        swing = np.exp(-decay * since) * (np.cos(omega * since) + decay / omega * np.sin(omega * since))
        expected = speed * wheel / WHEELBASE * (1.0 - swing)
        apart = np.abs(found - expected).max() / expected.max()
        assert apart < 0.05
        assert found.max() > 1.3 * found[-1], "a vehicle that rolls where it points never overshoots"


def test_stiff_tyres_roll_where_they_point_forwards_backwards_and_at_rest() -> None:
    wave = 0.4 * np.sin(np.arange(401) / 40.0)
    for speed in (0.6, -0.6, 0.0):
        rolling, stiff = run(speed, wave), run(speed, wave, rear_slip=1e-5)
        np.testing.assert_allclose(stiff[:, :3], rolling[:, :3], atol=0.02)


def test_tyres_give_no_more_than_their_friction() -> None:
    found = run(1.0, 0.5, duration=15.0, rear_slip=0.02, friction_limit=0.5)
    assert np.abs(found[-100:, 3] * found[-100:, 4]).max() < 0.5
    assert run(1.0, 0.5, rear_slip=0.02)[-1, 4] > 0.8


def test_a_drive_shows_slow_tyres_and_foretells_gains_that_a_rolling_bicycle_misjudges() -> None:
    """The robot's hidden truth relaxes and saturates in its own way; a robot on stiff tyres is told none."""
    task = FollowPath([hairpin((0.9,))], StanleySettings(), names=chasi.TUNED)
    slow = dataclasses.replace(
        VehicleTruth.of_seed(301), relaxation=0.35, front_stiffness=600.0, rear_stiffness=600.0, drift=0.002
    )
    tried = np.array([[2.0, 2.0, 2.0, 0.2], [1.0, 1.0, 1.0, 0.3]])
    bare = tuple(n for n in chasi.DRIVES if n not in ("rear_slip", "relaxation"))
    errors: dict[tuple[str, ...], list[float]] = {chasi.DRIVES: [], bare: []}
    for seed in (1, 2):  # one drive leaves a factor of three in what is foretold
        robot = StandInVehicle(slow, task.settings, seed=seed)
        (drive,) = robot.perform(robot_trials(task, task.parameters.nominal)[0])
        driven = [robot_scores(task, [robot.perform(t) for t in robot_trials(task, g, f"{g}")])[0] for g in tried]
        for names, off in errors.items():
            simulator = chasi.simulator(names, threads=1)
            found = calibrate_drives([drive], simulator)
            foretold = simulated_scores(task, simulator, found.values[None], tried)[0]
            off.append(np.abs(np.log(foretold / driven)).mean())
            if "relaxation" in names:
                value = {e.name: e for e in found.estimates}
                assert value["relaxation"].low <= slow.relaxation <= value["relaxation"].high
                assert any(n.startswith("tyres take") and "left-out errors are lower" in n for n in found.notes)
    assert np.mean(errors[chasi.DRIVES]) < 0.5 * np.mean(errors[bare])
