# SPDX-License-Identifier: Apache-2.0
"""Walking as tasks: straight ahead for a while, or to a line; means over disturbed runs.

A. Farchy, S. Barrett, P. MacAlpine and P. Stone, "Humanoid robots learning to walk faster", AAMAS 2013, section 4.1.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.chance import Disturbance, Sensing
from trueup.controllers.controller import Controller, ControllerFactory
from trueup.controllers.walk_engine.requests import TARGETS, targets
from trueup.ends import LOW, TILT, End, Fallen, Left
from trueup.engines.simulator import Rollout
from trueup.parameters import ParameterSpace
from trueup.tasks.paces import SLOWEST, Paces, lap_speeds, tallied, told_speeds
from trueup.tasks.sway import passing, sway
from trueup.tasks.task import Grades
from trueup.trial import Observed, Trial, Watched
from trueup.units import AS_FAR, GRAVITY

PLACE, ANGLES = "base_position", "base_orientation"


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
            sensing=self.sensing, watched=self.watched,
        )  # fmt: skip
        seeds = (np.random.default_rng([self.seed, k]) for k in range(self.runs))
        runs = tuple(
            replace(plain, name=f"{self.name} {k + 1}").seeded(s, alike=self.alike) for k, s in enumerate(seeds)
        )
        object.__setattr__(self, "trials", runs)

    name: str = field(init=False)
    """See Task."""
    unit: str = field(init=False, default="m/s")
    counts: str = field(init=False, default="speed")
    """See ScoredIn and Counts; falls are taken off."""

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
    def watched(self) -> Watched | None:
        """What eyes and a stop watch are to look at, where they will do."""
        return None

    @property
    def ends(self) -> tuple[End, ...]:
        """What ends a run before its time."""
        return (Fallen(height=LOW * self.height, tilt=TILT),)

    def controllers(self, values: Array) -> Controller:
        """See Task."""
        return self.make(values)

    def worth(self, rollout: Rollout) -> Array:
        """(b,) what one run makes good, `fall` taken off if it fell."""
        return self.made_good(rollout) - self.fall * self.risk(rollout)

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
        made = np.stack([self.worth(r) for r in rollouts])
        failed = np.stack([np.isin(np.arange(made.shape[1]), list(r.failures)) for r in rollouts])
        return -np.where(failed.any(axis=0), np.nan, made.mean(axis=0))


@dataclass(frozen=True, kw_only=True, eq=False)
class AheadWalk(Walk):
    """A walk ahead, which gets faster by pace and lean: its settings are `Graded`."""

    fall: float = 0.7
    """m/s: one fall in a hundred costs as much as 0.7 cm/s."""
    paces: Paces = field(default_factory=Paces)
    steps: Callable[[Array], Array] | None = None
    """m/s that the engine's steps would make without slipping, with full ones, of values (b, m); None: nobody says."""
    laps: int = field(init=False, default=1)

    @abstractmethod
    def speeds(self, rollout: Rollout) -> list[list[float]]:
        """m/s of what each run came through, lap by lap: fewer than `laps` where it fell, veered or was too slow."""

    def fastest(self, values: Array) -> float:
        """m/s that no robot walks with settings (m,): beyond them a time is a slip of the pen. Single laps of bipeds in
        benchmarks/walk_plan.py reach 1.5 times what their steps make.
        """
        return (
            AS_FAR * self.share * float(self.steps(values[None])[0])
            if self.steps
            else float(np.sqrt(GRAVITY * self.height))
        )

    def grades(self) -> Grades:
        """See Graded."""
        return self.paces.grades(self.parameters, self.fall)

    def tally(self, rollouts: Sequence[Rollout]) -> Array:
        """See Graded: falls forward and backward."""
        every = [tallied(r, self.speeds(r), self.laps, fell(r), r.channels[ANGLES][:, :, 1]) for r in rollouts]
        return np.asarray(np.sum(every, axis=0), dtype=np.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class WalkFront(AheadWalk):
    """Straight ahead for `seconds`: metres per second toward a far target. A fall ends what is made good."""

    seconds: float = 15.0

    name: str = field(init=False, default="walk front")

    @property
    def duration(self) -> float:
        """See Walk."""
        return self.seconds

    @property
    def course(self) -> Array:
        """See Walk."""
        return np.array([[0.0, 100.0, 0.0, self.share, 0.0]])

    @property
    def watched(self) -> Watched:
        """See Walk."""
        return Watched(fastest=self.fastest)

    def made_good(self, rollout: Rollout) -> Array:
        """(b,) m/s."""
        return gone(rollout) / self.seconds

    def speeds(self, rollout: Rollout) -> list[list[float]]:
        """See AheadWalk."""
        stood = ~fell(rollout) & (self.made_good(rollout) > SLOWEST)
        return [[float(v)] if up else [] for v, up in zip(self.made_good(rollout), stood, strict=True)]


@dataclass(frozen=True, kw_only=True, eq=False)
class LineWalk(AheadWalk):
    """To a line `line` m ahead, steering to a ball beyond it: the distance over the time it takes, as on the robot.

    A run that does not arrive counts as far as it came, over the whole time; one that leaves the lane of `lane` m to each
    side is over ('veered').
    """

    line: float = 2.38
    laps: int = 1
    """How many lines lie behind one another: a trial that goes on tells as much as several."""
    lane: float = 0.75
    ball: float = 1.0
    """m that it lies beyond the last line, so that steering never becomes abrupt."""
    slowest: float = SLOWEST
    """m/s: who is slower does not arrive."""

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
        return np.array([[0.0, self.far + self.ball, 0.0, self.share, 0.0]])

    @property
    def watched(self) -> Watched:
        """See Walk."""
        lines = tuple(self.line * k for k in range(1, self.laps + 1))
        return Watched(lines, self.fastest, ARRIVED, VEERED)

    @property
    def ends(self) -> tuple[End, ...]:
        """See Walk."""
        far = (-np.inf, np.inf)
        return (
            Left(PLACE, {"x": (-np.inf, self.far)}, name=ARRIVED),
            Left(PLACE, {"x": far, "y": (-self.lane, self.lane)}, name=VEERED), *super().ends,
        )  # fmt: skip

    def made_good(self, rollout: Rollout) -> Array:
        """(b,) m/s, the mean of all laps that were begun."""
        every = self.speeds(rollout)
        done = np.array([len(laps) for laps in every])
        begun_last = (
            np.clip(np.clip(gone(rollout), 0.0, self.far) - done * self.line, 0.0, None) * self.laps / self.duration
        )
        made = np.array([sum(laps) for laps in every])
        return np.where(done < self.laps, made + begun_last, made) / self._begun(done)

    def worth(self, rollout: Rollout) -> Array:
        """(b,) m/s, the mean of all laps that were begun, of which the last one may have ended in a fall."""
        done = np.array([len(laps) for laps in self.speeds(rollout)])
        return self.made_good(rollout) - self.fall * self.risk(rollout) / self._begun(done)

    def _begun(self, done: Integers) -> Integers:
        return np.minimum(done + 1, self.laps)

    def speeds(self, rollout: Rollout) -> list[list[float]]:
        """See AheadWalk."""
        time, start = rollout.trial.observed[PLACE].time, rollout.trial.start
        arrived = {row: end.at for row, end in rollout.ends.items() if end.name == ARRIVED}
        places, seen = rollout.channels[PLACE][:, :, 0], rollout.watched
        return [
            told_speeds(seen[k].seconds, self.line) if k in seen
            else lap_speeds(time, x, self.line, self.laps, start, arrived.get(k))
            for k, x in enumerate(places)
        ]  # fmt: skip


ARRIVED, VEERED = "at the line", "veered"
"""Names of ends of a walk to the line."""


def gone(rollout: Rollout) -> Array:
    """(b,) m ahead at the end of each run."""
    x = rollout.held().channels[PLACE][:, :, 0]
    far = x[:, -1] - x[:, 0]
    far[list(rollout.watched)] = [seen.metres for seen in rollout.watched.values()]
    return far


def fell(rollout: Rollout) -> Mask:
    """(b,) which runs ended by a fall."""
    rows = len(next(iter(rollout.channels.values())))
    return np.array([row in rollout.ends and rollout.ends[row].name == "fallen" for row in range(rows)])
