# SPDX-License-Identifier: Apache-2.0
"""What a controller must offer: b copies run in lockstep, at the controller's own rate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from trueup.trial import Trial

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Observation:
    """What b copies of a controller see at one instant. Arrays are views: read, never write."""

    time: float
    """Since the start of the trial, in s."""
    position: Array
    """(b, nq) generalised positions; (b, k) of the actuated joints for robots that know no more."""
    velocity: Array
    """(b, nv) generalised velocities."""
    sensors: Mapping[str, Array]
    """Sensor name to (b, dim)."""
    trial: Trial | None = None
    """The trial that all b copies are in: its references are what is to be followed. Every simulator says it."""
    channels: Mapping[str, Array] = field(default_factory=dict)
    """Channel name to (b, k): for the conditions that end a run, the channels that they look at (see `ends.End`), for a
    controller those that it asked for (see `Looking`)."""


class Controller(Protocol):
    """Commands b simulations (or one robot) at its own rate. The command is held in between."""

    @property
    def period(self) -> float:
        """Time between two commands, in s."""
        ...

    def reset(self, observation: Observation) -> None:
        """Called once before a trial, for all b copies, which are the rows of this trial alone."""
        ...

    def command(self, observation: Observation) -> Array:
        """(b, nu) what is commanded from now on."""
        ...


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


ControllerFactory = Callable[[Array], Controller]
"""Makes the controller of b simulations from their controller parameters (b, m)."""
