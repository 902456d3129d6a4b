# SPDX-License-Identifier: Apache-2.0
"""Pace and lean are found by which way a robot falls.

The robot is a formula here: log odds of falls forward and backward, linear in pace and lean.
"""

from __future__ import annotations

import zlib

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.ends import Ended, Left, with_end
from trueup.recording import Channel, Recording
from trueup.studies.walk import scenes
from trueup.studies.walk.comparison import QUICK, OnTheRobot, truth_of
from trueup.studies.walk.evaluation import Runs
from trueup.studies.walk.paces import ended_in, paced
from trueup.studies.walk.robot import StandInNao
from trueup.studies.walk.study import Budget, Story
from trueup.tasks.paces import features
from trueup.tasks.walking import ARRIVED, LineWalk
from trueup.trial import Trial

Array = NDArray[np.float64]

SWING, PERIOD, OFFSET = (PARAMETERS.index(n) for n in ("amp_swing", "stepPeriod", "fwdOffset"))


class Leaning:
    """A Robot that is safest with a lean of `best` m, and falls more often the bolder it walks."""

    repeatable = True

    def __init__(self, best: float, risk: float = -4.5) -> None:
        each = 1.2 * best / 0.006
        self.odds = np.array([[risk + each, 10.0, -1.2, 0.0, 0.0], [risk - each, 10.0, 1.2, 0.0, 0.0]])

    def shares(self, values: Array) -> Array:
        """Of falls forward and backward."""
        pace = np.array([[values[SWING] / PARAMETERS.nominal[SWING], values[OFFSET] - PARAMETERS.nominal[OFFSET]]])
        odds = np.exp(features(pace / (1.0, 0.006))[0] @ self.odds.T)[0]
        return odds / (1.0 + odds.sum())

    def perform(self, trial: Trial) -> list[Recording]:
        rng = np.random.default_rng(zlib.crc32(trial.name.encode()))
        values = np.array([trial.settings[n] for n in PARAMETERS.names])
        speed = 0.13 * values[SWING] / PARAMETERS.nominal[SWING] * PARAMETERS.nominal[PERIOD] / values[PERIOD]
        return [self.run(trial, speed, self.shares(values), rng) for _ in range(trial.repeats)]

    def run(self, trial: Trial, speed: float, shares: Array, rng: np.random.Generator) -> Recording:
        far, fate = 0.0, 2
        while far < trial_end(trial) and fate == 2:
            fate = int(rng.choice(3, p=[*shares, 1.0 - shares.sum()]))
            far += 2.38 if fate == 2 else 1.0
        time = np.linspace(0.0, far / speed, 50)
        place = np.stack([speed * time, 0.0 * time, 0.0 * time + 0.36], axis=1)
        pitch = np.where(time == time[-1], (0.8, -0.8, 0.0)[fate], 0.0)
        angles = np.stack([0.0 * time, pitch, 0.0 * time], axis=1)
        channels = {
            "base_position": Channel("base_position", ("x", "y", "z"), "m", time, place),
            "base_orientation": Channel("base_orientation", ("roll", "pitch", "yaw"), "rad", time, angles),
        }
        end = Ended(float(time[-1]), ARRIVED if fate == 2 else "fallen")
        return with_end(Recording(trial.name, channels), end)


def trial_end(trial: Trial) -> float:
    """How far the last line is, in m."""
    (arrives,) = [e for e in trial.ends if isinstance(e, Left) and e.name == ARRIVED]
    return arrives.area["x"][1] - 0.01


def found_by(robot: Leaning, seed: int = 0, seconds: float = 1800.0) -> Story:
    return paced(robot, Budget(seconds=seconds), seed)


@pytest.mark.parametrize("best", [-0.006, 0.0, 0.006])
def test_pace_and_lean_are_found_by_the_way_a_robot_falls(best: float) -> None:
    robot = Leaning(best)
    walks = [found_by(robot, seed).best.values for seed in range(3)]
    leans = [w[OFFSET] - PARAMETERS.nominal[OFFSET] for w in walks]
    assert np.mean(leans) == pytest.approx(best, abs=0.003)
    falls = [robot.shares(w).sum() for w in walks]
    paces = [w[SWING] / PARAMETERS.nominal[SWING] for w in walks]
    assert np.mean(falls) < 0.04
    assert np.mean(paces) > 1.25


def test_a_robot_that_falls_at_its_start_walk_already_is_not_made_bolder() -> None:
    walk = found_by(Leaning(0.0, risk=0.5)).best.values
    assert walk[SWING] <= 1.1 * PARAMETERS.nominal[SWING] + 1e-9


def test_trials_and_robot_time_are_kept_and_the_walk_handed_over_was_tried() -> None:
    heard: list[str] = []
    story = paced(Leaning(0.0), Budget(trials=20), 0, told=heard.append)
    assert story.trials == 20
    assert len(heard) == 18  # the start walk's two are not told
    assert story.best.runs.number > 0
    assert story.tried[0].values == pytest.approx(PARAMETERS.nominal)
    short = found_by(Leaning(0.0), seconds=400.0)
    assert short.seconds <= 400.0


def test_the_same_seed_tells_the_same_story() -> None:
    first, again = (paced(Leaning(0.003), Budget(trials=15), 4) for _ in range(2))
    assert [t.values.tolist() for t in first.tried] == [t.values.tolist() for t in again.tried]


def test_how_a_trial_ended_is_said() -> None:
    forward, backward = (paced(Leaning(best, risk=1.0), Budget(trials=3), 0).tried[0].runs for best in (0.05, -0.05))
    assert forward.forward == forward.falls == forward.number > 0 == backward.forward
    assert (ended_in(forward), ended_in(backward)) == ("fell forward", "fell backward")
    assert ended_in(Runs(speeds=(0.1, 0.2), trials=1)) == "15.0 cm/s"


def test_a_way_reckons_with_its_own_price_of_falls() -> None:
    heard: list[float] = []

    def loop(robot: object, budget: Budget, seed: int, **_: object) -> Story:
        heard.append(budget.fall)
        return Story()

    for price in (None, 0.2):
        OnTheRobot(loop, "a way", price).improved(
            StandInNao(truth_of(0)), QUICK, 0, scenes.task(LineWalk, runs=1), print
        )
    assert heard == [QUICK.budget.fall, 0.2]
