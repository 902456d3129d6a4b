# SPDX-License-Identifier: Apache-2.0
"""What ends a run before its time: the robot fell, left the area, arrived, or whatever a user's own predicate says.

An end is part of what came of a run, not a failure: the run keeps its samples up to its end, and says when and why it
ended. Conditions are looked at every `LOOK` s, by simulators and in recordings alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.errors import ParameterError
from trueup.recording import Recording
from trueup.rounding import SAME_INSTANT
from trueup.trial import ENDED as ENDED
from trueup.trial import LOOK, End, Ended, Observation, ended
from trueup.trial import with_end as with_end

TILT = 0.8
"""rad from upright beyond which a robot counts as fallen."""
LOW = 0.62
"""Of its standing height: below, it lies, or sits on its knees."""


@dataclass(frozen=True)
class Fallen:
    """A free base that is lower than `height`, in m, or leans by more than `tilt`, in rad, from upright.

    Raises ParameterError where neither is given.
    """

    height: float | None = None
    tilt: float | None = None
    name: str = "fallen"
    position: str = "base_position"
    orientation: str = "base_orientation"
    """Channels with 'z' in m, and with 'roll' and 'pitch' in rad."""

    def __post_init__(self) -> None:
        """Checks that something is looked at."""
        if self.height is None and self.tilt is None:
            raise ParameterError(f"end '{self.name}': give the least height in m, the largest tilt in rad, or both")

    @property
    def looks_at(self) -> Mapping[str, tuple[str, ...]]:
        """See End."""
        low = {} if self.height is None else {self.position: ("z",)}
        return low if self.tilt is None else {**low, self.orientation: ("roll", "pitch", "yaw")}

    def reached(self, observation: Observation) -> Mask:
        """See End."""
        over: list[Mask] = []
        if self.height is not None:
            over.append(observation.channels[self.position][:, 0] < self.height)
        if self.tilt is not None:
            roll, pitch, _ = observation.channels[self.orientation].T
            # The cosine of the angle between the base's z axis and the vertical.
            over.append(np.cos(roll) * np.cos(pitch) < np.cos(self.tilt))
        return np.any(over, axis=0)


@dataclass(frozen=True)
class Left:
    """A channel outside of its area: label to lowest and highest value, in the channel's unit."""

    channel: str
    area: Mapping[str, tuple[float, float]]
    name: str = "left the area"

    @property
    def looks_at(self) -> Mapping[str, tuple[str, ...]]:
        """See End."""
        return {self.channel: tuple(self.area)}

    def reached(self, observation: Observation) -> Mask:
        """See End."""
        low, high = np.array(list(self.area.values())).T
        values = observation.channels[self.channel]
        return np.any((values < low) | (values > high), axis=1)


@dataclass(frozen=True)
class Arrived:
    """A channel `within` so far of its goal: label to value, both in the channel's unit."""

    channel: str
    goal: Mapping[str, float]
    within: float
    name: str = "arrived"

    @property
    def looks_at(self) -> Mapping[str, tuple[str, ...]]:
        """See End."""
        return {self.channel: tuple(self.goal)}

    def reached(self, observation: Observation) -> Mask:
        """See End."""
        away = observation.channels[self.channel] - np.array(list(self.goal.values()))
        return np.linalg.norm(away, axis=1) <= self.within


@dataclass(frozen=True)
class When:
    """A user's own condition: a function of an Observation of b runs that gives (b,) True where a run is to end."""

    name: str
    predicate: Callable[[Observation], Mask]
    looks_at: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Channels that it needs beyond positions, velocities and sensors; see End."""

    def reached(self, observation: Observation) -> Mask:
        """See End."""
        return np.asarray(self.predicate(observation), dtype=bool)


def which_end(ends: Sequence[End], seen: Sequence[Observation], rows: int) -> Integers:
    """(rows,) number of the first of `ends` that is reached, by what each of them sees; -1 where none is.

    Raises ParameterError for a predicate that gives another shape than (b,).
    """
    first = np.full(rows, -1)
    for k, (end, observation) in enumerate(zip(ends, seen, strict=True)):
        reached = end.reached(observation)
        if reached.shape != (rows,):
            raise ParameterError(f"end '{end.name}' gave shape {reached.shape} for {rows} runs; it must be (b,)")
        first[reached & (first < 0)] = k
    return first


def end_of(recording: Recording, ends: Sequence[End] = ()) -> Ended | None:
    """How a recording of a robot ended before its time: as its driver says, else by the first of `ends` that it shows.

    Conditions count where all channels that they look at were measured; a user's own ones without channels do not.
    """
    known = ended(recording)
    if known is not None:
        return known
    shown = []
    for end in ends:
        wanted = end.looks_at
        if not wanted or any(
            not recording.has(n) or not set(x) <= set(recording.channel(n).labels) for n, x in wanted.items()
        ):
            continue
        times = np.arange(recording.start, recording.stop + SAME_INSTANT, LOOK)
        seen = {n: recording.channel(n).select(labels).at(times) for n, labels in wanted.items()}
        reached = np.flatnonzero(end.reached(_look(times, seen)))
        shown += [Ended(float(times[reached[0]]), end.name)] if len(reached) else []
    return min(shown, key=lambda end: end.at, default=None)


def _look(times: Array, seen: Mapping[str, Array]) -> Observation:
    """All instants of a recording as if they were runs side by side."""
    none = np.zeros((len(times), 0))
    return Observation(0.0, none, none, {}, channels=seen)
