# SPDX-License-Identifier: Apache-2.0
"""How well each learner predicts frames that it did not see: rows left out at random, as the paper did, or whole runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers
from trueup.evidence import evidence
from trueup.grounding.learners import Learner
from trueup.grounding.rows import Rows
from trueup.grounding.views import Model, fitted
from trueup.rounding import NEGLIGIBLE, TINY
from trueup.trial import SETTLE

FOLDS = 10
MOST = 12_000
"""Rows that are learned from: as many as the paper's; more are thinned evenly."""
Progress = Callable[[str, float], None]
"""Told of a learner's name, and the share of the whole that is done."""


@dataclass(frozen=True, eq=False)
class Score:
    """How one learner did in one cross-validation. Arrays are (k,), one for each output."""

    name: str
    rae: Array
    """Relative absolute error as Weka has it: sum |error| / sum |error of the training mean|; 1 is as bad as the mean. NaN of
    joints that stand still in all runs, of which the mean is right."""
    rrse: Array
    """Root relative squared error: the same of squares, and the root of it."""
    rmse: Array
    """In the outputs' unit."""
    by_fold: Array
    """(folds,) mean absolute error of what was left out together, in spreads of the outputs. Of squares a few frames after
    a jump of the command would be all."""
    ahead: Array
    """(folds,) the same where the model goes on from its own predictions for a second, as it does in a simulator."""
    seconds: float
    """CPU time of one fit."""

    @property
    def error(self) -> float:
        """Root mean square over all joints that move, in the outputs' unit."""
        return float(np.sqrt(np.mean(self.rmse[np.isfinite(self.rae)] ** 2)))

    @property
    def typical(self) -> float:
        """Geometric mean of `ahead`: what was left out together counts alike, however hard it is to predict."""
        return float(np.exp(np.mean(np.log(np.maximum(self.ahead, NEGLIGIBLE)))))


@dataclass(frozen=True, eq=False)
class Comparison:
    """All learners on the same rows, left out in both ways."""

    by_row: dict[str, Score]
    by_run: dict[str, Score]
    held: Score
    """Holding the last value."""
    chosen: str
    why: str
    skipped: tuple[str, ...] = ()
    """Learners for which the time was not enough."""


def folds_by_row(rows: Rows, rng: np.random.Generator) -> list[Integers]:
    """Ten parts of the rows, at random: neighbours in time are on both sides, so it flatters."""
    return [np.sort(part) for part in np.array_split(rng.permutation(len(rows.X)), FOLDS)]


def folds_by_run(rows: Rows) -> list[Integers]:
    """At most ten parts of whole runs, about equally long; stretches of a run where there is one run alone."""
    runs, counts = np.unique(rows.run, return_counts=True)
    if len(runs) == 1:
        return list(np.array_split(np.arange(len(rows.X)), FOLDS))
    bins: list[list[int]] = [[] for _ in range(min(FOLDS, len(runs)))]
    sizes = np.zeros(len(bins))
    for k in np.argsort(-counts, kind="stable"):
        least = int(np.argmin(sizes))
        bins[least].append(int(runs[k]))
        sizes[least] += counts[k]
    return [np.flatnonzero(np.isin(rows.run, each)) for each in bins]


def cross_validated(
    learner: Learner, rows: Rows, folds: Sequence[Integers], view: str = "plain", *, seed: int = 0,
    until: float = float("inf"), chained: bool = True, most: int = MOST, moves: bool = True,
) -> Score | None:  # fmt: skip
    """How a learner predicts each part from the others; None where it would not be done by `until` (process time, s)."""
    predicted, before, ahead = np.empty_like(rows.Y), np.empty_like(rows.Y), np.full(len(folds), np.nan)
    begun, fits = time.process_time(), 0.0
    for k, left_out in enumerate(folds):
        kept = np.setdiff1d(np.arange(len(rows.X)), left_out)
        since = time.process_time()
        model = fitted(learner, rows.where(kept).thinned(most), np.random.default_rng([seed, k]), view, moves=moves)
        fits += time.process_time() - since
        predicted[left_out] = model.predict(rows.X[left_out])
        before[left_out] = rows.Y[kept].mean(axis=0)
        ahead[k] = error_ahead(model, rows.where(left_out)) if chained else np.nan
        spent = time.process_time() - begun
        if begun + spent * len(folds) / (k + 1) > until:
            return None
    return score(learner.name, rows, predicted, before, folds, ahead, fits / len(folds))


def error_ahead(model: Model | None, rows: Rows) -> float:
    """Mean absolute error of `chained`, in spreads of the outputs."""
    return _mean_error(np.abs(chained(model, rows) - rows.Y), rows)


def chained(model: Model | None, rows: Rows) -> Array:
    """(N, k) what is foretold in chains of a second that begin at measured frames, each going on from what it foretold:
    in that time (`SETTLE`) a joint forgets what was, or a robot has fallen.

    Commands and other channels are as recorded. None holds the first value.
    """
    inputs, N = rows.inputs, len(rows.X)
    length = max(round(SETTLE / inputs.period), 1)
    first = np.concatenate([[True], (np.diff(rows.run) != 0) | (np.diff(rows.frame) != 1)])
    since = np.arange(N) - np.maximum.accumulate(np.where(first, np.arange(N), 0))
    starts = np.flatnonzero(since % length == 0)
    ends = np.append(starts[1:], N)  # of each chain
    past: list[Array] = []  # what was said in the frames before, one row a chain
    told = np.full_like(rows.Y, np.nan)
    for t in range(length):
        going = np.flatnonzero(starts + t < ends)
        X = rows.X[starts[going] + t]
        for q, at in zip(past, inputs.frames, strict=False):
            X[:, at + inputs.position_columns] = q[going]
        now = np.zeros((len(starts), rows.Y.shape[1]))
        now[going] = X[:, inputs.position_columns] if model is None else model.predict(X)
        told[starts[going] + t] = now[going]
        past = [now, *past[: inputs.history - 1]]
    return told


def score(
    name: str, rows: Rows, predicted: Array, mean: Array, folds: Sequence[Integers], ahead: Array, seconds: float = 0.0
) -> Score:
    """Errors of `predicted` (N, k) beside those of the training means (N, k)."""
    wrong, base = predicted - rows.Y, mean - rows.Y
    moves = np.where(rows.moves, 1.0, np.nan)
    by_fold = np.array([_mean_error(np.abs(wrong[f]), rows) for f in folds])
    return Score(
        name,
        moves * np.abs(wrong).sum(axis=0) / np.maximum(np.abs(base).sum(axis=0), TINY),
        moves * np.sqrt(np.sum(wrong**2, axis=0) / np.maximum(np.sum(base**2, axis=0), TINY)),
        np.sqrt(np.mean(wrong**2, axis=0)), by_fold, ahead, seconds,
    )  # fmt: skip


def _mean_error(wrong: Array, rows: Rows) -> float:
    """The mean of absolute errors (n, k) of what moves, in spreads of the outputs; beneath its noise no error can be seen."""
    return float(np.mean((np.hypot(wrong.mean(axis=0), rows.noise) / rows.spread)[rows.moves]))


def compare(
    learners: Sequence[Learner], rows: Rows, view: str = "plain", *, budget: float = 120.0, seed: int = 0,
    by_row: bool = True, progress: Progress | None = None,
) -> Comparison:  # fmt: skip
    """Both cross-validations of all learners within `budget` CPU seconds; those by run first, since these decide."""
    runs, parts = folds_by_run(rows), folds_by_row(rows, np.random.default_rng(seed))
    until = time.process_time() + budget
    done: list[dict[str, Score]] = [{}, {}]
    jobs = list(_jobs(learners, runs, parts, by_row))
    for k, (which, learner, folds) in enumerate(jobs):
        if progress is not None:
            progress(f"{learner.name}, {'whole runs' if which == 0 else 'rows'} left out", k / len(jobs))
        found = cross_validated(learner, rows, folds, view, seed=seed, until=until, chained=which == 0)
        if found is not None:
            done[which][learner.name] = found
    held = held_score(rows)
    skipped = tuple(x.name for x in learners if x.name not in done[0])
    return Comparison(done[1], done[0], held, *chosen(done[0]), skipped)


def surely(before: Score, after: Score) -> bool:
    """Whether inputs are worth having: lower errors a second ahead, and beyond doubt there or one frame ahead."""
    sure = evidence(before.ahead, after.ahead).holds or evidence(before.by_fold, after.by_fold).holds
    return sure and after.typical < before.typical


def held_score(rows: Rows) -> Score:
    """Holding the last value, left out by run."""
    folds = folds_by_run(rows)
    mean = np.empty_like(rows.Y)
    for left_out in folds:
        mean[left_out] = np.delete(rows.Y, left_out, axis=0).mean(axis=0)
    ahead = np.array([error_ahead(None, rows.where(f)) for f in folds])
    return score("hold the last value", rows, rows.held, mean, folds, ahead)


def chosen(by_run: dict[str, Score], plain: str = "linear") -> tuple[str, str]:
    """The learner that wins by run, and why: the best one, if it beats the plain one beyond doubt (`evidence`)."""
    if not by_run:
        return "", "no learner was done within the time"
    best = min(by_run, key=lambda name: by_run[name].typical)
    if plain not in by_run or best == plain:
        return best, "the least error on runs left out"
    gain = evidence(by_run[plain].ahead, by_run[best].ahead)
    words = f"ln(error of {plain} / error of {best}) on runs left out is {gain.gain:.2f} +- {gain.standard_error:.2f}"
    return (best, words) if gain.holds else (plain, f"{best} is not surely better: {words}")


def _jobs(
    learners: Sequence[Learner], runs: list[Integers], parts: list[Integers], by_row: bool
) -> Iterator[tuple[int, Learner, list[Integers]]]:
    yield from ((0, learner, runs) for learner in learners)
    if by_row:
        yield from ((1, learner, parts) for learner in learners)
