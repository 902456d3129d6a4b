# SPDX-License-Identifier: Apache-2.0
"""What sway says of falls, what the robot's runs leave of a doubtful simulator, and who may change which parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.controllers.controller import ControllerFactory
from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.ends import Ended
from trueup.engines.simulator import Rollout
from trueup.errors import PlanError, UnknownNameError
from trueup.parameters import Parameter, ParameterSpace
from trueup.studies.walk import scenes
from trueup.studies.walk.comparison import Result, over, truth_of
from trueup.studies.walk.evaluation import Runs, at_once
from trueup.studies.walk.fitted import Fitted, replay_errors
from trueup.studies.walk.guidance import BALANCE, Automatic, Expert
from trueup.studies.walk.methods import legs
from trueup.studies.walk.report import html
from trueup.studies.walk.robot import StandInNao
from trueup.studies.walk.search import Scene
from trueup.studies.walk.study import Story, Tried
from trueup.tasks.sway import passing, sway
from trueup.tasks.walking import LineWalk, WalkFront
from trueup.trial import Trial

Array = NDArray[np.float64]

AMPLITUDE, ROLL, KNEE = (PARAMETERS.index(n) for n in ("amp_swing", "scale_roll", "gyro_kneePitch"))
WALK = scenes.task(WalkFront, runs=2, seconds=5.0, fall=0.5)


@dataclass
class Edge:
    """A Simulator of one number, the amplitude beyond which walks fall; `touchy`, balance off the start costs falls too."""

    touchy: bool = False
    name, step, parameters = "edge", 0.01, ParameterSpace((Parameter("edge", "rad", 0.25, 0.1, 0.35),))

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        edge, walks = values[:, 0], values[:, 1:]
        off = np.abs(walks[:, ROLL] - PARAMETERS.nominal[ROLL])
        rng, done = np.random.default_rng(0), []
        for trial in trials:
            falls = (walks[:, AMPLITUDE] > edge) | (self.touchy & (rng.random() < 8.0 * off))
            time = trial.observed["base_position"].time
            place = np.zeros((len(walks), len(time), 3))
            place[:, :, 0] = walks[:, AMPLITUDE, None] * time
            ends = {int(k): Ended(2.0, "fallen") for k in np.flatnonzero(falls)}
            done.append(Rollout(trial, {"base_position": place, "base_orientation": 0.0 * place}, {}, ends))
        return done


def walk_of(amplitude: float) -> Array:
    values = PARAMETERS.nominal.copy()
    values[AMPLITUDE] = amplitude
    return values


def test_sway_foretells_as_many_falls_as_there_are() -> None:
    rng, dt, tip = np.random.default_rng(0), 0.05, 0.3
    time = np.arange(0.0, 17.5, dt)  # 15 s once settled
    radius, turn = 0.88, 2.0 * np.pi * 2.0 * dt  # sways twice a second, with an amplitude that wanders
    noise = rng.standard_normal((4000, len(time) + 200))
    x = np.zeros_like(noise)
    for k in range(2, noise.shape[1]):
        x[:, k] = 2.0 * radius * np.cos(turn) * x[:, k - 1] - radius**2 * x[:, k - 2] + noise[:, k]
    x = x[:, 200:] / x[:, 200:].std()
    for deviation in (0.09, 0.105, 0.12):
        rolls = deviation * x
        fell = (rolls[:, time > 2.5] > tip).any(axis=1).mean()
        angles = np.stack([0.0 * rolls, rolls], axis=2)
        foretold = passing(np.array([sway(time, a, (1.0, tip)) for a in angles[:400]])).mean()
        assert 0.03 < fell < 0.8
        assert 0.5 < foretold / fell < 2.0
    assert passing(np.array(sway(time[:40], np.zeros((40, 2)), (0.1, 0.1)))) == 0.0


def test_guidance_freezes_what_only_costs_falls_and_leaves_what_makes_faster() -> None:
    scene = Scene(Edge(touchy=True), replace(WALK, runs=4), np.full((4, 1), 0.3))  # type: ignore[arg-type]
    advice = Automatic(runs=16).advice(1, scene, PARAMETERS.nominal, 0.05)
    assert [n for n, free in zip(PARAMETERS.names, advice.space.free, strict=True) if not free] == ["scale_roll"]
    assert not advice.wide
    assert any("scale_roll is frozen" in w for w in advice.words)


def test_an_expert_speaks_from_the_second_round_on_or_as_a_file_says(tmp_path: Path) -> None:
    scene = Scene(Edge(), WALK, np.full((1, 1), 0.3))  # type: ignore[arg-type]
    assert Expert().advice(1, scene, PARAMETERS.nominal, 0.05).space.free.all()
    later = Expert().advice(2, scene, PARAMETERS.nominal, 0.05)
    assert set(BALANCE) == {n for n, free in zip(PARAMETERS.names, later.space.free, strict=True) if not free}
    file = tmp_path / "expert.toml"
    file.write_text('freeze = ["knee"]\nsince = 1\n[widen]\na_short = 1.5\n')
    told = Expert.read(file).advice(1, scene, PARAMETERS.nominal, 0.05)
    assert not told.space.free[PARAMETERS.index("knee")]
    assert dict(told.wide) == {"a_short": 1.5}
    file.write_text('freeze = ["knees"]')
    with pytest.raises(UnknownNameError, match="knees"):
        Expert.read(file)
    file.write_text("freeze = [")
    with pytest.raises(PlanError, match=r"expert\.toml"):
        Expert.read(file)


def results(better: float) -> list[Result]:
    rng, nothing = np.random.default_rng(3), tuple(PARAMETERS.nominal.tolist())
    return [
        Result(w, n, s, nothing, 0.2 + 0.01 * n + more + 0.002 * rng.standard_normal(), 0.03, 1.0, 0.17, 0.0, 58, 500.0)
        for n in range(6) for s in range(2) for w, more in (("noisy", 0.0), ("bounded", better))
    ]  # fmt: skip


def test_differences_between_ways_are_taken_robot_by_robot() -> None:
    sure, none = (over(results(b), "bounded", "noisy", lambda r: 100.0 * r.speed) for b in (0.01, 0.0))
    assert sure.low > 0.5
    assert sure.mean == pytest.approx(1.0, abs=0.2)  # though robots differ by five
    assert none.low < 0.0 < none.high
    page = html(results(0.01))
    assert "stand-in 5" in page
    assert "gain over noisy" in page


def test_fitted_simulators_replay_the_robot_better_and_fall_the_more_the_robot_falls() -> None:
    robot = StandInNao(truth_of(100), seed=100, threads=1)
    line = scenes.task(LineWalk, runs=1)
    runs = at_once(robot, line, PARAMETERS.nominal, 2, " start")
    few = Fitted(members=2, drawn=1, replayed=2.5, population=8, generations=3, threads=1)
    scene = few.prepared(Story((Tried(0, PARAMETERS.nominal, None, runs),)), 0)
    begun = [legs(r, torso=True).slice(r.start, r.start + 2.5) for r in runs.recordings]
    nominal = scene.simulator.parameters.nominal
    errors = replay_errors(scene.simulator, begun, np.vstack([nominal, scene.models])).prod(axis=2).mean(axis=0)
    assert scene.models.shape == (2, len(nominal))
    assert (errors[1:] < 0.8 * errors[0]).all()
    assert isinstance(scene.walk, WalkFront)
    steady, falling = (
        few.unsteadier(scene.simulator, scene.walk, scene.models, Story((Tried(0, PARAMETERS.nominal, None, r),)))
        for r in (Runs(speeds=(0.12,) * 20), Runs(speeds=(0.12,) * 10, falls=10))
    )
    assert 1.0 / 3.0 <= steady <= 1.0 < falling <= 3.0
