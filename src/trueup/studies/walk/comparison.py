# SPDX-License-Identifier: Apache-2.0
"""A method on many robots, each with several searches: what its walks are worth in fresh runs, beside the start walk."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.studies.walk import scenes
from trueup.studies.walk.evaluation import at_once
from trueup.studies.walk.robot import StandInNao, Truth
from trueup.studies.walk.search import Effort
from trueup.studies.walk.study import Budget, Method, best_share, improved
from trueup.tasks.walking import LineWalk

Array = NDArray[np.float64]

_DRAWN = 2012  # from which stand-ins are drawn; fixed before any was looked at


@dataclass(frozen=True)
class Scale:
    """How thorough a comparison is."""

    budget: Budget = field(default_factory=Budget)
    share: float = 0.67
    """Of the largest step, at which walks are searched and judged; the paper's cap."""
    shares: tuple[float, ...] = (0.67, 0.8, 0.9, 1.0)
    """At which the start walk may be at its best."""
    fresh: int = 100
    """Runs of each walk that is judged."""
    allowed: float = 0.03
    """Share of falls that the start walk may have at its best step size."""


FULL = Scale(budget=Budget(effort=Effort(population=32)))
"""About two minutes of a core for each search."""
PAPER = Scale()
"""150 candidates a generation."""
QUICK = Scale(
    budget=Budget(effort=Effort(population=16, generations=5, shown=5, fresh=6)), shares=(0.8, 1.0), fresh=40,
)  # fmt: skip


@dataclass(frozen=True)
class Result:
    """One search on one robot, judged by fresh runs that nothing was chosen by."""

    robot: int
    seed: int
    values: tuple[float, ...]
    """(17,) of the walk that was found."""
    speed: float
    """m/s of arrivals."""
    falls: float
    """Share of runs that fell or veered."""
    start_share: float
    """At which the start walk is at its best on this robot."""
    start_speed: float
    start_falls: float
    trials: int
    """On the robot, until the walk was found."""
    seconds: float
    """Robot time until then."""

    @property
    def gain(self) -> float:
        """By which share it is faster than the start walk at its own best step size."""
        return self.speed / self.start_speed - 1.0

    def truth(self) -> Truth:
        """What the robot hides."""
        return truth_of(self.robot)

    def start(self) -> Array:
        """(17,) of the start walk."""
        return PARAMETERS.nominal

    def final(self) -> Array:
        """(17,) of what was found."""
        return np.array(self.values)


def truth_of(robot: int) -> Truth:
    """What a stand-in hides, by its number."""
    return Truth.drawn(np.random.default_rng([robot, _DRAWN]))


def performed(
    method: Method, scale: Scale, robots: Iterable[int], seeds: Sequence[int], told: Callable[[str], None]
) -> Iterator[Result]:
    """One result for each robot and seed. `told` hears what happens."""
    line = scenes.task(LineWalk, runs=1, share=scale.share)
    for number in robots:
        robot = StandInNao(truth_of(number), seed=number, log=0.0)
        share, start = best_share(robot, PARAMETERS.nominal, scale.shares, scale.fresh, scale.allowed)
        fell = (start.falls + start.veers) / start.number
        told(f"robot {number}: the start walk does {100 * start.speed:.1f} cm/s with steps of {100 * share:.0f} %")
        for seed in seeds:
            story = improved(robot, method, scale.budget, seed, line=line, told=told)
            judged = at_once(robot, line, story.best.values, scale.fresh, f" fresh {method.name} {seed}")
            falls = (judged.falls + judged.veers) / judged.number
            yield Result(
                number, seed, tuple(story.best.values.tolist()), judged.speed, falls, share, start.speed, fell,
                story.trials, story.seconds,
            )  # fmt: skip


def summary(results: Sequence[Result]) -> list[str]:
    """In words: medians, and what is worst."""
    gains, falls = np.array([r.gain for r in results]), np.array([r.falls for r in results])
    return [
        f"gain over the start walk at its own best step size: median {100 * np.median(gains):.0f} % "
        f"({100 * gains.min():.0f} to {100 * gains.max():.0f})",
        f"falls in 100: median {100 * np.median(falls):.0f} ({100 * falls.min():.0f} to {100 * falls.max():.0f})",
    ]
