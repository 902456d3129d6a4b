# SPDX-License-Identifier: Apache-2.0
"""The loop on a robot: it goes as far as the robot follows, keeps to its trials, and knows little from few runs.

Robot and simulator are formulas here: amplitude makes speed; beyond a place that the simulator does not know, robots fall.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.controllers.controller import ControllerFactory
from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.ends import Ended, ended, with_end
from trueup.engines.simulator import Rollout
from trueup.parameters import ParameterSpace
from trueup.recording import Channel, Recording
from trueup.studies.walk import scenes
from trueup.studies.walk.evaluation import Runs, at_once, expected_falls, outcome
from trueup.studies.walk.guidance import Advice
from trueup.studies.walk.search import Effort, Scene, searched
from trueup.studies.walk.study import Budget, Story, alone, best_share, improved
from trueup.tasks.walking import ARRIVED, VEERED, LineWalk, WalkFront
from trueup.trial import Trial

Array = NDArray[np.float64]

AMPLITUDE = PARAMETERS.index("amp_swing")
SPACE = PARAMETERS.freeze([n for n in PARAMETERS.names if n not in ("amp_swing", "a_short")])
SMALL = Effort(population=10, generations=8, sigma=0.05, shown=6, fresh=2)


def speed_of(values: Array) -> Array:
    """(b,) m/s; largest with an amplitude of 0.33 rad."""
    return 0.25 - 3.0 * (values[:, AMPLITUDE] - 0.33) ** 2


class Formula:
    """A Simulator in which nobody falls."""

    name, step, parameters = "formula", 0.01, ParameterSpace(())

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        made = []
        for trial in trials:
            time = trial.observed["base_position"].time
            x = speed_of(values)[:, None] * time
            place = np.stack([x, 0.0 * x, 0.0 * x + 0.36], axis=2)
            made.append(Rollout(trial, {"base_position": place, "base_orientation": np.zeros_like(place)}, {}))
        return made


@dataclass
class Brittle:
    """A Robot that falls in more and more runs beyond an amplitude of `holds`."""

    holds: float
    trials: list[str] = field(default_factory=list)
    repeatable = True

    def perform(self, trial: Trial) -> list[Recording]:
        rng = np.random.default_rng(zlib.crc32(trial.name.encode()))
        values = np.array([[trial.settings[n] for n in PARAMETERS.names]])
        share = trial.references["targets"].values[0, 3] / 0.67
        values[:, AMPLITUDE] *= share
        speed = float(speed_of(values)[0])
        risk = np.clip((values[0, AMPLITUDE] - self.holds) / 0.04, 0.0, 1.0)
        self.trials += [trial.name] * trial.repeats
        return [
            self._run(trial, speed * (1.0 + 0.02 * rng.standard_normal()), rng.random() < risk)
            for _ in range(trial.repeats)
        ]

    @staticmethod
    def _run(trial: Trial, speed: float, falls: bool) -> Recording:
        stop = 3.0 if falls else 0.05 * trial.duration / speed  # the slowest that arrive do 5 cm/s
        time = np.arange(0.0, stop, 0.05)
        place = Channel(
            "base_position", ("x", "y", "z"), "m", time, np.outer(time, [speed, 0.0, 0.0]) + np.array([0.0, 0.0, 0.31])
        )
        return with_end(
            Recording(trial.name, {"base_position": place}, {}), Ended(stop, "fallen" if falls else ARRIVED)
        )


def by_formula(seed: int = 0) -> Scene:
    return Scene(Formula(), scenes.task(WalkFront, runs=2, seconds=5.0, seed=seed), np.zeros((1, 0)))  # type: ignore[arg-type]


@dataclass(frozen=True)
class ByFormula:
    name: str = "formula"

    def prepared(self, story: Story, seed: int) -> Scene:
        return by_formula(seed)


@dataclass(frozen=True)
class Two:
    name: str = "two parameters"

    def advice(self, number: int, scene: Scene, start: Array, sigma: float) -> Advice:
        return Advice(SPACE)


def test_a_search_shows_its_way_from_gentle_to_bold() -> None:
    heard: list[int] = []
    found = searched(by_formula(), PARAMETERS.nominal, SMALL, 0, space=SPACE, told=lambda k, _: heard.append(k))
    amplitudes = np.array([p.values[AMPLITUDE] for p in found.path])
    assert len(found.path) == 6
    assert heard == list(range(1, 9))
    assert PARAMETERS.nominal[AMPLITUDE] < amplitudes[0] < 0.22
    assert amplitudes[-1] == pytest.approx(0.33, abs=0.02)
    assert [p.score for p in found.path] == pytest.approx(speed_of(np.array([p.values for p in found.path])).tolist())
    fixed = ~SPACE.free
    assert all(p.values[fixed] == pytest.approx(PARAMETERS.nominal[fixed]) for p in found.path)


@pytest.mark.parametrize("holds", [0.17, 0.19, 0.21, 0.30])
def test_the_loop_goes_as_far_as_the_robot_follows_within_its_trials(holds: float) -> None:
    robot, heard = Brittle(holds), []
    budget = Budget(effort=SMALL)
    story = improved(robot, ByFormula(), budget, 0, guidance=Two(), told=heard.append)
    assert story.trials == len(robot.trials) <= budget.trials <= 60
    start, best = PARAMETERS.nominal[AMPLITUDE], story.best
    assert start < best.values[AMPLITUDE] < holds + 0.02  # beyond it falls in half of its runs
    assert speed_of(best.values[None])[0] > speed_of(PARAMETERS.nominal[None])[0] + 0.01
    assert heard


def test_robot_time_ends_the_loop_before_its_trials_do() -> None:
    whole, short = (
        improved(Brittle(0.30), ByFormula(), Budget(effort=SMALL, seconds=s), 0, guidance=Two())
        for s in (1800.0, 500.0)
    )
    assert short.seconds <= 500.0 < whole.seconds
    assert short.trials < whole.trials


def test_on_a_robot_on_which_nothing_else_walks_the_start_walk_stays() -> None:
    story = improved(
        Brittle(PARAMETERS.nominal[AMPLITUDE]), ByFormula(), Budget(effort=Effort(10, 3, 0.3, 3, 2)), 1, guidance=Two()
    )
    assert story.best.runs.falls <= 0.1 * story.best.runs.number


def test_a_search_on_the_robot_alone_keeps_to_its_trials_and_never_ends_worse_for_sure() -> None:
    robot, budget = Brittle(0.21), Budget(effort=SMALL)
    story = alone(robot, budget, 0)
    assert story.trials == len(robot.trials) <= budget.trials
    assert speed_of(story.best.values[None])[0] >= speed_of(PARAMETERS.nominal[None])[0]
    assert story.best.values[AMPLITUDE] < 0.21 + 0.02  # beyond it falls in half of its runs
    short = Budget(round=6, trials=30)
    assert alone(Brittle(0.21), short, 0).trials <= short.trials


def test_falls_of_all_walks_say_how_they_grow_with_speed() -> None:
    assert expected_falls([Runs(speeds=(0.1,) * 3)])[0] > expected_falls([Runs(speeds=(0.1,) * 30)])[0]
    gentle = Runs(speeds=(0.1,) * 2)
    among = [gentle, Runs(speeds=(0.15,) * 20), Runs(speeds=(0.2,) * 2, falls=8), Runs(falls=3)]
    gentlest, standing, bold, never = expected_falls(among)
    assert gentlest < expected_falls([gentle])[0]  # a faster one that stands speaks for it
    assert gentlest < 0.05 > standing
    assert 0.6 < bold < 0.9 < never + 0.2
    assert expected_falls([Runs(falls=2)])[0] > 0.5


def test_shares_of_falls_are_right_on_average_and_nearer_than_each_walks_own_count() -> None:
    rng, wrong, alone, bias = np.random.default_rng(0), [], [], []
    for _ in range(60):
        speeds = np.linspace(0.12, 0.26, 8)
        true = 1.0 / (1.0 + np.exp(-(rng.normal(-3.0, 0.7) + 25.0 * (speeds - 0.16) + 0.4 * rng.standard_normal(8))))
        falls = rng.binomial(4, true)
        found = expected_falls([Runs(speeds=(v,) * (4 - f), falls=int(f)) for v, f in zip(speeds, falls, strict=True)])
        wrong.append(found - true)
        alone.append((falls + 0.5) / 5.0 - true)
        bias.append(np.mean(found - true))
    assert np.sqrt(np.mean(np.square(wrong))) < 0.7 * np.sqrt(np.mean(np.square(alone)))
    assert abs(np.mean(bias)) < 0.05


def test_runs_are_told_by_how_they_ended() -> None:
    line, robot = scenes.task(LineWalk, runs=1), Brittle(1.0)
    arrived = at_once(robot, line, PARAMETERS.nominal, 2)
    made = arrived.recordings[0]
    veered = with_end(made, Ended(5.0, VEERED))
    late = made.replace(provenance={})
    assert ended(late) is None
    runs = outcome([*arrived.recordings, veered, late], line)
    assert (len(runs.speeds), runs.falls, runs.veers, runs.trials) == (2, 0, 2, 4)


def test_each_lap_of_a_longer_trial_is_a_run() -> None:
    line, robot = replace(scenes.task(LineWalk, runs=1), laps=3), Brittle(1.0)
    arrived = at_once(robot, line, PARAMETERS.nominal, 1)
    speed = float(speed_of(PARAMETERS.nominal[None])[0])
    assert (arrived.number, arrived.trials) == (3, 1)
    assert arrived.speeds == pytest.approx([speed] * 3, rel=0.05)
    (made,) = arrived.recordings
    behind_the_second = 2.5 * line.line / arrived.speed
    fell = with_end(made.slice(0.0, behind_the_second), Ended(behind_the_second, "fallen"))
    runs = outcome([fell], line)
    assert (len(runs.speeds), runs.falls) == (2, 1)


def test_the_best_step_size_is_the_fastest_that_seldom_falls() -> None:
    robot = Brittle(PARAMETERS.nominal[AMPLITUDE] * 1.25)
    share, runs = best_share(robot, PARAMETERS.nominal, (0.67, 0.8, 1.0), 40, 0.03)
    assert share == 0.8
    assert runs.falls <= 1
