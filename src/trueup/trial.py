# SPDX-License-Identifier: Apache-2.0
"""One planned run: where it starts, who controls it, what is observed, for how long, within which limits, what ends it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from trueup.arrays import Array, Mask
from trueup.chance import Chance, Disturbance, Sensing
from trueup.errors import RecordingError, TrialError
from trueup.parameters import Parameter
from trueup.recording import Channel, Recording, is_command

COMMANDS = (
    "command_sent", "command", "command_sent_torque", "command_torque", "command_sent_velocity", "command_velocity",
)  # fmt: skip
"""Channel names that hold commands, the better first: what was sent beats what was requested; 'command' is a position
of a joint, or whatever else a robot takes."""

ENABLED = "torque_enable"
"""Channel that is zero while a drive is off."""


@dataclass(frozen=True, eq=False)
class Limits:
    """What a robot may not exceed in a trial; NaN where there is no limit. All arrays are (k,), columns as `labels`."""

    labels: tuple[str, ...]
    lower: Array
    upper: Array
    """Joint range in rad or m."""
    speed: Array
    """In rad/s or m/s."""
    effort: Array
    """In N m or N."""
    workspace: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Label of any other thing that is measured or planned (x and y of a path) to its range, in its SI unit."""


@dataclass(frozen=True, eq=False)
class Reference:
    """A table that a robot needs to perform a trial: a path to follow, a trajectory, keyframes."""

    labels: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    """(N, k), one column a label, in `units`."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Each label with its unit: 'x [m]'."""
        return tuple(f"{label} [{unit}]" for label, unit in zip(self.labels, self.units, strict=True))


@dataclass(frozen=True)
class Observed:
    """What is to be read off: labels of one channel at given instants."""

    labels: tuple[str, ...]
    unit: str
    time: Array
    """(T,) in s, on the trial's clock; the trial starts at `Trial.start`."""


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
    settings: Array | None = None
    """(b, m) parameters of the controllers of these copies, for the conditions that end a run; None where nobody says."""


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


ControllerFactory = Callable[[Array], Controller]
"""Makes the controller of b simulations from their controller parameters (b, m)."""


STEP = 0.002
"""s: integration step of a simulation unless a model or a user says otherwise, as MuJoCo's models have it."""
LONGEST_STEP = 0.005
"""s: the longest that is taken because a model says so; a longer one is never taken by itself."""
SETTLE = 1.0
"""s of the first command before a trial, for servos and motors to forget where they started."""
LOOK = 0.02
"""s from one look at the conditions to the next: a fall takes some tenths of a second."""


ENDED = "ended"
"""Key of a recording's provenance: when its run ended before its time, in s on the recording's clock, and why."""


@dataclass(frozen=True)
class Ended:
    """That a run ended before its time."""

    at: float
    """In s, on the clock of its trial or recording."""
    name: str
    """The condition: 'fallen'."""


class End(Protocol):
    """A condition that ends a run as soon as it holds."""

    @property
    def name(self) -> str:
        """What is said of a run that ended so: 'fallen'."""
        ...

    @property
    def looks_at(self) -> Mapping[str, tuple[str, ...]]:
        """Channels, each to the labels of the columns that `reached` wants in `Observation.channels`."""
        ...

    def reached(self, observation: Observation) -> Mask:
        """(b,) for which of b runs it holds now. `channels` hold the truth, without noise or latency of sensors."""
        ...


@dataclass(frozen=True, eq=False)
class Watched:
    """That a run ahead can be judged by eyes and a stop watch, and what these are to look at (`watched_run.WatchedRun`)."""

    lines: tuple[float, ...] = ()
    """m ahead of the start, where the time is taken; () where how far it comes in the trial's duration is measured."""
    fastest: Callable[[Array], float] | None = None
    """m/s beyond which a time is a slip of the pen, of a trial's settings (m,) in their order."""
    arrived: str = ""
    veered: str = ""
    fallen: str = "fallen"
    """Names of the trial's ends: at the last line, aside of its lane, and down; '' of one that it has not."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One planned run. A recording gives the trial that would repeat it (`Trial.of`)."""

    name: str
    start: float
    """Instant at which the run starts, in s, on the clock of `command` and `observed`."""
    duration: float
    """In s."""
    command: Channel | None
    """What is commanded (held between its samples), or None where a controller decides."""
    observed: Mapping[str, Observed]
    initial: Mapping[str, Channel] = field(default_factory=dict)
    """Measured channels around the start, from which a simulator estimates its start state."""
    corrections: Mapping[str, Array] = field(default_factory=dict)
    """Channel of `initial` to (2, k): what is added to the values and to the speeds that its samples give for the start."""
    initial_sd: Mapping[str, Array] = field(default_factory=dict)
    """Channel of `initial` to (2, k): standard deviations of the values and the speeds that its samples give for the start,
    beside what these scatter; of what was reckoned."""
    limits: Limits | None = None
    repeats: int = 1
    settings: Mapping[str, float] = field(default_factory=dict)
    """What the controller on the robot is to be set to (gains), by the names and in the units of the task's parameters."""
    references: Mapping[str, Reference] = field(default_factory=dict)
    """Tables that the controller on the robot follows, by name ('path')."""
    tuned: tuple[Parameter, ...] = ()
    """What `settings` are values of: their units and what they mean."""
    notes: tuple[str, ...] = ()
    """What whoever performs it must know besides: frames, signs, what counts as its end."""
    controller: ControllerFactory | None = None
    """Makes this trial's own controller of b copies from controller parameters (b, m); None: the one of the call."""
    ends: tuple[End, ...] = ()
    """Conditions that end a run before `duration`; the first one that holds counts."""
    watched: Watched | None = None
    """Where what people see of a run will do in place of a log."""
    disturbances: tuple[Disturbance, ...] = ()
    """What happens to a run by chance, in the simulator; see `seeded`."""
    sensing: tuple[Sensing, ...] = ()
    """How late and noisy channels are measured, in the simulator."""
    chance: Chance | None = None
    """From what disturbances and noise are drawn."""
    performs: str = ""
    """In a campaign, which counts its runs: the task's trial that this one performs, by its name."""
    pace: Channel | None = None
    """Speeds commanded beside positions of the same joints."""

    def seeded(self, rng: np.random.Generator, *, alike: bool = False) -> Trial:
        """The same trial with its disturbances and noise settled by a generator, each row of a simulation by itself.

        `alike`: all rows meet the same. A trial that is simulated again meets the same again.
        """
        return dataclasses.replace(self, chance=Chance(int(rng.integers(2**63)), alike))

    @property
    def runs(self) -> tuple[str, ...]:
        """The name of each of its runs, as their recordings are called."""
        return (self.name,) if self.repeats == 1 else tuple(f"{self.name}-{i + 1}" for i in range(self.repeats))

    def from_row(self, first: int) -> Trial:
        """The same for rows of which the first is number `first` of all: each meets what it would meet among all of them."""
        if self.chance is None or not first:
            return self
        return dataclasses.replace(self, chance=dataclasses.replace(self.chance, first=self.chance.first + first))

    def settled(self) -> Chance:
        """`chance`. Raises TrialError where nothing was settled."""
        if self.chance is None:
            kinds = [type(d).__name__ for d in self.disturbances] + [f"noise on '{s.channel}'" for s in self.sensing]
            raise TrialError(
                f"trial '{self.name}' declares {', '.join(kinds)}, but nothing says what they are: take "
                "trial.seeded(np.random.default_rng(seed))"
            )
        return self.chance

    @classmethod
    def of(cls, recording: Recording, channels: Sequence[str] | None = None) -> Trial:
        """The trial that repeats `recording`, observing `channels` (all but commands if None), up to its end.

        Raises RecordingError where nothing was measured.
        """
        measured = [name for name in recording.channels if not is_command(name)]
        wanted = measured if channels is None else list(channels)
        if not wanted:
            raise RecordingError(
                f"recording '{recording.name}' holds no measured channel; it has: {', '.join(recording.channels) or 'none'}"
            )
        observed = {name: Observed(c.labels, c.unit, c.time) for name in wanted for c in (recording.channel(name),)}
        command, told = (c := command_of(recording)), "" if c is None else c.name
        starts = [o.time[0] for o in observed.values()] + ([command.time[0]] if command is not None else [])
        stop = max(o.time[-1] for o in observed.values())
        end = ended(recording)
        if end is not None:  # what was measured of a robot that lies on the floor is no part of the run
            stop = max(min(stop, end.at), min(o.time[0] for o in observed.values()))
            observed = {
                n: dataclasses.replace(o, time=o.time[o.time <= stop]) for n, o in observed.items() if o.time[0] <= stop
            }
        # A channel that begins later than the others is simply not observed before.
        start = min(starts) if command is None else max(min(starts), min(o.time[0] for o in observed.values()))
        return cls(
            name=recording.name, start=float(start), duration=float(stop - start), command=command, observed=observed,
            initial={name: recording.channel(name) for name in measured}, pace=recording.channels.get(f"{told}_velocity"),
        )  # fmt: skip


def with_end(recording: Recording, ended: Ended) -> Recording:
    """The recording of a run that is known to have ended so; what was measured later stays in it."""
    return recording.replace(provenance={**recording.provenance, ENDED: f"{ended.at!r} {ended.name}"})


def ended(recording: Recording) -> Ended | None:
    """When and why the run of a recording ended before its time, as whoever recorded it says; None where it did not.

    A slice that stops earlier shows no end.
    """
    at, _, name = recording.provenance.get(ENDED, "").partition(" ")
    last = recording.time[-2:]
    return Ended(float(at), name) if name and float(at) <= recording.stop + LOOK + last[-1] - last[0] else None


def command_of(recording: Recording) -> Channel | None:
    """The command channel of a recording: what was sent if it is known, else what was requested, else None."""
    return next((recording.channel(name) for name in COMMANDS if recording.has(name)), None)


def shared_joints(command: Channel, position: Channel) -> tuple[str, ...]:
    """Labels of positions that are commanded in the same unit: not those that are told speeds or torques."""
    return tuple(x for x in position.labels if x in command.labels and command.unit_of(x) == position.unit_of(x))


def drives_off(recording: Recording) -> bool:
    """Whether a recording says that all its drives were off all along."""
    return recording.has(ENABLED) and not np.nan_to_num(recording.channel(ENABLED).values).any()
