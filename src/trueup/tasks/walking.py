# SPDX-License-Identifier: Apache-2.0
"""Walking as tasks: straight ahead for a while, through a course of targets, or to a line; means over disturbed runs.

A. Farchy, S. Barrett, P. MacAlpine and P. Stone, "Humanoid robots learning to walk faster", AAMAS 2013, section 4.1; the
course after goToTarget of P. MacAlpine et al., "Design and optimization of an omnidirectional humanoid walk", AAAI 2012.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from trueup.arrays import Array, Mask
from trueup.chance import Disturbance, Sensing
from trueup.controllers.controller import Controller, ControllerFactory
from trueup.controllers.walk_engine.requests import TARGETS, targets
from trueup.ends import End, Fallen, Left
from trueup.engines.simulator import Rollout
from trueup.parameters import ParameterSpace
from trueup.rounding import PRINTED, SAME_INSTANT
from trueup.trial import Observed, Trial

PLACE, ANGLES = "base_position", "base_orientation"
TILT = 0.8
"""rad from upright beyond which a robot counts as fallen."""
LOW = 0.62
"""Of its standing height: below, it lies, or sits on its knees."""
_BALL = 1.0  # m beyond the line, so that steering never becomes abrupt


@dataclass(frozen=True, kw_only=True, eq=False)
class Walk(ABC):
    """A Task: b walks, each judged by the mean over `runs` runs that meet different disturbances.

    Any engine fits that is made from values of `parameters` and follows a trial's targets (`walk_engine.requests`).
    """

    parameters: ParameterSpace
    make: ControllerFactory
    """Makes the engine of b robots from values (b, m)."""
    height: float
    """Of the base of the standing robot, in m."""
    share: float = 0.67
    """Of the largest step."""
    runs: int = 7
    seed: int = 0
    disturbances: tuple[Disturbance, ...] = ()
    sensing: tuple[Sensing, ...] = ()
    fall: float
    """What a fall costs, in the unit of what is made good."""
    tips: tuple[float, float] | None = None
    """rad of roll and pitch at which it stands on the edge of its sole. Where given, a run that stood counts as the fall that
    its sway makes likely (`likely_falls`)."""
    alike: bool = False
    """All walks meet the same disturbances in a run, and are told apart with less luck."""
    rate: float = 20.0
    """Of observation, in Hz."""
    trials: tuple[Trial, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Makes the trials."""
        time = np.arange(round(self.duration * self.rate) + 1) / self.rate
        plain = Trial(
            name=self.name, start=0.0, duration=float(time[-1]), command=None,
            observed={
                PLACE: Observed(("x", "y", "z"), "m", time), ANGLES: Observed(("roll", "pitch", "yaw"), "rad", time),
            },
            references={TARGETS: targets(self.course)}, ends=self.ends, disturbances=self.disturbances,
            sensing=self.sensing,
        )  # fmt: skip
        seeds = (np.random.default_rng([self.seed, k]) for k in range(self.runs))
        runs = tuple(
            replace(plain, name=f"{self.name} {k + 1}").seeded(s, alike=self.alike) for k, s in enumerate(seeds)
        )
        object.__setattr__(self, "trials", runs)

    name: str = field(init=False)
    """See Task."""
    unit: str = field(init=False, default="m/s")
    """Of the score."""

    @property
    @abstractmethod
    def duration(self) -> float:
        """Of a run, in s."""

    @property
    @abstractmethod
    def course(self) -> Array:
        """(k, 5) targets, see `walk_engine.requests.targets`."""

    @abstractmethod
    def made_good(self, rollout: Rollout) -> Array:
        """(b,) of one run, falls not yet counted."""

    @property
    def ends(self) -> tuple[End, ...]:
        """What ends a run before its time."""
        return (Fallen(height=LOW * self.height, tilt=TILT),)

    def controllers(self, values: Array) -> Controller:
        """See Task."""
        return self.make(values)

    def made_anew(self, seed: int) -> Walk:
        """The same task with other disturbances: a generation's lucky ones are not lucky twice."""
        return replace(self, seed=seed)

    def risk(self, rollout: Rollout) -> Array:
        """(b,) 1 for a run that fell; for others 0, or what `tips` let expect."""
        return fell(rollout).astype(np.float64) if self.tips is None else passing(self.swayed(rollout, self.tips))

    def swayed(self, rollout: Rollout, tips: tuple[float, float]) -> Array:
        """(b,) `sway` of each run, infinite for one that fell."""
        time = rollout.trial.observed[ANGLES].time - rollout.trial.start
        down, angles = fell(rollout), rollout.channels[ANGLES][:, :, :2]
        return np.array([np.inf if d else sway(time, a, tips) for d, a in zip(down, angles, strict=True)])

    def score(self, rollouts: Sequence[Rollout]) -> Array:
        """(b,) minus what is made good on average, `fall` taken off for each fall; NaN where no run was measured."""
        made = np.stack([self.made_good(r) - self.fall * self.risk(r) for r in rollouts])
        failed = np.stack([np.isin(np.arange(made.shape[1]), list(r.failures)) for r in rollouts])
        return -np.where(failed.any(axis=0), np.nan, made.mean(axis=0))


@dataclass(frozen=True, kw_only=True, eq=False)
class WalkFront(Walk):
    """Straight ahead for `seconds`: metres per second toward a far target. A fall ends what is made good."""

    seconds: float = 15.0
    fall: float = 0.15
    """m/s: some more than a walk is fast, so that a walk that falls every second time is no gain."""

    name: str = field(init=False, default="walk front")

    @property
    def duration(self) -> float:
        """See Walk."""
        return self.seconds

    @property
    def course(self) -> Array:
        """See Walk."""
        return np.array([[0.0, 100.0, 0.0, self.share, 0.0]])

    def made_good(self, rollout: Rollout) -> Array:
        """(b,) m/s."""
        x = rollout.held().channels[PLACE][:, :, 0]
        return (x[:, -1] - x[:, 0]) / self.seconds


@dataclass(frozen=True, kw_only=True, eq=False)
class LineWalk(Walk):
    """To a line `line` m ahead, steering to a ball beyond it: the distance over the time it takes, as on the robot.

    A run that does not arrive counts as far as it came, over the whole time; one that leaves the lane of `lane` m to each
    side is over ('veered').
    """

    line: float = 2.38
    laps: int = 1
    """How many lines lie behind one another: a trial that goes on tells as much as several."""
    lane: float = 0.75
    slowest: float = 0.05
    """m/s: who is slower does not arrive."""
    fall: float = 0.15

    name: str = field(init=False, default="walk to the line")

    @property
    def duration(self) -> float:
        """See Walk."""
        return self.far / self.slowest

    @property
    def far(self) -> float:
        """To the last line, in m."""
        return self.laps * self.line

    @property
    def course(self) -> Array:
        """See Walk."""
        return np.array([[0.0, self.far + _BALL, 0.0, self.share, 0.0]])

    @property
    def ends(self) -> tuple[End, ...]:
        """See Walk."""
        far = (-np.inf, np.inf)
        return (
            Left(PLACE, {"x": (-np.inf, self.far)}, name=ARRIVED),
            Left(PLACE, {"x": far, "y": (-self.lane, self.lane)}, name=VEERED), *super().ends,
        )  # fmt: skip

    def made_good(self, rollout: Rollout) -> Array:
        """(b,) m/s."""
        x = rollout.held().channels[PLACE][:, :, 0]
        arrived = {row: end.at - rollout.trial.start for row, end in rollout.ends.items() if end.name == ARRIVED}
        speed = np.clip(x[:, -1] - x[:, 0], 0.0, self.far) / self.duration
        speed[list(arrived)] = self.far / np.array(list(arrived.values()))
        return speed


ARRIVED, VEERED = "at the line", "veered"
"""Names of ends of a walk to the line."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OmniWalk(Walk):
    """Through a course of targets in all directions: metres made good toward each while it is the present one.

    Where the robot is to step on the spot, metres that it drifts are taken off. `sideways` False: it turns to each target
    and walks ahead, as where a real robot explores.
    """

    sideways: bool = True
    stretch: float = 1.0
    """Factor on all times of the course: longer for slower walks."""
    fall: float = 5.0
    """m, as in goToTarget."""

    name: str = field(init=False, default="walk around")
    unit: str = field(init=False, default="m")

    @property
    def duration(self) -> float:
        """See Walk."""
        return self.stretch * sum(leg[0] for leg in COURSE)

    @property
    def course(self) -> Array:
        """See Walk."""
        lasting, x, y = np.array(COURSE).T
        begun = self.stretch * (np.cumsum(lasting) - lasting)
        every = np.ones(len(x))
        return np.stack([begun, x, y, self.share * every, float(self.sideways) * every], axis=1)

    def made_good(self, rollout: Rollout) -> Array:
        """(b,) m."""
        place = rollout.held().channels[PLACE][:, :, :2]
        time, begun = rollout.trial.observed[PLACE].time, [*self.course[:, 0], self.duration]
        made = np.zeros(len(place))
        for k, target in enumerate(self.course[:, 1:3]):
            first, last = (place[:, np.searchsorted(time, begun[i] - SAME_INSTANT)] for i in (k, k + 1))
            if np.isnan(target).any():
                made -= np.linalg.norm(last - first, axis=1)
            else:
                made += np.linalg.norm(target - first, axis=1) - np.linalg.norm(target - last, axis=1)
        return made


_STOP = float("nan")
COURSE = (
    (8.0, 2.0, 0.0), (6.0, -1.0, 0.0), (5.0, 0.0, 1.0), (5.0, 0.0, -1.0), (2.0, _STOP, _STOP),  # the four directions
    (6.0, 1.5, 1.5), (6.0, 1.5, -1.5), (2.0, _STOP, _STOP), (6.0, -2.0, 0.0),  # obliquely, and about turn
    *((1.5, 0.6 * np.cos(a), 0.6 * np.sin(a)) for a in np.linspace(0.0, 2.0 * np.pi, 9)),  # a circle
    *((0.5, 3.0, 3.0 * side) for side in (1.0, -1.0) * 5), (1.0, _STOP, _STOP),  # quick changes, and a stop
)  # fmt: skip
"""Targets in the field's frame: for how long (s), x and y (m)."""


_SETTLED, _STEPS = 2.5, 30.0  # s until steps have grown; steps of 15 s, of which the logarithm counts


def sway(time: Array, angles: Array, tips: tuple[float, float]) -> float:
    """How far a run that stood swayed, squared, as a share of `tips`: roll and pitch (T, 2) at `time` (T,) since the start.

    0 for runs without a second of walk.
    """
    walked = (time > _SETTLED) & np.isfinite(angles).all(axis=1)
    if not walked.any() or np.ptp(time[walked]) < 1.0:
        return 0.0
    return float(np.square(angles[walked].std(axis=0) / tips).sum())


def passing(shares: Array) -> Array:
    """The chance of a fall in 15 s for shares of `sway`, of any shape.

    Sway that wanders like normal noise passes `tips` with exp(-tip^2 / (2 deviation^2)) a step (S. O. Rice, Bell System
    Technical Journal 24, 1945, section 3.3).
    """
    return -np.expm1(-_STEPS * np.exp(-0.5 / np.maximum(shares, PRINTED)))


def fell(rollout: Rollout) -> Mask:
    """(b,) which runs ended by a fall."""
    rows = len(next(iter(rollout.channels.values())))
    return np.array([row in rollout.ends and rollout.ends[row].name == "fallen" for row in range(rows)])
