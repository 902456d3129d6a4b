# SPDX-License-Identifier: Apache-2.0
"""A simulator and an approximation of it as one: the trials that the approximation misses are simulated exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.controllers.controller import ControllerFactory
from trueup.engines.simulator import Rollout, Simulator
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.trial import Trial

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Mixed:
    """A Simulator with the parameters of `whole`, which simulates the trials named in `exact` itself."""

    whole: Simulator
    approximation: Simulator
    exact: frozenset[str] = frozenset()

    @property
    def name(self) -> str:
        """The model's name."""
        return self.whole.name

    @property
    def parameters(self) -> ParameterSpace:
        """What may be calibrated."""
        return self.whole.parameters

    @property
    def step(self) -> float:
        """Integration step, in s."""
        return self.whole.step

    def at_step(self, step: float) -> Mixed:
        """Both with another step."""
        return replace(self, whole=self.whole.at_step(step), approximation=self.approximation.at_step(step))

    def shipped(self) -> Simulator:
        """The simulator as it came."""
        return self.whole.shipped()

    def observable(self, recording: Recording) -> tuple[str, ...]:
        """The channels of a recording that the simulator can reproduce."""
        return self.whole.observable(recording)

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        """See Simulator."""
        done: dict[int, Rollout] = {}
        for simulator, which in (
            (self.whole, [k for k, t in enumerate(trials) if t.name in self.exact]),
            (self.approximation, [k for k, t in enumerate(trials) if t.name not in self.exact]),
        ):
            if which:
                done.update(zip(which, simulator.rollout([trials[k] for k in which], values, controllers), strict=True))
        return [done[k] for k in range(len(trials))]
