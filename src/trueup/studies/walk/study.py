# SPDX-License-Identifier: Apache-2.0
"""The paper's loop on one robot: search in a simulator, try what it promises on the robot, go on from what held there.

Without grounding this is the control that any grounding must beat: a simulator that is only made noisy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.engines.simulator import Simulator
from trueup.parameters import ParameterSpace
from trueup.robots.robot import Robot
from trueup.studies.walk import scenes
from trueup.studies.walk.evaluation import Runs, at_once, most_falls
from trueup.studies.walk.search import Effort, Promise, searched
from trueup.tasks.walking import LineWalk, Walk, WalkFront

Array = NDArray[np.float64]

BALANCE = (
    "gyro_hipPitch", "gyro_kneePitch", "gyro_hipRoll", "gyro_ankleRoll", "scale_roll", "offset_pitch", "scale_pitch",
)  # fmt: skip
"""What the paper's expert froze: what it feels in a simulator is not what a robot feels."""
FALL = 0.5
"""m/s that a fall costs where walks are picked, in the simulator as on the robot: one in a hundred costs half a cm/s."""


@dataclass(frozen=True)
class Tried:
    """A walk, what the simulator promised, and what the robot did."""

    round: int
    """0 for the start walk."""
    values: Array
    promise: Promise | None
    runs: Runs
    worth: float = -FALL
    """m/s that it is worth at least, falls counted: as its round was judged."""


@dataclass(frozen=True, eq=False)
class Story:
    """All that was tried on a robot, in order."""

    tried: tuple[Tried, ...] = ()

    @property
    def best(self) -> Tried:
        """What the robot showed to be worth the most for sure."""
        return max(self.tried, key=lambda t: t.worth)

    @property
    def trials(self) -> int:
        """Runs on the robot."""
        return sum(t.runs.number for t in self.tried)

    @property
    def seconds(self) -> float:
        """Robot time."""
        return sum(t.runs.seconds for t in self.tried)


class Method(Protocol):
    """Where walks are searched, given all that the robot has shown so far."""

    @property
    def name(self) -> str:
        """For tables."""
        ...

    def prepared(self, story: Story, seed: int) -> tuple[Simulator, Walk]:
        """The simulator of a round, and the task in it."""
        ...


@dataclass(frozen=True)
class Ungrounded:
    """The simulator as it comes, quiet or noisy, whatever the robot shows."""

    noisy: bool = True
    seconds: float = 8.0
    runs: int = 4
    fall: float = FALL
    threads: int | None = None

    @property
    def name(self) -> str:
        """See Method."""
        return f"{'noisy' if self.noisy else 'quiet'} simulator, ungrounded"

    def prepared(self, story: Story, seed: int) -> tuple[Simulator, Walk]:
        """See Method."""
        walk = scenes.task(WalkFront, noisy=self.noisy, runs=self.runs, seconds=self.seconds, fall=self.fall, seed=seed)
        return scenes.simulator(threads=self.threads), walk


@dataclass(frozen=True)
class Budget:
    """How robot trials are spent: in rounds, at most 60 in all."""

    effort: Effort = field(default_factory=Effort)
    rounds: int = 3
    start: int = 4
    """Runs of the start walk."""
    looks: int = 2
    """Runs of each walk of a round."""
    round: int = 18
    """Runs of a round; what looks leave goes to the walks that are worth the most."""

    @property
    def trials(self) -> int:
        """Runs on the robot, at most."""
        return self.start + self.rounds * self.round


def improved(
    robot: Robot, method: Method, budget: Budget, seed: int, *, line: LineWalk | None = None,
    start: Array | None = None, space: ParameterSpace | None = None, told: Callable[[str], None] | None = None,
) -> Story:  # fmt: skip
    """The story of a robot whose walk is made faster. `told` hears what happens, one sentence each."""
    track = line or scenes.task(LineWalk, runs=1)
    begin = PARAMETERS.nominal if start is None else start
    say = told or (lambda _: None)
    story = Story(tuple(_judged([Tried(0, begin, None, at_once(robot, track, begin, budget.start, " start"))])))
    say(f"start walk: {_words(story.tried[0].runs)}")
    for number in range(1, budget.rounds + 1):
        simulator, walk = method.prepared(story, seed + number)

        def hears(generation: int, middle: float, number: int = number) -> None:
            say(f"round {number}, generation {generation}: {100 * middle:.1f} cm/s in the middle, falls taken off")

        best = story.best.values
        found = searched(simulator, walk, best, budget.effort, seed * 10 + number, space=space, told=hears)
        new = _looked_at(robot, track, found.path, number, budget, f" seed {seed}")
        story = Story((*story.tried, *new))
        for t in new:
            say(f"round {number}: promised {100 * (t.promise.score if t.promise else 0):.1f} cm/s; {_words(t.runs)}")
    return story


def _looked_at(
    robot: Robot, track: LineWalk, path: Sequence[Promise], number: int, budget: Budget, label: str
) -> list[Tried]:
    """A round on the robot: from the gentlest walk on until one falls in most of its looks, then the best ones again."""
    tried: list[Tried] = []

    def runs(k: int, count: int) -> Runs:
        done = tried[k].runs.number if k < len(tried) else 0
        return at_once(robot, track, path[k].values, count, f"{label} round {number} walk {k} from {done}")

    for k, promise in enumerate(path):
        tried.append(Tried(number, promise.values, promise, runs(k, budget.looks)))
        if len(tried[-1].runs.speeds) < budget.looks / 2:
            break
    while (left := budget.round - sum(t.runs.number for t in tried)) > 0:
        tried = _judged(tried)
        k = max(range(len(tried)), key=lambda i: tried[i].worth)
        tried[k] = replace(tried[k], runs=tried[k].runs + runs(k, min(left, budget.looks)))
    return _judged(tried)


def _judged(tried: Sequence[Tried]) -> list[Tried]:
    """What walks, the gentlest first, are worth for sure."""
    shares = most_falls([t.runs for t in tried])
    return [replace(t, worth=t.runs.worth(FALL, float(s))) for t, s in zip(tried, shares, strict=True)]


def best_share(robot: Robot, values: Array, shares: Sequence[float], runs: int, allowed: float) -> tuple[float, Runs]:
    """The step size at which a walk is fastest on a robot with no larger share of falls than `allowed`, and its runs.

    The smallest step where all fall more often.
    """
    done = {
        s: at_once(robot, scenes.task(LineWalk, runs=1, share=s), values, runs, f" step {s:g}") for s in sorted(shares)
    }
    upright = [s for s, r in done.items() if r.falls + r.veers <= allowed * r.number] or [min(shares)]
    best = max(upright, key=lambda s: done[s].speed)
    return best, done[best]


def _words(runs: Runs) -> str:
    return f"{100 * runs.speed:.1f} cm/s, {runs.falls} of {runs.number} fell" + (
        f", {runs.veers} veered" * bool(runs.veers)
    )
