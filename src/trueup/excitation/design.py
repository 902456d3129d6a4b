# SPDX-License-Identifier: Apache-2.0
"""Designs excitations: a class of motion, a criterion, a search."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from trueup.arrays import Array
from trueup.compiled import clock
from trueup.errors import IdentificationError
from trueup.excitation.criteria import Criterion
from trueup.excitation.periodic import MotionClass
from trueup.excitation.trajectories import RATE, Motions, Trajectory
from trueup.search.evolution import Evolution
from trueup.search.genetic import Genetic
from trueup.search.quasi_newton import QuasiNewton
from trueup.search.search import Search

Method = Literal["genetic", "quick"]
Penalty = Callable[[Motions, int], Array]
"""(B,) what is added to the losses of motions, 0 where they do nothing forbidden; the number is of threads."""
Told = Callable[["Step"], None]


@dataclass(frozen=True)
class Step:
    """How far a search is."""

    loss: float
    evaluations: int
    seconds: float
    share: float
    """Of the whole, about."""


@dataclass(frozen=True)
class Options:
    """How an excitation is looked for."""

    method: Method = "quick"
    """'genetic' as in the papers, or 'quick': CMA-ES on coarse samples, with slopes for the last steps."""
    samples: int = 2000
    """Samples at which the result is judged; the genetic search judges each candidate so."""
    population: int = 150
    generations: int = 150
    coarse: int = 0
    """Samples at which 'quick' judges; 0: enough for the model, four rows a column."""
    starts: int = 300
    """Random motions among which 'quick' chooses where to begin."""
    candidates: int = 20000
    """Motions that 'quick' judges at most."""
    budget: float = np.inf
    """s after which 'quick' ends with what it has; those in which loops were compiled do not count."""
    target: float = -np.inf
    """A loss that is good enough to stop at."""
    seed: int = 0
    threads: int = 1


@dataclass(frozen=True, eq=False)
class Excitation:
    """A designed motion, how good it is, and how it was found."""

    trajectory: Trajectory
    genes: Array
    loss: float
    """By the criterion, at `Options.samples` samples."""
    printed: float
    """log10 det [H^t H] as the papers print it, summed over that many samples."""
    trace: tuple[Step, ...]
    evaluations: int
    seconds: float
    cpu_seconds: float


@dataclass
class _Run:
    """What a search has found so far: the best genes that are allowed, and the trace."""

    kind: MotionClass
    criterion: Criterion
    options: Options
    report: Told | None
    penalty: Penalty | None
    began: float = field(default_factory=clock)
    trace: list[Step] = field(default_factory=list)
    evaluations: int = 0
    leading: list[tuple[float, Array]] = field(default_factory=list)
    """All that were the best when they were judged, the best last."""

    @property
    def seconds(self) -> float:
        return clock() - self.began

    def losses(self, genes: Array, samples: int) -> Array:
        """(B,) of genes (B, size); NaN for impossible motions."""
        self.evaluations += len(genes)
        threads = self.options.threads
        motions = self.kind.motions(genes, samples, threads=threads)
        losses = self.criterion.losses(motions, threads, as_of=self.options.samples)
        if self.penalty is not None:
            losses = losses + self.penalty(motions, threads)
        if np.isfinite(losses).any():
            k = int(np.nanargmin(losses))
            if not self.leading or losses[k] < self.leading[-1][0]:
                self.leading.append((float(losses[k]), genes[k].copy()))
        return losses

    def note(self, loss: float, share: float) -> None:
        step = Step(loss, self.evaluations, self.seconds, min(1.0, share))
        self.trace.append(step)
        if self.report is not None:
            self.report(step)

    @property
    def over(self) -> bool:
        return self.seconds > self.options.budget


def design(
    kind: MotionClass, criterion: Criterion, options: Options | None = None, *, penalty: Penalty | None = None,
    starts: Array | None = None, told: Told | None = None, name: str = "excitation", rate: float = RATE,
) -> Excitation:  # fmt: skip
    """The motion of a class that is best by a criterion, sampled at `rate` Hz.

    `penalty` is added to the criterion; `starts` (m, size) are genes among which 'quick' begins, instead of random ones.
    Raises IdentificationError where no motion of the class is possible.
    """
    chosen = options or Options()
    judge = criterion.smooth() if chosen.method == "quick" else criterion
    run, cpu = _Run(kind, judge, chosen, told, penalty), time.process_time()
    best = _quick(run, starts) if chosen.method == "quick" else _generations(run)
    genes, final, fine = _first_possible(kind, [best, *(g for _, g in reversed(run.leading))], chosen.samples, rate)
    loss, printed = float(criterion.losses(final)[0]), float(criterion.printed(final)[0])
    if not np.isfinite(loss) or not fine.possible[0]:
        raise IdentificationError(_nothing(kind, final))
    trajectory = fine.single(0, criterion.model.tree.joints, name)
    return Excitation(
        trajectory, genes, loss, printed, tuple(run.trace), run.evaluations, run.seconds, time.process_time() - cpu
    )


def _first_possible(
    kind: MotionClass, ranked: list[Array], samples: int, rate: float
) -> tuple[Array, Motions, Motions]:
    """The first genes whose motion is possible at all samples too (or the first of all), with it at both rates.

    Between the coarse samples of a search a motion may leave what is possible; then the best before it counts.
    """
    tried: tuple[Array, Motions, Motions] | None = None
    for genes in ranked:
        final = kind.motions(genes[None], samples)
        fine = kind.motions(genes[None], max(2, int(np.ceil(float(final.duration[0]) * rate)) + 1))
        if final.possible[0] and fine.possible[0]:
            return genes, final, fine
        tried = tried or (genes, final, fine)
    if tried is None:
        raise IdentificationError("no motion was tried")
    return tried


def _generations(run: _Run) -> Array:
    """A genetic search, each candidate judged at all samples."""
    options = run.options
    start = np.random.default_rng(options.seed).uniform(size=run.kind.size)
    search = Genetic(start, seed=options.seed, population=options.population, generations=options.generations)
    return _searched(run, search, options.samples, lambda done: done / (options.population * options.generations))


def _quick(run: _Run, given: Array | None) -> Array:
    """CMA-ES on coarse samples from the best of many starts, then quasi-Newton on finer ones.

    The determinant of a smooth motion needs far fewer samples than its torque does: with a few rows a column it is known
    to a few tenths, and a candidate costs a twentieth.
    """
    options = run.options
    columns, n = len(run.criterion.independent), run.criterion.model.tree.n
    coarse = options.coarse or max(60, 4 * columns // n + 20)
    starts = given
    if starts is None:
        starts = np.random.default_rng(options.seed).uniform(size=(options.starts, run.kind.size))
    losses = run.losses(starts, coarse)
    if not np.isfinite(losses).any():
        raise IdentificationError(_nothing(run.kind, run.kind.motions(starts[:20], coarse)))
    begin = starts[int(np.nanargmin(losses))]
    run.note(float(np.nanmin(losses)), 0.02)
    sigma, most = (0.3, options.candidates) if given is None else (0.05, options.candidates // 4)
    search = Evolution(begin, seed=options.seed, sigma=sigma, population=40, most=most)
    best = _searched(run, search, coarse, lambda done: 0.9 * done / options.candidates)
    climb = QuasiNewton(best, most=40, tolerance=1e-5)
    return _searched(run, climb, min(2 * coarse, options.samples), lambda _: 0.95)


def _searched(run: _Run, search: Search, samples: int, share: Callable[[int], float]) -> Array:
    """The best that a search comes to before it is done or the budget is spent; `share` of the whole by evaluations."""
    while not search.done and not run.over and search.best[1] > run.options.target:
        candidates = search.ask()
        search.tell(candidates, run.losses(candidates, samples))
        run.note(search.best[1], share(run.evaluations))
    return search.best[0]


def _nothing(kind: MotionClass, motions: Motions) -> str:
    reasons = sorted({reason for reason in motions.failure if reason})
    why = f" ({'; '.join(reasons)})" if reasons else ""
    return (
        f"no motion of the class {type(kind).__name__} can be performed and excites all columns{why}; "
        "make the region smaller or move it, keep away from singular postures, or lower the margin to obstacles"
    )
