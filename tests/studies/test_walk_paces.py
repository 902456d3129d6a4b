# SPDX-License-Identifier: Apache-2.0
"""Pace and lean are found by which way a robot falls; risks that compete are told apart, with doubts that hold.

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
from trueup.studies.walk.evaluation import Runs
from trueup.studies.walk.paces import Ledger, Paces, asked, ended_in, paced
from trueup.studies.walk.risks import Prior, Risks
from trueup.studies.walk.study import Budget, Story
from trueup.tasks.walking import ARRIVED, VEERED
from trueup.trial import Trial

Array = NDArray[np.float64]

SWING, PERIOD, OFFSET = (PARAMETERS.index(n) for n in ("amp_swing", "stepPeriod", "fwdOffset"))
WIDE = Prior(np.zeros((2, 3)), np.full((2, 3), 5.0))


class Leaning:
    """A Robot that is safest with a lean of `best` m, and falls more often the bolder it walks."""

    repeatable = True

    def __init__(self, best: float, risk: float = -4.5) -> None:
        each = 1.2 * best / 0.006
        self.odds = np.array([[risk + each, 10.0, -1.2, 0.0, 0.0], [risk - each, 10.0, 1.2, 0.0, 0.0]])

    def shares(self, values: Array) -> Array:
        """Of falls forward and backward."""
        pace = np.array([[values[SWING] / PARAMETERS.nominal[SWING], values[OFFSET] - PARAMETERS.nominal[OFFSET]]])
        odds = np.exp(asked(pace) @ self.odds.T)[0]
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


def test_no_trial_is_far_from_one_that_was_made() -> None:
    way = Paces()
    near = way.grid()[Ledger(np.array([[1.0, 0.0]])).near(way.grid(), way)]
    assert near[:, 0].max() == pytest.approx(1.2)
    assert np.abs(near[:, 1]).max() == pytest.approx(0.006)


def test_how_a_trial_ended_is_said() -> None:
    forward, backward = (paced(Leaning(best, risk=1.0), Budget(trials=3), 0).tried[0].runs for best in (0.05, -0.05))
    assert forward.forward == forward.falls == forward.number > 0 == backward.forward
    assert (ended_in(forward), ended_in(backward)) == ("fell forward", "fell backward")
    assert ended_in(Runs(speeds=(0.1, 0.2), trials=1)) == "15.0 cm/s"


def test_a_run_that_veers_counts_as_half_a_fall_to_either_side() -> None:
    veering = Ledger(np.zeros((0, 2)))
    veering.add(np.array([1.0, 0.0]), Runs(veers=20, trials=20))
    forward, backward = veering.risks().shares(asked(np.array([[1.0, 0.0]])))[0]
    assert forward == pytest.approx(backward, abs=1e-6)
    assert forward + backward > 0.5
    assert ended_in(veering.runs[0]) == VEERED


def test_a_fall_at_the_start_is_told_from_one_further_on() -> None:
    pace = np.array([1.0, 0.0])
    starting, walking = Ledger(np.zeros((0, 2))), Ledger(np.zeros((0, 2)))
    for _ in range(10):
        starting.add(pace, Runs(falls=1, forward=1.0, trials=1))
        walking.add(pace, Runs(speeds=(0.12,), falls=1, forward=1.0, trials=1))
    assert walking.later[0].falls == 10 > starting.later[0].number == 0
    first, on = (ledger.risks().shares(asked(pace[None]))[0, 0] for ledger in (starting, walking))
    assert first > 0.7 > 0.3 > on


def test_competing_risks_are_told_apart_and_their_doubt_holds_the_truth() -> None:
    rng = np.random.default_rng(3)
    truth = np.array([[-1.0, 1.5, -0.8], [-1.5, 0.5, 0.9]])
    inside, x, risks = [], np.zeros((0, 3)), None
    for _ in range(40):
        x = np.column_stack([np.ones(60), rng.uniform(-1.0, 1.0, (60, 2))])
        odds = np.exp(x @ truth.T)
        shares = odds / (1.0 + odds.sum(axis=1, keepdims=True))
        ended = np.array([rng.multinomial(4, [*p, 1.0 - p.sum()])[:2] for p in shares], dtype=np.float64)
        risks = Risks.of(x, ended, np.full(60, 4.0), WIDE)
        deviation = np.sqrt(np.diag(risks.covariance)).reshape(2, 3)
        inside.append(np.abs(risks.coefficients - truth) < 1.96 * deviation)
    assert 0.9 < np.mean(inside) < 0.99
    assert risks is not None
    drawn = risks.drawn(x, 500, rng).mean(axis=0)
    assert drawn == pytest.approx(risks.shares(x), abs=0.02)


def test_what_a_run_would_tell_is_most_where_it_is_not_known() -> None:
    x = np.column_stack([np.ones(40), np.zeros(40), np.zeros(40)])
    risks = Risks.of(x, np.full((40, 2), 1.0), np.full(40, 4.0), WIDE)
    known, other = np.array([[1.0, 0.0, 0.0]]), np.array([[1.0, 1.0, 0.0]])
    about, once = np.vstack([known, other]), np.ones(2)
    at_known, at_other = risks.learned(about, about, once)
    assert at_other > 10.0 * at_known > 0.0
    narrow = Risks.of(x, np.full((40, 2), 1.0), np.full(40, 4.0), Prior(np.zeros((2, 3)), np.full((2, 3), 0.2)))
    doubt = narrow.drawn(other, 20000, np.random.default_rng(0)).sum(axis=2).var()
    assert narrow.learned(other, other, np.ones(1), runs=1e6)[0] == pytest.approx(doubt, rel=0.1)  # all there is


def test_more_ends_than_runs_are_refused() -> None:
    with pytest.raises(ValueError, match="more runs ended than were made"):
        Risks.of(np.ones((1, 3)), np.array([[2.0, 2.0]]), np.array([3.0]), WIDE)
