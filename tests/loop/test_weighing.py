# SPDX-License-Identifier: Apache-2.0
"""Slopes over a stretch: where residuals have a crack every thousandth of the box, steps by them arrive all the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from trueup.arrays import Array
from trueup.discrepancies.discrepancy import measured_at
from trueup.engines.simulator import Rollout
from trueup.instant import at_instant
from trueup.loop.fit import REFINEMENT, SEARCHES, fit
from trueup.loop.problem import Problem
from trueup.loop.shoot import Starts
from trueup.loop.watch import Watch
from trueup.loop.weighing import Weighed, _Place, axes_of, curvature_of, design
from trueup.loop.windows import in_windows
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.search.least_squares import LeastSquares
from trueup.trial import Trial

SPACE = ParameterSpace(tuple(Parameter(f"p{k}", "", 0.5, 0.0, 1.0) for k in range(6)))
TRUTH = np.array([0.45, 0.52, 0.5, 0.55, 0.48, 0.51])


class Cracked(Problem):
    """Residuals on slopes of which one combination shows little; every replay touches somewhere else."""

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        along, _ = np.linalg.qr(rng.normal(size=(6, 6)))
        self.slopes = rng.normal(size=(400, 6)) @ (along * [30.0, 30.0, 20.0, 10.0, 10.0, 2.0]) @ along.T
        self._touches, self._size = rng.normal(size=(400, 6)), 0.3 * rng.normal(size=400)

    def residuals(self, values: Array, only: object = None) -> Array:
        away = np.atleast_2d(values) - TRUTH
        touched = np.floor(300.0 * away @ self._touches.T) - np.floor(-300.0 * TRUTH @ self._touches.T)
        return away @ self.slopes.T + self._size * np.sin(touched)


def test_columns_of_a_design_are_orthogonal_and_of_mean_square_one() -> None:
    for count in (1, 5, 12):
        columns = design(count, np.random.default_rng(1))
        np.testing.assert_allclose(columns.T @ columns, (count + 1) * np.eye(count), atol=1e-9)
        np.testing.assert_allclose(columns.sum(axis=0), 0.0, atol=1e-9)


def test_steps_by_what_is_weighed_together_arrive_where_single_cracks_hold_differences() -> None:
    problem, start, rng = Cracked(), np.full(6, 0.5), np.random.default_rng(2)
    hair = LeastSquares(start, np.zeros(6), difference=1e-4)
    while not hair.done:
        asked = hair.ask()
        hair.tell(asked, problem.residuals(asked))
    unit, axes = start, axes_of(curvature_of(problem.slopes, np.ones(400)))
    for _ in range(6):
        weighed = Weighed.around(problem, SPACE, unit, axes, 3.5, rng)
        axes, unit = axes_of(weighed.curvature), weighed.step()
    off, held = (np.abs(where - TRUTH).max() for where in (unit, hair.best[0]))
    assert off < held / 3.0


def test_where_nothing_around_can_be_simulated_there_are_no_slopes() -> None:
    class Failing(Cracked):
        def residuals(self, values: Array, only: object = None) -> Array:
            failed = np.atleast_2d(values)[:, 0] > 0.5
            return np.where(failed[:, None], np.nan, super().residuals(values))

    axes, rng = 0.01 * np.eye(6), np.random.default_rng(4)
    assert Weighed.around(Failing(), SPACE, np.full(6, 0.5), axes, 3.5, rng).loss == np.inf
    assert Weighed.around(Failing(), SPACE, np.full(6, 0.6), axes, 3.5, rng).loss == np.inf
    assert np.isfinite(Weighed.around(Failing(), SPACE, np.full(6, 0.4), axes, 3.5, rng).loss)


class Still:
    """Starts that need no correction."""

    def corrected(self, problem: Problem, values: Array) -> tuple[Still, float]:
        return self, 0.0

    def eliminated_from(self, problem: Problem, values: Array) -> Problem:
        return problem


def test_a_step_that_ends_higher_than_what_lies_around_is_shortened_or_not_taken() -> None:
    space = SPACE.freeze(SPACE.names[1:])

    class Bent(Cracked):
        """Levels off to both sides of 0.3, so that a step from 0.5 ends beyond it as high as it began, and higher."""

        def residuals(self, values: Array, only: object = None) -> Array:
            return np.arctan(20.0 * (np.atleast_2d(values)[:, [0] * 100] - 0.3))

    class Cliff(Cracked):
        """Falls gently towards where it is high at once."""

        def residuals(self, values: Array, only: object = None) -> Array:
            first = np.atleast_2d(values)[:, [0] * 100]
            return np.where(first > 0.52, 50.0, 1.5 - first)

    def led(problem: Problem) -> float | None:
        there = _Place.at(problem, cast(Starts, Still()), space, np.array([0.5]), 3.5)
        weighed = Weighed.around(there.problem, space, there.unit, 0.01 * np.eye(1), 3.5, np.random.default_rng(5))
        onward = there.onward(weighed, space, 3.5)
        return None if onward is None else float(onward.unit[0])

    assert led(Bent()) == 0.25
    assert led(Cliff()) is None


NAMES = {"base_position": ("x", "y", "z"), "base_orientation": ("roll", "pitch", "yaw")}
SIGMA = 0.01
TIME = np.arange(0.0, 8.0, 0.02)
SHIPPED = ParameterSpace(
    (
        Parameter("speed", "m/s", 1.2, 0.5, 2.0),
        Parameter("drift", "m/s2", 0.0, -1.0, 1.0),
        Parameter("none", "", 0.5, 0.0, 1.0),
    )
)


class Walker:
    """Runs on from where it was seen; in each window a touch, of which a hair of anything decides, pushes it aside."""

    parameters, step = SHIPPED, 0.02

    def at_step(self, step: float) -> Walker:
        return self

    def observable(self, recording: Recording) -> tuple[str, ...]:
        return tuple(NAMES)

    def rollout(self, trials: Sequence[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        done = []
        for trial in trials:
            at = {n: at_instant(trial.initial[n], None, trial.start).value for n in NAMES}
            at = {n: v + trial.corrections.get(n, np.zeros((2, 3)))[0] for n, v in at.items()}
            past = trial.observed["base_position"].time - trial.start
            ran, climbed = values[:, :1] * past, values[:, 1:2] * past
            sign = np.sign(np.sin(300.0 * (values[:, :2] @ [1.0, 0.4] + at["base_position"][0]) + trial.start))
            moved = np.stack([ran, 0.5 * SIGMA * sign[:, None] * (past > 0.2), climbed], axis=-1)
            still = np.broadcast_to(at["base_orientation"], moved.shape)
            done.append(Rollout(trial, {"base_position": at["base_position"] + moved, "base_orientation": still}, {}))
        return done


class ByNoise:
    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        return np.full(len(labels), SIGMA)

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        seen = [
            (simulated.channels[n] - measured_at(real, n, o.labels, o.time)) / SIGMA
            for n, o in simulated.trial.observed.items()
        ]
        return np.concatenate([each.reshape(len(each), -1) for each in seen], axis=1)


def test_a_search_in_windows_of_a_free_base_ends_with_slopes_over_a_stretch_and_goes_on_by_them() -> None:
    rng, walked = np.random.default_rng(3), np.stack([TIME, 0.0 * TIME, 0.3 * TIME], axis=1)
    seen = {
        name: Channel(name, labels, "m" if name == "base_position" else "rad", TIME,
                      walked * (name == "base_position") + SIGMA * rng.standard_normal((len(TIME), 3)))
        for name, labels in NAMES.items()
    }  # fmt: skip
    whole = Problem(Walker(), [Recording("walk", seen)], ByNoise())  # type: ignore[arg-type]
    problem = in_windows(whole, 0.8)
    found = fit(problem, SHIPPED, SHIPPED.nominal, Watch(), stages=SEARCHES["gradient"])
    assert found.weighed
    np.testing.assert_allclose(found.values[:2], (1.0, 0.3), atol=0.005)
    again = fit(problem, SHIPPED.left_open(["none"]), found.values, Watch(), stages=REFINEMENT, begun=found)
    assert again.weighed
    np.testing.assert_allclose(again.values[:2], (1.0, 0.3), atol=0.005)
    assert again.jacobian.shape[1] == 2
    assert again.scatter is not None
    assert again.scatter.shape == (2, 2)
