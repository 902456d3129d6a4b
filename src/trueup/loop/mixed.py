# SPDX-License-Identifier: Apache-2.0
"""A simulator and an approximation of it as one: the trials that the approximation misses are simulated exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from trueup.arrays import Array
from trueup.controllers.controller import ControllerFactory
from trueup.engines.simulator import InPlaceOf, Rollout, Simulator
from trueup.parameters import ParameterSpace
from trueup.trial import Trial


@dataclass(frozen=True, eq=False)
class Mixed(InPlaceOf):
    """A Simulator with the parameters of `whole`, which simulates the trials named in `exact` itself."""

    whole: Simulator
    approximation: Simulator
    exact: frozenset[str] = frozenset()

    @property
    def parameters(self) -> ParameterSpace:
        """What may be calibrated."""
        return self.whole.parameters

    def at_step(self, step: float) -> Mixed:
        """Both with another step."""
        return replace(self, whole=self.whole.at_step(step), approximation=self.approximation.at_step(step))

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
