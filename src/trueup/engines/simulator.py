# SPDX-License-Identifier: Apache-2.0
"""What a simulator must offer: parameters that may be calibrated, and rollouts of many candidates at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trueup.controllers.controller import ControllerFactory
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.trial import Trial

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rollout:
    """One trial simulated for b candidates, read off at the instants and labels that the trial observes."""

    trial: Trial
    channels: Mapping[str, Array]
    """Channel name to (b, T, k), in the unit of `trial.observed`; NaN after the instant where a simulation failed."""
    failures: Mapping[int, str]
    """Row to the reason why its simulation broke off; empty if all went well."""

    def recording(self, row: int = 0) -> Recording:
        """One candidate's run as a Recording, command included."""
        from trueup.recording import Channel

        channels = {
            name: Channel(name, o.labels, o.unit, o.time, self.channels[name][row])
            for name, o in self.trial.observed.items()
        }
        if self.trial.command is not None:
            channels = {"command": self.trial.command.replace(name="command"), **channels}
        return Recording(self.trial.name, channels, {"source": "simulated"})


class Simulator(Protocol):
    """A simulator of one robot. `trueup.testing.check_simulator` holds the contract as tests."""

    @property
    def name(self) -> str:
        """The model's name, for reports."""
        ...

    @property
    def parameters(self) -> ParameterSpace:
        """What may be calibrated."""
        ...

    @property
    def step(self) -> float:
        """Integration step, in s."""
        ...

    def at_step(self, step: float) -> Simulator:
        """The same simulator with another step: coarser to search, finer to verify."""
        ...

    def shipped(self) -> Simulator:
        """The simulator as it came, without parameters: what the calibrated one is compared with."""
        ...

    def observable(self, recording: Recording) -> tuple[str, ...]:
        """The channels of a recording that this simulator can reproduce."""
        ...

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        """Every trial for every row of values (b, n); one Rollout a trial. A failed simulation is never fatal."""
        ...
