# SPDX-License-Identifier: Apache-2.0
"""A method on many robots, each with several searches: what its walks are worth in fresh runs, beside the start walk."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any, Protocol

import numpy as np

from trueup.arrays import Array
from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.evaluation.evaluator import Evaluator
from trueup.studies.walk import scenes
from trueup.studies.walk.evaluation import at_once
from trueup.studies.walk.guidance import Guidance, Unguided
from trueup.studies.walk.robot import StandInNao, Truth
from trueup.studies.walk.search import Effort
from trueup.studies.walk.study import Budget, Method, Story, Tried, best_share, improved
from trueup.tasks.walking import LineWalk

Kept = Callable[[str, Callable[[], object]], Any]
"""Names a part of the study and computes it if it is not there."""

_DRAWN = 2012  # from which stand-ins are drawn; fixed before any was looked at


def _not_kept(name: str, compute: Callable[[], object]) -> Any:
    return compute()


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
"""Four to eight minutes of a core for each search."""
PAPER = Scale()
"""150 candidates a generation."""
QUICK = Scale(
    budget=Budget(effort=Effort(population=12, generations=5, shown=5, fresh=6), rounds=2), shares=(0.8, 1.0), fresh=40,
)  # fmt: skip


class Way(Protocol):
    """How a walk is made faster within a robot's trials."""

    @property
    def name(self) -> str:
        """For tables."""
        ...

    def improved(
        self, robot: StandInNao, scale: Scale, seed: int, line: LineWalk, told: Callable[[str], None],
        evaluator: Evaluator | None = None,
    ) -> Story:  # fmt: skip
        """The story of one robot."""
        ...


@dataclass(frozen=True)
class Searching:
    """Walks are searched in a method's simulator, what it promises is tried on the robot: the paper's loop."""

    method: Method
    guidance: Guidance = field(default_factory=Unguided)
    fall: float | None = None
    """m/s that a fall costs where walks are picked; None: as the budget says."""

    @property
    def name(self) -> str:
        """See Way."""
        guided = "" if isinstance(self.guidance, Unguided) else f", guided: {self.guidance.name}"
        return self.method.name + guided + ("" if self.fall is None else f", a fall costs {self.fall:g} m/s")

    def improved(
        self, robot: StandInNao, scale: Scale, seed: int, line: LineWalk, told: Callable[[str], None],
        evaluator: Evaluator | None = None,
    ) -> Story:  # fmt: skip
        """See Way."""
        return improved(
            robot,
            self.method,
            _budget(scale, self.fall),
            seed,
            line=line,
            guidance=self.guidance,
            evaluator=evaluator,
            told=told,
        )


@dataclass(frozen=True)
class OnTheRobot:
    """No simulator: CMA-ES over all parameters on the robot itself, or its pace and lean alone (`paces`)."""

    loop: Callable[..., Story]
    """As `study.alone` and `paces.paced`."""
    name: str
    fall: float | None = None
    """m/s that a fall costs on the robot; None: as the budget says."""

    def improved(
        self, robot: StandInNao, scale: Scale, seed: int, line: LineWalk, told: Callable[[str], None],
        evaluator: Evaluator | None = None,
    ) -> Story:  # fmt: skip
        """See Way."""
        return self.loop(robot, _budget(scale, self.fall), seed, line=line, told=told)


def _budget(scale: Scale, fall: float | None) -> Budget:
    return scale.budget if fall is None else replace(scale.budget, fall=fall)


@dataclass(frozen=True)
class Step:
    """A walk that was tried on the way."""

    round: int
    promised: float
    """m/s, falls taken off; NaN for the start walk."""
    speed: float
    """m/s of arrivals; NaN where none arrived."""
    falls: int
    runs: int


@dataclass(frozen=True)
class Result:
    """One search on one robot, judged by fresh runs that nothing was chosen by."""

    way: str
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
    steps: tuple[Step, ...] = ()
    words: tuple[tuple[str, ...], ...] = ()
    """What guidance said, by round."""
    cpu: float = 0.0
    """s of processor until then."""

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

    @classmethod
    def read(cls, kept: dict[str, Any]) -> Result:
        """From what JSON keeps of it."""
        steps = tuple(Step(**s) for s in kept.pop("steps"))
        words = tuple(tuple(w) for w in kept.pop("words"))
        return cls(**{**kept, "values": tuple(kept["values"])}, steps=steps, words=words)


def truth_of(robot: int) -> Truth:
    """What a stand-in hides, by its number."""
    return Truth.random(np.random.default_rng([robot, _DRAWN]))


def performed(
    ways: Mapping[str, Way], scale: Scale, robots: Iterable[int], seeds: Sequence[int], told: Callable[[str], None],
    kept: Kept = _not_kept, evaluator: Evaluator | None = None,
) -> Iterator[Result]:  # fmt: skip
    """One result for each robot, seed and way. `told` hears what happens; `kept` names parts that may be there already;
    `evaluator` says where generations are simulated (None: here).
    """
    for number in robots:
        judge = StandInNao(truth_of(number), seed=number, log=0.0)
        start = tuple(kept(f"start {number}", partial(_started, judge, scale)))
        told(f"robot {number}: the start walk does {100 * start[1]:.1f} cm/s with steps of {100 * start[0]:.0f} %")
        for seed, (key, way) in product(seeds, ways.items()):
            compute = partial(_result, number, judge, seed, key, way, scale, start, told, evaluator)
            yield Result.read(kept(f"robot {number} seed {seed} {key}", compute))


def _started(judge: StandInNao, scale: Scale) -> list[float]:
    """The start walk's best step size, and speed and share of falls with it."""
    share, runs = best_share(judge, PARAMETERS.nominal, scale.shares, scale.fresh, scale.allowed)
    return [share, runs.speed, runs.failed / runs.number]


def _result(
    number: int, judge: StandInNao, seed: int, key: str, way: Way, scale: Scale, start: tuple[float, float, float],
    told: Callable[[str], None], evaluator: Evaluator | None,
) -> dict[str, Any]:  # fmt: skip
    """A `Result`, as JSON keeps it."""
    begun, line = time.process_time(), scenes.task(LineWalk, runs=1, share=scale.share)
    told(f"robot {number}, seed {seed}: {way.name}")
    story = way.improved(StandInNao(truth_of(number), seed=number), scale, seed, line, told, evaluator)
    spent, best = time.process_time() - begun, story.best
    judged = at_once(judge, line, best.values, scale.fresh, f" fresh {key} {seed}")
    return asdict(Result(
        key, number, seed, tuple(best.values.tolist()), judged.speed, judged.failed / judged.number,
        *start, story.trials, story.seconds, tuple(_step(t) for t in story.tried),
        tuple(r.words for r in story.rounds), spent,
    ))  # fmt: skip


def _step(tried: Tried) -> Step:
    promised = tried.promise.score if tried.promise else float("nan")
    return Step(tried.round, promised, tried.runs.speed, tried.runs.failed, tried.runs.number)


@dataclass(frozen=True)
class Interval:
    """A mean with its 95 % bootstrap interval over robots, whose searches stay together."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        known = np.isfinite([self.low, self.high]).all()
        return f"{self.mean:.1f} ({f'{self.low:.1f} ... {self.high:.1f}' if known else 'one robot: no interval'})"


def over(
    results: Sequence[Result], way: str, other: str, what: Callable[[Result], float], draws: int = 4000
) -> Interval:
    """The mean difference of `what` between two ways over the same robots and seeds."""
    rows = {(r.way, r.robot, r.seed): what(r) for r in results}
    pairs = [(n, s) for w, n, s in rows if w == way and (other, n, s) in rows]
    robots = sorted({n for n, _ in pairs})
    each = [np.array([rows[way, n, s] - rows[other, n, s] for m, s in pairs if m == n]) for n in robots]
    if not each:
        return Interval(float("nan"), float("nan"), float("nan"))
    rng = np.random.default_rng(0)
    picks = rng.integers(len(each), size=(draws, len(each)))
    sums, counts = np.array([e.sum() for e in each]), np.array([len(e) for e in each])
    means = sums[picks].sum(axis=1) / counts[picks].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975]) if len(each) > 1 else (-np.inf, np.inf)
    return Interval(float(sums.sum() / counts.sum()), float(low), float(high))


def summary(results: Sequence[Result]) -> list[str]:
    """In words: medians of each way, and what is worst."""
    lines = []
    for way in dict.fromkeys(r.way for r in results):
        gains, falls = np.array([(r.gain, r.falls) for r in results if r.way == way]).T
        lines.append(
            f"{way}: gain over the start walk at its own best step size: median {100 * np.median(gains):.0f} % "
            f"({100 * gains.min():.0f} to {100 * gains.max():.0f}); falls in 100: median {100 * np.median(falls):.3g}, "
            f"mean {100 * falls.mean():.1f} ({100 * falls.min():.0f} to {100 * falls.max():.0f})"
        )
    return lines
