# SPDX-License-Identifier: Apache-2.0
"""A simulator of any engine that offers a model and steps it: parameters written, signals shaped, channels read off."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from trueup.arrays import Array
from trueup.articulated.assignments import Assignment
from trueup.articulated.gains import Gains
from trueup.articulated.model import Engine
from trueup.articulated.pose import POSITION
from trueup.articulated.run import STATES, Run
from trueup.articulated.signals import Signals
from trueup.articulated.starts import measured_base
from trueup.articulated.wiring import commanded, joints_commanded
from trueup.controllers.controller import ControllerFactory
from trueup.engines.simulator import Rollout
from trueup.errors import ModelError, unknown_name
from trueup.parameters import ParameterSpace
from trueup.reckoned import reckoned_of
from trueup.recording import Recording, is_command
from trueup.trial import STEP, Trial, command_of


@dataclass(frozen=True, eq=False)
class ArticulatedSimulator:
    """A `Simulator` of an engine's model; `quantities[i]` says what parameter i sets (see `declarations.declare`)."""

    engine: Engine
    parameters: ParameterSpace = field(default_factory=lambda: ParameterSpace(()))
    quantities: tuple[Assignment, ...] = ()
    step: float = STEP
    gains: Gains = field(default_factory=Gains)
    """What the recordings say of the servos' settings."""

    @property
    def name(self) -> str:
        """The model's name."""
        return self.engine.name

    def at_step(self, step: float) -> ArticulatedSimulator:
        """The same with another step, in s."""
        return dataclasses.replace(self, step=step)

    def with_parameters(self, space: ParameterSpace) -> ArticulatedSimulator:
        """The same with other nominal values or frozen flags (names and order must stay)."""
        if space.names != self.parameters.names:
            raise ModelError("with_parameters needs the same parameters in the same order")
        return dataclasses.replace(self, parameters=space)

    def shipped(self) -> ArticulatedSimulator:
        """The same model as it came, without parameters."""
        return dataclasses.replace(self, parameters=ParameterSpace(()), quantities=())

    def observable(self, recording: Recording) -> tuple[str, ...]:
        """Positions, speeds and torques of joints, and the model's own channels.

        Raises UnknownNameError for commands and joints that are not there.
        """
        command = command_of(recording)
        if command is not None:
            commanded(self.engine, command)
        seen = [c for name, c in recording.channels.items() if not is_command(name) and name in STATES]
        for channel in seen:
            for label in channel.labels:
                if label not in self.engine.drives():
                    where = f"model '{self.name}' (channel '{channel.name}' of recording '{recording.name}')"
                    raise unknown_name("joint", label, self.engine.drives(), where)
        channels = self.engine.channels().items()
        reckoned = reckoned_of(recording)
        own = [
            n for n, labels in channels
            if recording.has(n) and n not in reckoned and set(recording.channel(n).labels) <= set(labels)
        ]  # fmt: skip
        return (*(c.name for c in seen), *own)

    @property
    def commanded(self) -> tuple[str, ...]:
        """(width,) the joint that each column of a controller's command drives."""
        return joints_commanded(self.engine)

    def placed(self, trial: Trial) -> bool:
        """See `engines.simulator.Floating`."""
        return POSITION not in self.engine.channels() or measured_base(trial) is not None

    def held(self, trial: Trial) -> Array:
        """(width,) what is told to drives that nobody commands in a trial."""
        return Signals(self.engine, (), [trial], np.zeros((1, 0))).hold(0)

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        """See Simulator. Where there are controllers, values (b, n) hold their parameters after the model's.

        Raises ModelError for trials that push bodies of copies that cannot be pushed.
        """
        values = np.atleast_2d(np.asarray(values, dtype=np.float64))
        with np.errstate(all="ignore"):  # what blows up is reported
            return [
                Run(
                    self.engine, self.quantities, self.gains, self.step, t, values, t.controller or controllers
                ).rollout()
                for t in trials
            ]
