# SPDX-License-Identifier: Apache-2.0
"""What a controller (`trial.Controller`) may offer besides: channels that it looks at, torques, commands known ahead."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np

from trueup.arrays import Array
from trueup.trial import Controller as Controller
from trueup.trial import ControllerFactory as ControllerFactory
from trueup.trial import Observation as Observation


def as_declared(factory: ControllerFactory | None, own: Array) -> ControllerFactory | None:
    """Makes the controller with `own` (m,) values of its parameters, whatever it is given; None makes none."""
    if factory is None or not len(own):
        return factory
    return lambda values: factory(np.tile(own, (len(values), 1)))


@runtime_checkable
class Looking(Protocol):
    """A Controller that wants channels by their names, whatever simulator it runs in, in `Observation.channels`."""

    @property
    def looks_at(self) -> Mapping[str, tuple[str, ...]]:
        """Channels, each to its labels; they come late and noisy where the trial's sensing says so."""
        ...


@runtime_checkable
class Forcing(Protocol):
    """A Controller that also pushes on joints, past all drives: with what the drives of a simulator lack."""

    @property
    def forced(self) -> tuple[str, ...]:
        """The joints; none: it only commands."""
        ...

    @property
    def torque(self) -> Array:
        """(b, k) N m on them from the last command on, to the next."""
        ...


@runtime_checkable
class Foretold(Protocol):
    """A Controller that may know its commands ahead, since they depend on time alone: a simulator need not stop to ask."""

    def ahead(self, times: Array) -> Array | None:
        """(b, n, nu) what it commands at `times` (n,) since the start; None where it has to look at the robot."""
        ...
