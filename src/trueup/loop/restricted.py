# SPDX-License-Identifier: Apache-2.0
"""A simulator of which only some parameters are calibrated; the others stay as they are, and are still applied."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass

from trueup.arrays import Array
from trueup.controllers.controller import ControllerFactory
from trueup.engines.simulator import Approximated, Controlled, InPlaceOf, Rollout, Simulator
from trueup.errors import unknown_name
from trueup.parameters import ParameterSpace
from trueup.trial import Trial


@dataclass(frozen=True, eq=False)
class Restricted(InPlaceOf):
    """A Simulator with another one's behaviour and a parameter space of its own: the same names, other ones frozen."""

    whole: Simulator
    parameters: ParameterSpace

    @classmethod
    def to(cls, simulator: Simulator, patterns: Sequence[str]) -> Restricted:
        """Only what matches a pattern stays free, and of the others that were nothing is known (`Parameter.requested`).

        Raises UnknownNameError for a pattern that matches none.
        """
        names = simulator.parameters.names
        for pattern in patterns:
            if not fnmatch.filter(names, pattern):
                raise unknown_name("parameter", pattern, names, f"simulator '{simulator.name}'")
        frozen = [n for n in names if not any(fnmatch.fnmatchcase(n, p) for p in patterns)]
        fewer, free = simulator.parameters.left_out(frozen).parameters, simulator.parameters.free
        parameters = (
            p.replace(requested=p.requested and not (f and p.frozen)) for p, f in zip(fewer, free, strict=True)
        )
        return cls(simulator, ParameterSpace(tuple(parameters)))

    @property
    def period(self) -> float:
        """That of the whole."""
        return self.whole.period if isinstance(self.whole, Controlled) else 0.0

    def at_step(self, step: float) -> Restricted:
        """The same with another step."""
        return Restricted(self.whole.at_step(step), self.parameters)

    def approximation(self, trials: Sequence[Trial]) -> Simulator | None:
        """That of the whole, with these parameters."""
        other = self.whole.approximation(trials) if isinstance(self.whole, Approximated) else None
        return None if other is None else Restricted(other, self.parameters)

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        """See Simulator; values (b, n) of all parameters."""
        return self.whole.rollout(trials, values, controllers)
