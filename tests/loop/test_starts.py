# SPDX-License-Identifier: Apache-2.0
"""Noise on the measured start makes estimates less sure, by as much as another start would have moved them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.engines.simulator import Rollout
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.loop.starts import with_start_scatter
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]
SPACE = ParameterSpace((Parameter("speed", "m/s", 1.0, 0.0, 2.0),))
TIME = np.arange(0.0, 4.0, 0.02)
SIGMA = 0.01


@dataclass
class Runner:
    """Runs straight on from where the first sample says that it starts."""

    parameters = SPACE
    step = 0.02

    def observable(self, recording: Recording) -> tuple[str, ...]:
        return ("position",)

    def rollout(self, trials: list[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        return [
            Rollout(t, {"position": (t.initial["position"].values[0] + values * TIME)[..., None]}, {}) for t in trials
        ]


class ByNoise:
    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        return np.full(len(labels), SIGMA)

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        return ((simulated.channels["position"] - real.channel("position").values) / SIGMA).reshape(-1, len(TIME))


@pytest.mark.parametrize("level", [None, 7.0])
def test_an_estimate_that_hangs_on_the_start_is_as_unsure_as_repeated_runs_scatter(level: float | None) -> None:
    # `level`: what a cheaper problem was shifted by, which has nothing to do with the starts
    found, told = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        measured = TIME[:, None] + SIGMA * rng.standard_normal((len(TIME), 1))
        recording = Recording("run", {"position": Channel("position", ("x",), "m", TIME, measured)})
        problem = Problem(Runner(), [recording], ByNoise())  # type: ignore[arg-type]
        slopes = 2.0 * TIME[:, None] / SIGMA
        unit = 0.5 - float((slopes.T @ problem.residuals(SPACE.nominal[None])[0])[0] / np.sum(slopes**2))
        residual = problem.residuals(SPACE.from_unit(np.array([[unit]])))[0]
        near = None if level is None else problem.shifted(np.full(len(residual), level))
        fit = Fit(SPACE, np.array([unit]), residual, slopes, np.ones(len(TIME)), "", near=near)
        grown = with_start_scatter(problem, fit, rng)
        assert grown.scatter is not None
        found.append(unit)
        told.append(grown.scatter[0, 0])
    assert np.sqrt(np.mean(told)) == pytest.approx(np.std(found), rel=0.35)
