# SPDX-License-Identifier: Apache-2.0
"""What stands on a floor by itself is searched kind by kind first, in replays as long as lead lowest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.calibration import TracePoint
from trueup.discrepancies.discrepancy import measured_at
from trueup.engines.simulator import Rollout
from trueup.instant import at_instant
from trueup.loop.alike import alike
from trueup.loop.horizon import _spread, horizon, led_length
from trueup.loop.lengthening import lengthened
from trueup.loop.problem import Problem
from trueup.loop.watch import Watch
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]
SIGMA, STEP = 0.01, 0.02
TIME = np.arange(0.0, 4.0, STEP)
POINTERS = ("left", "right")


@dataclass
class Turning:
    """Two pointers that turn steadily from where they were seen, known by the places of their tips."""

    parameters: ParameterSpace
    step: float = STEP
    astray: float = 0.0
    """Share by which it turns too fast for each further part of a step."""
    rows: list[int] = field(default_factory=list)
    """Candidates of each call."""

    def at_step(self, step: float) -> Turning:
        return replace(self, step=step)

    def observable(self, recording: Recording) -> tuple[str, ...]:
        return ("base_position",)

    def rollout(self, trials: Sequence[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        self.rows.append(len(values))
        done = []
        for trial in trials:
            begun = at_instant(trial.initial["base_position"], None, trial.start).value
            time = trial.observed["base_position"].time - trial.start
            speeds = values[:, None, :] * (1.0 + self.astray * (self.step / STEP - 1.0))
            angles = np.arctan2(begun[1::2], begun[::2]) + speeds * time[:, None]
            done.append(Rollout(trial, {"base_position": tips(angles)}, {}))
        return done


class ByNoise:
    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        return np.full(len(labels), SIGMA)

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        ((channel, seen),) = simulated.channels.items()
        own = simulated.trial.observed[channel]
        return ((seen - measured_at(real, channel, own.labels, own.time)) / SIGMA).reshape(len(seen), -1)


def tips(angles: Array) -> Array:
    """(..., 4) of angles (..., 2)."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1).reshape(*angles.shape[:-1], 4)


def space(kinds: Sequence[str]) -> ParameterSpace:
    """A speed for each pointer, 20 rad/s by what was shipped."""
    pairs = zip(POINTERS, kinds, strict=True)
    return ParameterSpace(tuple(Parameter(f"{n}.{kind}", "rad/s", 20.0, 10.0, 40.0, scale="log") for n, kind in pairs))


def turned(speeds: tuple[float, float], kinds: Sequence[str] = ("speed", "speed"), astray: float = 0.0) -> Problem:
    """Four seconds of pointers that turn with these speeds."""
    seen = tips(np.array(speeds) * TIME[:, None]) + np.random.default_rng(0).normal(0.0, SIGMA, (len(TIME), 4))
    channel = Channel("base_position", ("lx", "ly", "rx", "ry"), "m", TIME, seen)
    return Problem(Turning(space(kinds), astray=astray), [Recording("turns", {channel.name: channel})], ByNoise())  # type: ignore[arg-type]


def test_parameters_of_one_kind_are_one_quantity_at_several_places() -> None:
    names = ("fl.kp", "fl.kv", "fr.kp", "delay", "trunk.mass")
    every = ParameterSpace(tuple(Parameter(n, "", 1.0, 0.5, 2.0, frozen=n == "fl.kv") for n in names))
    assert every.kinds.tolist() == [0, 0, 1, 2]


def test_drives_that_are_wrong_alike_are_found_at_the_cost_of_one() -> None:
    problem = turned((20.4, 20.4))
    found = alike(problem, space(("speed", "speed")), np.array([0.5, 0.5]))
    assert space(("speed", "speed")).from_unit(found) == pytest.approx([20.4, 20.4], rel=1e-3)
    assert isinstance(problem.simulator, Turning)
    assert problem.simulator.rows[:2] == [1, 2]  # where it begins, and one step beside it
    apart, two = turned((20.4, 19.6), ("fast", "slow")), space(("fast", "slow"))
    assert two.from_unit(alike(apart, two, np.array([0.5, 0.5]))) == pytest.approx([20.4, 19.6], rel=1e-3)


def test_what_long_replays_hide_is_found_in_the_windows_that_lead_lowest() -> None:
    problem, told = turned((24.0, 24.0)), space(("speed", "speed"))
    whole = told.from_unit(alike(problem, told, np.array([0.5, 0.5])))
    assert abs(whole[0] - 24.0) > 1.0  # 16 rad off at the end: slopes lead to the next turn
    seen = list[TracePoint]()
    length, found = horizon(problem, told, told.nominal, Watch(seen.append))
    assert [point.stage for point in seen] == ["windows of several lengths"]  # it takes minutes
    assert length < 1.0
    assert found == pytest.approx([24.0, 24.0], rel=0.01)


@pytest.mark.parametrize(("speed", "whole"), [(20.05, True), (22.0, False), (26.0, False)])
def test_windows_of_what_torques_swing_are_as_long_as_a_step_of_least_squares_leads(speed: float, whole: bool) -> None:
    problem, told = turned((speed, speed), ("left", "right")), space(("left", "right"))
    length = led_length(problem, told, told.nominal, np.inf)
    assert np.isinf(length) == whole
    assert whole or 0.2 < length < 1.2  # a turn takes 0.3 s; in less than 0.2 s little but the start is seen


def test_windows_that_grow_lead_to_what_windows_as_long_as_these_become_hide() -> None:
    problem, told = turned((26.0, 26.0), ("left", "right")), space(("left", "right"))
    found, _ = lengthened(problem, told, told.nominal, 2.0)  # in which it would be two turns off
    assert found == pytest.approx([26.0, 26.0], rel=1e-3)
    there, lasting = lengthened(problem, told, np.array([26.0, 26.0]), 2.0)  # nothing is searched that is noise
    assert (*there, lasting) == (26.0, 26.0, 2.0)


def test_lengths_are_compared_at_the_models_own_step() -> None:
    """A coarser step, which is no worse than the start values are, would end half a percent beside the truth."""
    problem, told = turned((24.0, 24.0), astray=0.0033), space(("speed", "speed"))
    _, found = horizon(problem, told, told.nominal)
    assert found == pytest.approx([24.0, 24.0], rel=1e-3)


class Legs:
    """Windows of 0.1 s in which drives are told torques or positions, and feet carry."""

    def __init__(self, count: int, unit: str) -> None:
        trial = SimpleNamespace(command=SimpleNamespace(unit=unit), observed={"base_position": None}, initial_sd={})
        self.trials, self.owners, self.windowed = [trial] * count, list(range(count)), True

    @property
    def duration(self) -> float:
        return 0.1 * len(self.trials)

    def replayed_by(self, trials: list[object], owners: list[int]) -> Legs:
        fewer = Legs(len(trials), trials[0].command.unit)  # type: ignore[attr-defined]
        fewer.owners = owners
        return fewer


@pytest.mark.parametrize(("count", "unit", "left"), [(400, "N m", 25), (41, "N m", 41), (400, "rad", 400)])
def test_of_long_logs_of_torques_told_to_legs_windows_are_searched_that_are_evenly_spread(
    count: int, unit: str, left: int
) -> None:
    found = _spread(cast(Problem, Legs(count, unit)))
    assert len(found.trials) == left
    assert len(set(np.diff(found.owners))) == 1
