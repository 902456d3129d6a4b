# SPDX-License-Identifier: Apache-2.0
"""A simulator and an approximation of it as one: what the approximation misses is simulated exactly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from trueup.arrays import Array, Integers
from trueup.controllers.controller import ControllerFactory
from trueup.engines.simulator import InPlaceOf, Rollout, Separable, Simulator
from trueup.parameters import ParameterSpace
from trueup.trial import Trial


@dataclass(frozen=True, eq=False)
class Mixed(InPlaceOf):
    """A Simulator with the parameters of `whole`, which simulates itself what is `exact`: labels of trials, by their names.

    Where the approximation tells which rows are alike in all that such labels feel (`Separable`), one of these is simulated:
    of a Jacobian, the columns of their own parameters.
    """

    whole: Simulator
    approximation: Simulator
    exact: Mapping[str, frozenset[str]] = field(default_factory=dict)

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
        every = [self.exact.get(t.name, frozenset[str]()) for t in trials]
        some = [k for k, (t, own) in enumerate(zip(trials, every, strict=True)) if not own >= _labels(t)]
        done = dict(
            zip(
                some,
                self.approximation.rollout([trials[k] for k in some], values, controllers) if some else [],
                strict=True,
            )
        )
        for labels in dict.fromkeys(own for own in every if own):
            which = [k for k, own in enumerate(every) if own == labels]
            own = [trials[k] for k in which]
            apart = not any(k in done for k in which)
            first, again = _every(values) if apart else self._apart(own, labels, values)
            for k, exact in zip(which, self.whole.rollout(own, values[first], controllers), strict=True):
                done[k] = _joined(done[k], exact, labels, again) if k in done else exact
        return [done[k] for k in range(len(trials))]

    def _apart(self, trials: Sequence[Trial], labels: frozenset[str], values: Array) -> tuple[Integers, Integers]:
        """Rows that differ in what labels feel, and (b,) which of these each row is like."""
        if not isinstance(self.approximation, Separable):
            return _every(values)
        _, first, again = np.unique(
            self.approximation.alike(trials, labels, values), return_index=True, return_inverse=True
        )
        return first, again


def _every(values: Array) -> tuple[Integers, Integers]:
    return np.arange(len(values)), np.arange(len(values))


def _labels(trial: Trial) -> frozenset[str]:
    return frozenset(label for o in trial.observed.values() for label in o.labels)


def _joined(rough: Rollout, exact: Rollout, labels: frozenset[str], again: Integers) -> Rollout:
    """An approximate rollout with some labels as they are in the exact one, row by row of `again` (b,)."""
    channels = {name: np.array(values) for name, values in rough.channels.items()}
    for name, values in channels.items():
        mine = [j for j, label in enumerate(rough.trial.observed[name].labels) if label in labels]
        values[:, :, mine] = exact.channels[name][again][:, :, mine]
    failed = {row: exact.failures[k] for row, k in enumerate(again.tolist()) if k in exact.failures}
    return replace(rough, channels=channels, failures={**rough.failures, **failed})
