# SPDX-License-Identifier: Apache-2.0
"""What chance does to a run: pushes, starts that scatter, noisy commands, sensors with noise and latency.

All of it is declared in a trial and drawn for each row of a simulation from the trial's own seed (`Trial.seeded`), so the
same trial always gives the same runs, whatever else is simulated beside it.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array


@dataclass(frozen=True)
class Push:
    """A force on a body for a while; its instant, length, size and direction are uniform in their ranges."""

    body: str
    force: tuple[float, float]
    """Its size, in N."""
    start: tuple[float, float]
    """When it begins, in s since the start."""
    lasting: tuple[float, float]
    """In s."""
    direction: tuple[float, float, float] | None = None
    """In the world; None: horizontal, from anywhere."""


@dataclass(frozen=True)
class StartScatter:
    """The start state is not quite that of the trial: normal noise on a channel's start values."""

    channel: str
    """'position' or 'velocity' of joints, or the pose of a free base or vehicle ('base_position', 'heading')."""
    deviation: float
    """Standard deviation, in the channel's unit."""
    labels: tuple[str, ...] = ()
    """Which of them; () for all."""


@dataclass(frozen=True)
class CommandNoise:
    """What arrives at the drives is not quite what was commanded: normal noise, drawn anew every `every` s."""

    deviation: float
    """Standard deviation, in the command's unit."""
    labels: tuple[str, ...] = ()
    """Actuators or the joints that they drive; () for all."""
    every: float = 0.02
    """In s."""


@dataclass(frozen=True)
class Buffeting:
    """A body that is never left in peace: a horizontal force that wanders, for uneven ground, cables and wind.

    A first-order Gauss-Markov process along each of the world's axes x and y, drawn anew every `every` s.
    """

    body: str
    force: float
    """Standard deviation along each axis, in N."""
    memory: float = 0.15
    """Time constant, in s."""
    every: float = 0.1
    """In s."""

    def forces(self, duration: float, streams: Streams) -> Array:
        """(b, n, 2) N, from each `every` s on."""
        drawn = streams.normal(int(np.ceil(duration / self.every)) + 1, 2)
        kept = np.exp(-self.every / self.memory)
        for k in range(1, drawn.shape[1]):
            drawn[:, k] = kept * drawn[:, k - 1] + np.sqrt(1.0 - kept**2) * drawn[:, k]
        return self.force * drawn


Disturbance = Push | StartScatter | CommandNoise | Buffeting


@dataclass(frozen=True)
class Sensing:
    """How a channel is measured: late, and with normal noise that is drawn anew for each sample.

    Controllers see it so, and so it is read off. What ends a run and what is scored by simulators' own truth does not.
    """

    channel: str
    """A channel of the trial ('position', 'velocity', 'base_position', ...) or a sensor of the model by its name."""
    noise: float = 0.0
    """Standard deviation, in the channel's unit."""
    latency: float = 0.0
    """In s."""
    labels: tuple[str, ...] = ()
    """Which columns are noisy; () for all. All are late."""
    bias: float = 0.0
    """Standard deviation, in the channel's unit, of an error that stays for a whole run, of controllers' sensors."""


@dataclass(frozen=True)
class Chance:
    """From what a trial's rows draw."""

    seed: int
    alike: bool = False
    """All rows meet the same chance: candidates can then be compared more closely than by luck."""
    first: int = 0
    """Which row of all the first one is, where only some of them are simulated."""

    def streams(self, purpose: str, rows: int) -> Streams:
        """For each row a stream of its own, for one purpose; the other rows and purposes change nothing in it."""
        key = zlib.crc32(purpose.encode())
        numbers = [0] if self.alike else range(self.first, self.first + rows)
        return Streams([np.random.default_rng([self.seed, key, row]) for row in numbers], rows)


class Streams:
    """Random numbers for b rows, each row from its own generator."""

    def __init__(self, generators: Sequence[np.random.Generator], rows: int) -> None:
        self._generators, self._rows = generators, rows

    def normal(self, *shape: int) -> Array:
        """(b, *shape) standard normal numbers."""
        return self._each(np.stack([g.standard_normal(shape) for g in self._generators]))

    def uniform(self, low: float, high: float) -> Array:
        """(b,) uniform numbers."""
        return self._each(np.array([g.uniform(low, high) for g in self._generators]))

    def _each(self, values: Array) -> Array:
        return values if len(values) == self._rows else np.repeat(values, self._rows, axis=0)


@dataclass(frozen=True, eq=False)
class Pushed:
    """One push as b rows meet it."""

    body: str
    start: Array
    """(b,) in s since the start."""
    stop: Array
    force: Array
    """(b, 3) in N, in the world."""

    @classmethod
    def of(cls, push: Push, streams: Streams) -> Pushed:
        """The push that each row meets."""
        start, lasting = streams.uniform(*push.start), streams.uniform(*push.lasting)
        size, angle = streams.uniform(*push.force), streams.uniform(-np.pi, np.pi)
        toward = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))], axis=1)
        if push.direction is not None:
            toward[:] = np.array(push.direction) / np.linalg.norm(push.direction)
        return cls(push.body, start, start + lasting, size[:, None] * toward)
