# SPDX-License-Identifier: Apache-2.0
"""The paper's loop on one robot: search in a simulator, try what it promises on the robot, go on from what held there.

Without grounding this is the control that any grounding must beat: a simulator that is only made noisy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from trueup.arrays import Array
from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.evaluation.evaluator import Evaluator, Here
from trueup.robots.robot import Robot
from trueup.search.cma_es import CmaEs
from trueup.studies.walk import scenes
from trueup.studies.walk.evaluation import Runs, at_once, expected_falls
from trueup.studies.walk.guidance import Guidance, Unguided
from trueup.studies.walk.search import Effort, Promise, Scene, searched
from trueup.tasks.walking import LineWalk

_STEP = PARAMETERS.index("amp_swing")
FALL = 1.0
"""m/s that a fall costs in searches: one in a hundred costs a cm/s."""


@dataclass(frozen=True)
class Tried:
    """A walk, what the simulator promised, and what the robot did."""

    round: int
    """0 for the start walk."""
    values: Array
    promise: Promise | None
    runs: Runs
    worth: float = -FALL
    """m/s, the falls counted that are expected."""


@dataclass(frozen=True)
class Round:
    """Where a round began, and what it was told to change."""

    begun: int
    """Which of the walks tried."""
    words: tuple[str, ...] = ()
    """Of the guidance."""


@dataclass(frozen=True, eq=False)
class Story:
    """All that was tried on a robot, in order, judged by all of its runs."""

    tried: tuple[Tried, ...] = ()
    rounds: tuple[Round, ...] = ()

    @property
    def best(self) -> Tried:
        """What is worth the most by all that the robot showed."""
        return max(self.tried, key=lambda t: t.worth)

    @property
    def trials(self) -> int:
        """On the robot."""
        return sum(t.runs.trials for t in self.tried)

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

    def prepared(self, story: Story, seed: int) -> Scene:
        """The simulator of a round, and the task in it."""
        ...


@dataclass(frozen=True)
class Budget:
    """How robot trials are spent: some in rounds, the others on what is worth the most in the end."""

    effort: Effort = field(default_factory=Effort)
    trials: int = 60
    """On the robot, at most."""
    seconds: float = 1800.0
    """Of robot time, after which nothing more is tried."""
    laps: int = 2
    """Lines behind one another of a trial: each tells as much as a run to one, and there is time for two."""
    rounds: int = 3
    start: int = 2
    """Trials of the start walk."""
    longer: tuple[float, ...] = (1.2, 1.35, 1.5)
    """Factors on its steps with which it is tried before any search."""
    round: int = 10
    """Trials of a round: a look at each of its walks, and what is left for those of all rounds that are worth the most.

    What start and rounds leave goes to these, too. These shares were chosen on stand-ins 100 to 107, which the study does not
    have.
    """
    rivals: int = 4
    """Walks between which the first of such trials are shared; the last are all of one."""
    fall: float = 0.7
    """m/s that an expected fall costs where walks are picked; chosen, as `rivals`, on stand-ins 100 and 101."""


def improved(
    robot: Robot, method: Method, budget: Budget, seed: int, *, line: LineWalk | None = None,
    start: Array | None = None, guidance: Guidance | None = None, evaluator: Evaluator | None = None,
    told: Callable[[str], None] | None = None,
) -> Story:  # fmt: skip
    """The story of a robot whose walk is made faster. `told` hears what happens, one sentence each; `evaluator`
    says where generations are simulated (None: here).

    The paper's algorithm 1: a stack of open walks, at first the start walk. Each round takes the topmost, searches from it,
    and puts on the stack what the robot shows to be worth more, the best on top. Where none is open, the best is searched
    from again.
    """
    track = lap_track(line, budget)
    begin = PARAMETERS.nominal if start is None else start
    say = told or (lambda _: None)
    story = Story(tuple(_started(robot, track, begin, budget)))
    for t in story.tried:
        say(f"start walk, {t.values[_STEP]:.3g} rad of swing: {_words(t.runs)}")
    guide, stack = guidance or Unguided(), list[int]()
    for number in range(1, budget.rounds + 1):
        scene = replace(method.prepared(story, seed + number), evaluator=evaluator or Here())
        begun = stack.pop() if stack else int(np.argmax([t.worth for t in story.tried]))
        parent = story.tried[begun]
        advice = guide.advice(number, scene, parent.values, budget.effort.sigma)
        for word in advice.words:
            say(f"round {number}: {word}")

        def hears(generation: int, middle: float, number: int = number) -> None:
            say(f"round {number}, generation {generation}: {100 * middle:.1f} cm/s in the middle, falls taken off")

        found = searched(
            scene, parent.values, budget.effort, seed * 10 + number, space=advice.space, wide=advice.wide, told=hears
        )
        before = len(story.tried)
        tried = _looked_at(robot, track, found.path, number, budget, f" seed {seed}", story.tried)
        story = Story(tuple(tried), (*story.rounds, Round(begun, advice.words)))
        better = [k for k in range(before, len(tried)) if tried[k].worth > tried[begun].worth]
        stack += sorted(better, key=lambda k: story.tried[k].worth)
        for t in tried[before:]:
            say(f"round {number}: promised {100 * (t.promise.score if t.promise else 0):.1f} cm/s; {_words(t.runs)}")
    left = budget.trials - story.trials
    return replace(story, tried=tuple(_again(robot, track, story.tried, left, budget, f" seed {seed} last")))


def lap_track(line: LineWalk | None, budget: Budget) -> LineWalk:
    """What a trial is: so many lines behind one another."""
    return replace(line or scenes.task(LineWalk, runs=1), laps=budget.laps)


def _started(robot: Robot, track: LineWalk, begin: Array, budget: Budget) -> list[Tried]:
    """The start walk, and with longer steps until one falls twice."""
    tried = [Tried(0, begin, None, at_once(robot, track, begin, budget.start, " start"))]
    for factor in budget.longer:
        longer = begin.copy()
        longer[_STEP] = min(factor * begin[_STEP], PARAMETERS.parameters[_STEP].upper)
        tried.append(Tried(0, longer, None, _look(robot, track, longer, f" start {factor:g}")))
        if tried[-1].runs.failed > 1:
            break
    return _judged(tried, budget)


def _look(robot: Robot, track: LineWalk, values: Array, label: str) -> Runs:
    """A trial of a walk, and another one where that fell: a gentle walk, too, falls now and then."""
    runs = at_once(robot, track, values, 1, label)
    return runs if not runs.failed else runs + at_once(robot, track, values, 1, f"{label} again")


def alone(
    robot: Robot, budget: Budget, seed: int, *, line: LineWalk | None = None, told: Callable[[str], None] | None = None,
) -> Story:  # fmt: skip
    """The story without a simulator: CMA-ES on the robot, a run a candidate; its last centres get the last round's runs."""
    track, say = lap_track(line, budget), told or (lambda _: None)
    tried = _started(robot, track, PARAMETERS.nominal, budget)
    search = CmaEs(PARAMETERS.to_unit(PARAMETERS.nominal), seed=seed, sigma=0.6 * budget.effort.sigma, restarts=0)
    left, number, centres = (budget.rounds - 1) * budget.round, 0, list[Array]()
    while left > 0:
        number, asked = number + 1, search.ask()[:left]
        runs = [
            at_once(robot, track, PARAMETERS.from_unit(u), 1, f" alone {seed} {number} {k}")
            for k, u in enumerate(asked)
        ]
        if left > len(asked):
            search.tell(asked, np.array([-r.score(FALL) for r in runs]))
            centres.append(PARAMETERS.from_unit(search.centre))
        tried += [Tried(number, PARAMETERS.from_unit(u), None, r) for u, r in zip(asked, runs, strict=True)]
        left -= len(asked)
        say(f"generation {number} on the robot: {sum(r.falls for r in runs)} of {len(runs)} fell")
    path = [Promise(c, float("nan"), float("nan")) for c in centres[-3:] or [PARAMETERS.nominal]]
    tried = _looked_at(robot, track, path, number + 1, budget, f" alone {seed}", tried)
    left = budget.trials - sum(t.runs.trials for t in tried)
    return Story(tuple(_again(robot, track, tried, left, budget, f" alone {seed} last")))


def _looked_at(
    robot: Robot, track: LineWalk, path: Sequence[Promise], number: int, budget: Budget, label: str, before: Sequence[Tried],
) -> list[Tried]:  # fmt: skip
    """All that was tried, a round later: from the gentlest walk on until one falls twice, then what is worth the most."""
    tried = list(before)
    for k, promise in enumerate(path):
        if spent([t.runs for t in tried], budget):
            break
        runs = _look(robot, track, promise.values, f"{label} round {number} walk {k}")
        tried.append(Tried(number, promise.values, promise, runs))
        if runs.failed > 1:
            break
    left = budget.round - sum(t.runs.trials for t in tried[len(before) :])
    return _again(robot, track, tried, left, budget, f"{label} round {number} again")


def _again(
    robot: Robot, track: LineWalk, tried: Sequence[Tried], trials: int, budget: Budget, label: str
) -> list[Tried]:
    """So many more trials of the walks that are worth the most, fewer and fewer of them, each time of the one least known.

    Successive rejects (J.-Y. Audibert, S. Bubeck and R. Munos, COLT 2010), in which a walk that was rejected may come back.
    """
    judged = _judged(tried, budget)
    for count in range(trials):
        if spent([t.runs for t in judged], budget):
            break
        rivals = int(np.ceil(budget.rivals * (1.0 - count / trials)))
        best = sorted(range(len(judged)), key=lambda k: -judged[k].worth)[:rivals]
        k = min(best, key=lambda k: judged[k].runs.number)
        more = at_once(robot, track, judged[k].values, 1, f"{label} {count}")
        judged[k] = replace(judged[k], runs=judged[k].runs + more)
        judged = _judged(judged, budget)
    return judged


def spent(runs: Sequence[Runs], budget: Budget) -> bool:
    """Whether no trial is left, or no robot time for one as long as those of the slowest walk."""
    longest = max(r.seconds / r.trials for r in runs)
    return sum(r.trials for r in runs) >= budget.trials or sum(r.seconds for r in runs) + longest > budget.seconds


def _judged(tried: Sequence[Tried], budget: Budget) -> list[Tried]:
    """What walks are worth, with the falls that all runs of the robot lead to expect."""
    shares = expected_falls([t.runs for t in tried])
    return [replace(t, worth=t.runs.worth(budget.fall, float(s))) for t, s in zip(tried, shares, strict=True)]


def best_share(robot: Robot, values: Array, shares: Sequence[float], runs: int, allowed: float) -> tuple[float, Runs]:
    """The step size at which a walk is fastest on a robot with no larger share of falls than `allowed`, and its runs.

    The smallest step where all fall more often.
    """
    done = {
        s: at_once(robot, scenes.task(LineWalk, runs=1, share=s), values, runs, f" step {s:g}") for s in sorted(shares)
    }
    upright = [s for s, r in done.items() if r.failed <= allowed * r.number] or [min(shares)]
    best = max(upright, key=lambda s: done[s].speed)
    return best, done[best]


def _words(runs: Runs) -> str:
    return f"{100 * runs.speed:.1f} cm/s, {runs.falls} of {runs.number} fell" + (
        f", {runs.veers} veered" * bool(runs.veers)
    )
