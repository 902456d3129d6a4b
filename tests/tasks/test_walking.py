# SPDX-License-Identifier: Apache-2.0
"""Scores of walks: metres made good, by simulations and recordings alike; a fall costs what it says."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.controllers.playback import Playback
from trueup.ends import Ended, with_end
from trueup.engines.simulator import Rollout
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel
from trueup.tasks.omni_walk import OmniWalk
from trueup.tasks.task import robot_scores
from trueup.tasks.walking import ANGLES, ARRIVED, PLACE, VEERED, LineWalk, Walk, WalkFront

Array = NDArray[np.float64]
SPACE = ParameterSpace((Parameter("a", "1", 0.0, -1.0, 1.0),))


def nothing(values: Array) -> Playback:
    return Playback(Channel("command", ("a",), "rad", np.zeros(1), np.zeros((1, 1))), len(values))


def task(kind: type[Walk], **more: object) -> Walk:
    return kind(parameters=SPACE, make=nothing, height=0.3, **more)  # type: ignore[arg-type]


def run(walk: Walk, k: int, places: Array, ends: dict[int, Ended] | None = None) -> Rollout:
    """Of robots that go along `places` (b, T, 2), as their trial reads them off; NaN after their ends."""
    trial = walk.trials[k]
    channels = {PLACE: np.concatenate([places, np.full((*places.shape[:2], 1), 0.3)], axis=2),
                ANGLES: np.zeros((*places.shape[:2], 3))}  # fmt: skip
    rollout = Rollout(trial, channels, {}, ends or {})
    for name, values in channels.items():
        values[~rollout.lasted(name)] = np.nan
    return rollout


def straight(walk: Walk, *speeds: float) -> Array:
    time = walk.trials[0].observed[PLACE].time
    return np.stack([np.stack([s * time, 0.0 * time], axis=1) for s in speeds])


def test_walking_ahead_scores_its_mean_speed_and_a_fall_costs() -> None:
    walk = task(WalkFront, runs=2, fall=0.15)
    places = straight(walk, 0.1, 0.2)
    upright = run(walk, 0, places)
    fallen = run(walk, 1, places, {1: Ended(7.5, "fallen")})
    assert walk.score([upright, upright]) == pytest.approx([-0.1, -0.2])
    # The second one fell halfway: half of the distance of one run of two, and the cost of one fall of two.
    assert walk.score([upright, fallen]) == pytest.approx([-0.1, -(0.2 + 0.1 - 0.15) / 2])


def test_a_failed_simulation_has_no_score() -> None:
    walk = task(WalkFront, runs=1)
    failed = run(walk, 0, straight(walk, 0.1, 0.2))
    failed = Rollout(failed.trial, failed.channels, {0: "it became unstable"}, {})
    assert np.isnan(walk.score([failed])[0])
    assert walk.score([failed])[1] == pytest.approx(-0.2)


def test_a_walk_to_the_line_scores_line_over_time_by_recordings_too() -> None:
    walk = task(LineWalk, runs=1)
    places = straight(walk, 0.119, 0.02, 0.17)
    ends = {0: Ended(20.0, ARRIVED), 2: Ended(10.0, VEERED)}
    rollout = run(walk, 0, places, ends)
    expected = [-2.38 / 20.0, -0.02, -1.7 / walk.duration]
    assert walk.score([rollout]) == pytest.approx(expected, rel=0.01)
    recordings = []
    for row in range(3):
        made = rollout.recording(row)
        recordings.append(with_end(made, ends[row]) if row in ends else made)
    assert robot_scores(walk, [recordings]) == pytest.approx(expected, rel=0.01)


def test_the_line_is_crossed_and_the_lane_left_where_they_are_drawn() -> None:
    walk = task(LineWalk, runs=1, line=2.0, lane=0.5)
    time = walk.trials[0].observed[PLACE].time
    from trueup.ends import end_of

    ahead = run(walk, 0, straight(walk, 0.1)).recording()
    end = end_of(ahead, walk.trials[0].ends)
    assert end is not None
    assert end.name == ARRIVED
    assert end.at == pytest.approx(20.0, abs=0.05)
    aside = run(walk, 0, np.stack([0.05 * time, -0.04 * time], axis=1)[None]).recording()
    end = end_of(aside, walk.trials[0].ends)
    assert end is not None
    assert end.name == VEERED
    assert end.at == pytest.approx(12.5, abs=0.05)


def test_a_course_pays_metres_made_good_toward_each_target_and_takes_drift_off() -> None:
    walk = task(OmniWalk, runs=1, fall=5.0)
    time, course = walk.trials[0].observed[PLACE].time, walk.course
    still = np.zeros((1, len(time), 2))
    # Who jumps onto each target at once makes good the way from one to the next.
    there = still.copy()
    at = np.zeros(2)
    gained = 0.0
    for row, begun in zip(course, course[:, 0], strict=True):
        goal = row[1:3]
        if not np.isnan(goal).any():
            gained += np.linalg.norm(goal - at)
            at = goal
        there[0, time > begun + 1e-9] = at
    assert walk.score([run(walk, 0, still)]) == pytest.approx([0.0])
    assert walk.score([run(walk, 0, there)]) == pytest.approx([-gained])
    drifting = np.repeat(np.stack([0.1 * time, 0.0 * time], axis=1)[None], 1, axis=0)
    stops = sum(0.1 * (b - a) for a, b, x in zip(course[:, 0], [*course[1:, 0], walk.duration], course[:, 1], strict=True)
                if np.isnan(x))  # fmt: skip
    paid = -walk.score([run(walk, 0, drifting)])[0]
    toward = sum(
        np.linalg.norm(row[1:3] - [0.1 * row[0], 0.0]) - np.linalg.norm(row[1:3] - [0.1 * end, 0.0])
        for row, end in zip(course, [*course[1:, 0], walk.duration], strict=True) if not np.isnan(row[1])
    )  # fmt: skip
    assert paid == pytest.approx(toward - stops, abs=1e-6)
    fallen = run(walk, 0, still, {0: Ended(3.0, "fallen")})
    assert walk.score([fallen]) == pytest.approx([5.0])


def test_runs_differ_and_a_task_made_anew_meets_other_runs() -> None:
    walk = task(WalkFront, runs=7, seed=3)
    seeds = [t.settled().seed for t in walk.trials]
    assert len(set(seeds)) == 7
    assert [t.settled().seed for t in task(WalkFront, runs=7, seed=3).trials] == seeds
    assert not set(seeds) & {t.settled().seed for t in walk.made_anew(4).trials}
