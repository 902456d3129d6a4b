# SPDX-License-Identifier: Apache-2.0
"""Learns how a robot's joints answer to commands: what to look at, by which learner, and where it may be asked."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.errors import GroundingError, counted
from trueup.evidence import evidence
from trueup.grounding.blend import SHARES
from trueup.grounding.comparison import (
    MOST,
    Comparison,
    Progress,
    Score,
    compare,
    cross_validated,
    error_ahead,
    folds_by_run,
    score,
    surely,
)
from trueup.grounding.domain import domain_of
from trueup.grounding.foretold import Foretold, foretold
from trueup.grounding.grounding import Grounding
from trueup.grounding.learners import LEARNERS, Learner, learners, tempered
from trueup.grounding.others import telling_nothing
from trueup.grounding.remarks import remarks
from trueup.grounding.rows import Inputs, Rows, inputs_of, refuse_others, rows_of
from trueup.grounding.views import VIEWS, Model, fitted, view_named
from trueup.recording import Recording


@dataclass(frozen=True)
class Wishes:
    """What a user may settle; None: the recordings do."""

    period: float | None = None
    """Frame in s."""
    history: int | None = None
    view: str | None = None
    others: tuple[str, ...] | None = None
    """Channels beside joints and commands."""
    joints: tuple[str, ...] | None = None
    learners: tuple[str, ...] | None = None
    budget: float = 120.0
    """CPU seconds for the comparison of learners."""
    by_row: bool = True
    """Whether rows are left out too, as the paper did."""
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Learned:
    """A grounding, and how it was come by."""

    grounding: Grounding
    comparison: Comparison
    score: Score
    """Of what the grounding holds, on runs left out."""
    rows: Rows
    view: str
    tried: tuple[tuple[str, float], ...]
    """Inputs that were tried, in words, each with its typical error on runs left out, in spreads of the outputs."""
    seconds: float
    shown: Foretold
    """A stretch of a run left out."""
    notes: tuple[str, ...] = ()
    """What is to be known of the recordings."""


def learn(
    recordings: Sequence[Recording], wishes: Wishes | None = None, *, held_out: Sequence[Recording] = (),
    progress: Progress | None = None,
) -> Learned:  # fmt: skip
    """Chooses inputs and learner by runs left out, and fits. `held_out` are to be judged later: that they cannot be is said
    before. Raises GroundingError, UnknownNameError, MissingExtraError.
    """
    wish, begun = wishes or Wishes(), time.process_time()
    first = inputs_of(recordings, period=wish.period, others=wish.others or (), joints=wish.joints)
    refuse_others(held_out, first)
    if not rows_of(recordings, first).moves.any():
        raise GroundingError(
            f"no joint that is commanded moves in any of {counted(len(recordings), 'recording')}: "
            f"{', '.join(first.commands)}; record runs in which they are told to move"
        )
    every = learners(wish.learners)
    inputs, view, tried = _inputs(recordings, wish, every, progress)
    rows = rows_of(recordings, inputs)
    found = compare(every, rows, view, budget=wish.budget, seed=wish.seed, by_row=wish.by_row, progress=progress)
    if not found.by_run:
        names = ", ".join(x.name for x in every)
        raise GroundingError(f"within {wish.budget:g} s none of {names} was done; give the comparison a larger budget")
    learner, share, taken = no_worse_than_a_line(found, rows, view, wish.seed)
    model = fitted(learner, rows.thinned(MOST), np.random.default_rng(wish.seed), view)
    why = (
        found.why
        if share == 1.0
        else f"{found.why}; {share:g} of what it departs from a line, or it is worse one frame on"
    )
    about = {"learner": learner.name, "view": view, "why": why, "recordings": "\n".join(r.name for r in recordings)}
    grounding = Grounding(inputs, model, domain_of(rows), about=about)
    notes = remarks(recordings, rows, chosen=wish.others is not None)
    shown = foretold(learner, rows, view, taken, wish.seed)
    return Learned(grounding, found, taken, rows, view, tried, time.process_time() - begun, shown, notes)


def no_worse_than_a_line(found: Comparison, rows: Rows, view: str, seed: int) -> tuple[Learner, float, Score]:
    """The chosen learner, all of it, where it foretells one frame of left-out runs no worse than a line does; else that
    learner and share of what it departs from the line which does, and foretells a second best.

    What the noise of a measurement hides in one frame is told by a second; there a learner may have learned the noise.
    """
    tried = 3  # learners of which shares are tried
    name, line = found.chosen, found.by_run.get("linear")
    if line is None:
        return LEARNERS[name], 1.0, found.by_run[name]
    if evidence(line.by_fold, found.by_run[name].by_fold).gain >= 0.0:
        return LEARNERS[name], 1.0, found.by_run[name]
    kept = [(LEARNERS["linear"], 1.0, line)]
    for name in sorted(found.by_run, key=lambda n: found.by_run[n].typical)[:tried]:
        for share in SHARES[:0:-1].tolist():
            learner = tempered(LEARNERS[name], share)
            told = cross_validated(learner, rows, folds_by_run(rows), view, seed=seed)
            if told is not None and evidence(line.by_fold, told.by_fold).gain >= 0.0:
                kept.append((learner, share, told))
                break
    return min(kept, key=lambda each: each[2].typical)


def _inputs(
    recordings: Sequence[Recording], wish: Wishes, every: Sequence[Learner], progress: Progress | None
) -> tuple[Inputs, str, tuple[tuple[str, float], ...]]:
    """What to look at: a view, then as many frames before, then other channels, as the evidence of left-out runs holds."""
    named = [x.name for x in every]
    probe = LEARNERS[next((n for n in ("model-tree", "tree", "linear") if n in named), named[0])]
    tried: list[tuple[str, float]] = []

    def tell(inputs: Inputs, view: str) -> Score:
        rows = rows_of(recordings, inputs)
        found = cross_validated(probe, rows, folds_by_run(rows), view, seed=wish.seed, most=4000)
        if found is None:
            raise RuntimeError("a cross-validation without a limit of time was not done")
        more = f" with {', '.join(inputs.others)}" if inputs.others else ""
        tried.append((f"{view}, {counted(inputs.history, 'frame')}{more}", found.typical))
        if progress is not None:
            progress(f"inputs: {tried[-1][0]}", 0.0)
        return found

    first = 2 if wish.history is None else wish.history
    whole = inputs_of(recordings, period=wish.period, history=first, others=wish.others, joints=wish.joints)
    inputs = whole if wish.others is not None else dataclasses.replace(whole, others={})
    views = [wish.view] if wish.view is not None else list(VIEWS)
    scores = {v: tell(inputs, v) for v in views if view_named(v)}
    view, best = min(scores.items(), key=lambda each: each[1].typical)
    if wish.history is None:
        shorter = tell(dataclasses.replace(inputs, history=1), view)
        if not surely(shorter, best):
            inputs, best = dataclasses.replace(inputs, history=1), shorter
        while 1 < inputs.history < 6:  # more frames are not tried
            longer = tell(dataclasses.replace(inputs, history=inputs.history + 1), view)
            if not surely(best, longer):
                break
            inputs, best = dataclasses.replace(inputs, history=inputs.history + 1), longer
    left = whole.others if wish.others is not None else telling_nothing(recordings)
    for name in (n for n in whole.others if n not in left):
        more = dataclasses.replace(inputs, others={**inputs.others, name: whole.others[name]})
        told = tell(more, view)
        if surely(best, told):
            inputs, best = more, told
    return inputs, view, tuple(tried)


def judged(learned: Learned, recordings: Sequence[Recording]) -> dict[str, Score]:
    """How other recordings are predicted, run by run: by what was chosen, by a line with the same inputs, by holding.

    Raises GroundingError where they have not the inputs.
    """
    rows, training = rows_of(recordings, learned.rows.inputs), learned.rows
    if not rows.moves.any():  # a robot that stands is judged by how far its joints went in what was learned
        rows = dataclasses.replace(rows, moves=training.moves, spread=training.spread)
    folds = [np.flatnonzero(rows.run == k) for k in np.unique(rows.run)]
    mean = np.tile(training.Y.mean(axis=0), (len(rows.Y), 1))
    line = fitted(LEARNERS["linear"], training.thinned(MOST), np.random.default_rng(0), learned.view)
    best = learned.grounding.about["learner"]
    models: dict[str, Model | None] = {best: learned.grounding.forward, "linear": line, "hold the last value": None}
    return {
        name: score(name, rows, rows.held if model is None else model.predict(rows.X), mean, folds,
                    np.array([error_ahead(model, rows.where(f)) for f in folds]))
        for name, model in models.items()
    }  # fmt: skip
