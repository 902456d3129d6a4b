# SPDX-License-Identifier: Apache-2.0
"""Delays of what stands on a floor are looked along: slopes over a hair say nothing of them, and drives make up for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.discrepancies.discrepancy import measured_at
from trueup.engines.simulator import Rollout
from trueup.loop.delayed import behind
from trueup.loop.fit import DESCENT, fit
from trueup.loop.problem import Problem
from trueup.loop.watch import Watch
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.trial import Trial

Array = NDArray[np.float64]
SIGMA, STEP = 1e-3, 2e-3
TIME = np.arange(0.0, 4.0, 0.01)
RATES, SIZES = (
    2.0 * np.pi * np.array([0.4, 1.1, 2.3]),
    np.array([0.3, 0.15, 0.08]),
)  # rad/s and rad of what is commanded
SPACE = ParameterSpace(
    (
        Parameter("left.lag", "s", 0.03, 0.003, 0.3, scale="log"),
        Parameter("right.lag", "s", 0.03, 0.003, 0.3, scale="log"),
        Parameter("delay", "s", 0.0, 0.0, 0.1, vanishes=True),
    )
)


def pursued(lags: Array, delay: Array, time: Array) -> Array:
    """(b, T, 2) positions of two drives of the first order with `lags` (b, 2), told `delay` (b,) late in whole steps."""
    late = STEP * np.floor(delay / STEP + 1e-6)
    turned, at = RATES * lags[:, None, :, None], time[None, :, None] - late[:, None, None]
    waves = np.sin(RATES * at[..., None, :] - np.arctan(turned)) / np.sqrt(1.0 + turned**2)
    return waves @ SIZES


@dataclass
class Pursuing:
    """Two drives of something that stands where it is; a delay acts from one step to the next."""

    parameters: ParameterSpace = SPACE
    step: float = STEP
    name: str = "pursuing"
    rows: list[int] = field(default_factory=list)

    def at_step(self, step: float) -> Pursuing:
        return replace(self, step=step)

    def observable(self, recording: Recording) -> tuple[str, ...]:
        return tuple(name for name in ("position", "base_position") if recording.has(name))

    def rollout(self, trials: Sequence[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        self.rows.append(len(values))
        done = []
        for trial in trials:
            seen = {name: np.zeros((len(values), len(o.time), len(o.labels))) for name, o in trial.observed.items()}
            seen["position"] = pursued(values[:, :2], values[:, 2], trial.observed["position"].time)
            done.append(Rollout(trial, seen, {}))
        return done


class ByNoise:
    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        return np.full(len(labels), SIGMA)

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        parts = [
            (seen - measured_at(real, name, simulated.trial.observed[name].labels, simulated.trial.observed[name].time))
            for name, seen in simulated.channels.items()
        ]
        return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1) / SIGMA


def stood(delay: float, unit: str = "rad", free: bool = True) -> Recording:
    rng = np.random.default_rng(1)
    told = np.repeat((np.sin(RATES * TIME[:, None]) @ SIZES)[:, None], 2, axis=1)
    seen = pursued(np.array([[0.02, 0.02]]), np.array([delay]), TIME)[0] + rng.normal(0.0, SIGMA, (len(TIME), 2))
    base = Channel("base_position", ("x",), "m", TIME, rng.normal(0.0, SIGMA, (len(TIME), 1)))
    channels = [
        Channel("command", ("left", "right"), unit, TIME, told),
        Channel("position", ("left", "right"), "rad", TIME, seen),
    ]
    return Recording("stood", {c.name: c for c in (*channels, *([base] if free else []))})


@pytest.mark.parametrize("delay", [0.0, 0.008, 0.018, 0.034])
def test_a_delay_that_drives_make_up_for_is_found_where_feet_touch_and_none_where_there_is_none(delay: float) -> None:
    problem = Problem(Pursuing(), [stood(delay)], ByNoise())  # type: ignore[arg-type]
    found = fit(problem, SPACE, SPACE.nominal, Watch(), stages=DESCENT)
    assert delay <= found.values[2] + 1e-6 < delay + STEP  # all of a step is alike
    assert found.values[:2] == pytest.approx([0.02, 0.02], rel=0.02)


def test_what_stands_on_no_feet_is_not_looked_along() -> None:
    looked = Pursuing(), Pursuing()
    for simulator, free in zip(looked, (False, True), strict=True):
        problem = Problem(simulator, [stood(0.018, free=free)], ByNoise())  # type: ignore[arg-type]
        fit(
            problem,
            SPACE,
            SPACE.nominal,
            Watch(),
            stages=[s for s in DESCENT if s.name == "along delays"] + [DESCENT[-4]],
        )
    assert sum(looked[0].rows) < sum(looked[1].rows)


def test_a_delay_is_a_part_of_what_positions_lag_behind_their_commands() -> None:
    assert 0.018 < behind([stood(0.018)]) < 0.018 + 0.03
    assert behind([stood(0.018, unit="N m")]) == 0.0
    ahead = stood(-0.06)
    assert behind([ahead]) == 0.0
    assert behind([ahead, stood(0.018)]) == behind([stood(0.018)])
