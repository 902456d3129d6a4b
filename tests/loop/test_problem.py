# SPDX-License-Identifier: Apache-2.0
"""Residuals are those of samples that were measured: a gap in a recording has none, a perfect replay has zeros."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.discrepancies.path_shape import PathShape
from trueup.discrepancies.plain import Plain
from trueup.ends import Ended, When, with_end
from trueup.engines.simulator import Rollout, Simulator
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.loop.replay import replays
from trueup.loop.uncertainty import unit_covariance
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]
Formula = Callable[[Callable[[Array, Array, float], Array], ParameterSpace], Simulator]
SPACE = ParameterSpace((Parameter("a", "", 1.0, 0.0, 2.0), Parameter("b", "", 0.0, -1.0, 1.0)))
TIME = np.linspace(0.0, 4.0, 401)


def line(time: Array, values: Array, step: float) -> Array:
    return values[0] * time + values[1]


def recording(values: Array, name: str = "r") -> Recording:
    return Recording(name, {"position": Channel("position", ("x",), "m", TIME, values[:, None])})


def test_an_error_is_that_of_the_samples_that_were_measured(formula: Formula) -> None:
    values = TIME + 0.1
    values[100:300] = np.nan
    problem = Problem(formula(line, SPACE), [recording(values)], Plain())
    residual = problem.residuals(SPACE.nominal[None])[0]
    assert residual.shape == (201,)
    assert problem.rmse(residual) == pytest.approx(0.1)


@pytest.mark.parametrize("deviation", [0.001, 0.01])
def test_what_is_shown_as_noise_is_the_recordings_own_and_not_what_errors_are_counted_in(
    formula: Formula, deviation: float
) -> None:
    noisy = recording(TIME + deviation * np.random.default_rng(0).standard_normal(len(TIME)))
    shipped = formula(lambda time, _values, _step: time, ParameterSpace(()))
    (replay,) = replays(shipped, np.zeros(0), [noisy], [], Plain({"position": 0.02}), against=shipped, windows=4.0)
    assert replay.noise == pytest.approx(deviation, rel=0.3)


def test_samples_that_are_replayed_exactly_count(formula: Formula) -> None:
    values = np.where(np.arange(len(TIME)) % 2 == 0, TIME, TIME + 0.1)
    problem = Problem(formula(line, SPACE), [recording(values)], Plain())
    residual = problem.residuals(SPACE.nominal[None])[0]
    assert problem.rmse(residual) == pytest.approx(0.1 / np.sqrt(2.0), rel=1e-2)
    assert problem.rmse(np.zeros_like(residual)) == 0.0


def test_a_gap_changes_intervals_by_what_is_missing_and_not_by_how_it_is_kept(formula: Formula) -> None:
    """Half of the samples gone from white noise: variances double, whether the gap is in the file or not."""
    noise = np.random.default_rng(0).standard_normal(len(TIME))
    simulator = formula(line, SPACE)
    spread = []
    for missing in ([], np.arange(0, len(TIME), 2)):
        values = TIME + noise
        values[missing] = np.nan
        problem = Problem(simulator, [recording(values)], Plain())
        rows = SPACE.nominal + np.array([[0.0, 0.0], [2e-3, 0.0], [0.0, 2e-3]])
        residuals = problem.residuals(rows)
        slopes = (residuals[1:] - residuals[0]).T / 1e-3
        fit = Fit(SPACE, np.full(2, 0.5), residuals[0], slopes, np.ones(len(slopes)), "")
        spread.append(np.sqrt(np.diag(unit_covariance(problem, fit))))
    assert np.allclose(spread[1] / spread[0], np.sqrt(2.0), rtol=0.15)


def test_a_channel_without_a_single_sample_says_nothing(formula: Formula) -> None:
    simulator, full = formula(line, SPACE), recording(TIME + 0.1)
    problem = Problem(simulator, [full, recording(np.full(len(TIME), np.nan), "empty")], Plain())
    alone = Problem(simulator, [full], Plain())
    residual = problem.residuals(SPACE.nominal[None])[0]
    assert np.array_equal(residual, alone.residuals(SPACE.nominal[None])[0])
    assert problem.chance(residual) == alone.chance(residual)


def test_a_discrepancy_that_does_not_compare_sample_by_sample_says_what_it_compares() -> None:
    measure = PathShape(spacing=0.1)
    path = np.stack([TIME, 0.1 * TIME], axis=1)
    real = Recording("r", {"position": Channel("position", ("x", "y"), "m", TIME, path)})
    trial = Trial.of(real)
    mask = measure.compared(real, trial)
    residual = measure.residual(real, Rollout(trial, {"position": path[None] + [0.3, 0.2]}, {}))
    assert mask.shape == residual.shape[1:]
    assert 0 < mask.sum() < mask.size
    assert not residual[0, ~mask].any()
    assert np.abs(residual[0, mask]).max() > 0.0


@dataclass(frozen=True)
class Stopping:
    """Wraps a simulator: rows whose first value is above 1 end at 2 s."""

    whole: Simulator

    def __getattr__(self, name: str) -> object:
        return getattr(self.whole, name)

    def rollout(self, trials: Sequence[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        assert all(t.ends for t in trials)
        done = []
        for rollout in self.whole.rollout(trials, values):
            rows = {int(row): Ended(2.0, "fallen") for row in np.flatnonzero(values[:, 0] > 1.0)}
            ending = replace(rollout, ends=rows)
            ending.channels["position"][~ending.lasted("position")] = np.nan
            done.append(ending)
        return done


def test_a_candidate_gains_nothing_by_ending_early(formula: Formula) -> None:
    """The robot went on to 4 s; a run that stops at 2 s is compared with all of it, where it stopped."""
    stopping: Simulator = Stopping(formula(line, SPACE))  # type: ignore[assignment]
    problem = Problem(
        stopping,
        [recording(TIME)],
        Plain(),
        ends=(When("fallen", lambda seen: np.full(len(seen.position), seen.time > 2.0)),),
    )
    good, stopped = problem.residuals(np.array([[1.0, 0.0], [1.001, 0.0]]))
    assert np.isfinite(stopped).all()
    assert np.abs(good).max() < 1e-12
    assert stopped[-1] == pytest.approx(2.002 - 4.0)
    assert problem.shortened(1.0).trials[0].ends


def test_what_was_measured_of_a_robot_after_its_end_is_not_compared(formula: Formula) -> None:
    fell = with_end(recording(np.minimum(TIME, 3.0)), Ended(3.0, "fallen"))
    problem = Problem(formula(line, SPACE), [fell], Plain())
    residual = problem.residuals(SPACE.nominal[None])[0]
    assert len(residual) == 301
    assert np.abs(residual).max() < 1e-12
