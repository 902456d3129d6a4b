# SPDX-License-Identifier: Apache-2.0
"""What a simulator must offer: parameters that may be calibrated, and rollouts of many candidates at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.controllers.controller import ControllerFactory
from trueup.ends import Ended, with_end
from trueup.engines.floating import passive, placed, swings
from trueup.errors import ModelError
from trueup.parameters import ParameterSpace
from trueup.reckoned import reckoned_as
from trueup.recording import Channel, Recording
from trueup.rounding import SAME_INSTANT
from trueup.trial import Trial
from trueup.watched_run import WatchedRun


@dataclass(frozen=True, eq=False)
class Rollout:
    """One trial simulated for b candidates, read off at the instants and labels that the trial observes."""

    trial: Trial
    channels: Mapping[str, Array]
    """Channel name to (b, T, k), in the unit of `trial.observed`; NaN after the instant where a simulation failed or
    the run ended."""
    failures: Mapping[int, str]
    """Row to the reason why its simulation broke off; empty if all went well."""
    ends: Mapping[int, Ended] = field(default_factory=dict)
    """Row to when and why its run ended before its time, on the trial's clock: an outcome, not a failure."""
    settings: Array | None = None
    """(b, m) parameters of the controller of each row, for scores that depend on them; None where they are not known."""
    watched: Mapping[int, WatchedRun] = field(default_factory=dict)
    """Row to what people saw of its run, where nothing was measured: its channels are NaN."""

    def lasted(self, channel: str) -> Mask:
        """(b, T) which samples of a channel lie before the end of their run."""
        time = self.trial.observed[channel].time
        stop = np.full(len(self.channels[channel]), np.inf)
        for row, ended in self.ends.items():
            stop[row] = ended.at
        return time <= stop[:, None] + SAME_INSTANT

    def held(self) -> Rollout:
        """The same with what was last known held from the end of each row on.

        So simulations are compared with recordings that go on. A run that ended is then judged at all the instants at which
        the robot was measured: were those after its end left out, candidates would gain by falling early, and the
        residuals of two candidates would not be the same samples, between which slopes are taken.
        """
        if not self.ends:
            return self
        channels = {}
        for name, values in self.channels.items():
            lasted = self.lasted(name)
            # What a run never showed stays NaN.
            last = np.maximum.accumulate(np.where(lasted, np.arange(lasted.shape[1]), 0), axis=1)
            channels[name] = np.take_along_axis(values, last[:, :, None], axis=1)
        return replace(self, channels=channels)

    def recording(self, row: int = 0) -> Recording:
        """One candidate's run as a Recording, command included; up to its end where it has one."""
        channels = {
            name: Channel(name, o.labels, o.unit, o.time, self.channels[name][row])
            for name, o in self.trial.observed.items()
        }
        if self.trial.command is not None:
            channels = {"command": self.trial.command.replace(name="command"), **channels}
        made = Recording(self.trial.name, channels, {"source": "simulated"})
        if row not in self.ends:
            return made
        ended = self.ends[row]
        return with_end(made.slice(made.start, max(ended.at, float(made.time[0]))), ended)


def refuse_unsupported(simulator: str, trials: Sequence[Trial], *kinds: str) -> None:
    """For a simulator that cannot do something a trial may declare: `kinds` of 'ends', 'disturbances', 'sensing'.

    Raises ModelError that names simulator, trial and what it declares.
    """
    for trial in trials:
        for kind in kinds:
            declared = getattr(trial, kind)
            if declared:
                words = ", ".join(getattr(d, "name", type(d).__name__) for d in declared)
                raise ModelError(
                    f"simulator '{simulator}' does not support {kind}; trial '{trial.name}' declares {kind}: {words}"
                )


REFUSED = "refused after"
"""How the reason begins of a run that left what a simulator was learned from: nothing is wrong with its step or model."""


def broken(done: Sequence[Rollout], simulator: Simulator) -> str:
    """Why simulations broke off, with what may mend it; '' where none did."""
    reasons = dict.fromkeys(f"'{r.trial.name}': {why}" for r in done for why in r.failures.values())
    if not reasons:
        return ""
    if all(why.startswith(REFUSED) for r in done for why in r.failures.values()):
        return f"{'; '.join(reasons)}. Leave it out, or learn from runs of its kind too"
    return (
        f"{'; '.join(reasons)}. At a step of {1e3 * simulator.step:g} ms: take a shorter one, or look for a stiffness, a "
        "mass or an inertia in the model that cannot be"
    )


class Simulator(Protocol):
    """A simulator of one robot. `trueup.testing.check_simulator` holds the contract as tests.

    Trials may bring a controller of their own, ends, disturbances and sensing; a simulator that has no such thing says so
    (`refuse_unsupported`). Where a controller acts, each trial has its own, of as many copies as there are values.
    """

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
        """Every trial for every row of values (b, n); one Rollout a trial. A failed simulation is never fatal.

        A trial's own controller goes before `controllers`; the trial's `chance` settles all that is random.
        """
        ...


class InPlaceOf:
    """What a Simulator that stands in another one's place leaves to the `whole` that it wraps."""

    whole: Simulator

    @property
    def name(self) -> str:
        """The model's name."""
        return self.whole.name

    @property
    def step(self) -> float:
        """Integration step, in s."""
        return self.whole.step

    def shipped(self) -> Simulator:
        """The simulator as it came."""
        return self.whole.shipped()

    def observable(self, recording: Recording) -> tuple[str, ...]:
        """The channels of a recording that the simulator can reproduce."""
        return self.whole.observable(recording)

    def placed(self, trial: Trial) -> bool:
        """See `floating.placed`."""
        return placed(self.whole, trial)

    def passive(self, trial: Trial) -> bool:
        """See `floating.passive`."""
        return passive(self.whole, trial)

    def swings(self, trial: Trial) -> bool:
        """See `floating.swings`."""
        return swings(self.whole, trial)

    def reckoned(self, recording: Recording) -> Recording | None:
        """See `reckoned.Reckoning`."""
        return reckoned_as(self.whole, recording)


CONTACTS = "contacts of another softness"
"""The structure of a simulator whose robot touches something: while it is wrong, nothing else is found as it is."""


@runtime_checkable
class Related(Protocol):
    """A simulator that knows of quantities which its parameters may be confused with."""

    def related(self) -> Simulator | None:
        """The same simulator with these as further parameters behind its own; None where there are none."""
        ...

    def structures(self) -> Mapping[str, Simulator]:
        """The same simulator with what it might lack as further parameters behind its own, whose nominal values are the
        simulator as it is; by name.
        """
        ...

    def rivals(self) -> Sequence[tuple[Simulator, Mapping[str, tuple[str, ...]]]]:
        """The same simulator with those of these that begin at none as further parameters behind its own, several in one
        where the same model will do; with each structure's name and the names of its parameters.
        """
        ...


def related_of(simulator: Simulator) -> Related | None:
    """The simulator itself, not an approximation or a restricted view of it, with what it knows to be related; None where it
    knows nothing.
    """
    while not isinstance(simulator, Related):
        simulator = getattr(simulator, "whole", None)  # type: ignore[assignment]
        if simulator is None:
            return None
    return simulator


@runtime_checkable
class Approximated(Protocol):
    """A Simulator that offers a cheaper one of nearly its own behaviour, which is compared with it where it is used."""

    def approximation(self, trials: Sequence[Trial]) -> Simulator | None:
        """A Simulator with the same parameters, for these trials; None where there is none."""
        ...


@runtime_checkable
class Stretched(Protocol):
    """A Simulator that predicts a trial in stretches, each from what was measured until it begins."""

    def stretches(self, trial: Trial) -> Callable[[Array], tuple[Array, Integers]]:
        """Of instants (T,): how long before each its stretch began, in s, NaN outside of all; and the number of that."""
        ...


@runtime_checkable
class Respaced(Protocol):
    """A Simulator of which some parameters can be frozen."""

    def with_parameters(self, space: ParameterSpace) -> Simulator:
        """The same simulator with other nominal values or frozen flags; names and order stay."""
        ...


@runtime_checkable
class Commanded(Protocol):
    """A Simulator that says what the columns of a controller's command are."""

    @property
    def commanded(self) -> tuple[str, ...]:
        """(width,) the joint that each column drives, or the actuator's name where it drives no single joint."""
        ...

    def held(self, trial: Trial) -> Array:
        """(width,) what is told to drives that nobody commands in a trial."""
        ...


@runtime_checkable
class Forced(Protocol):
    """A Simulator whose controllers may push on joints past all drives (`controllers.controller.Forcing`)."""

    @property
    def forced(self) -> tuple[str, ...]:
        """The joints."""
        ...


@runtime_checkable
class Controlled(Protocol):
    """A Simulator with a controller of its own for trials that command nothing."""

    @property
    def period(self) -> float:
        """Time between two commands of the controller, in s; 0 without one."""
        ...
