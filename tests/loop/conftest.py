# SPDX-License-Identifier: Apache-2.0
"""A simulator of one line, whose optimum, valleys and cracks are known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.engines.simulator import Rollout, Simulator
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.trial import Trial

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Formula:
    positions: Callable[[Array, Array, float], Array]
    parameters: ParameterSpace
    step: float = 0.01
    name: str = "formula"

    def at_step(self, step: float) -> _Formula:
        return replace(self, step=step)

    def shipped(self) -> _Formula:
        return self

    def observable(self, recording: Recording) -> tuple[str, ...]:
        return ("position",)

    def rollout(self, trials: Sequence[Trial], values: Array, controllers: object = None) -> list[Rollout]:
        times = [trial.observed["position"].time for trial in trials]
        read = [np.array([self.positions(time, v, self.step) for v in values]) for time in times]
        return [Rollout(trial, {"position": r[:, :, None]}, {}) for trial, r in zip(trials, read, strict=True)]


@pytest.fixture
def formula() -> Callable[[Callable[[Array, Array, float], Array], ParameterSpace], Simulator]:
    """Makes a simulator whose positions (T,) are a formula of times (T,), values (n,) and the step in s."""
    return _Formula
