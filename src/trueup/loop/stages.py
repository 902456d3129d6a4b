# SPDX-License-Identifier: Apache-2.0
"""What a search may do, one thing a stage: least squares on more and more, and looks where slopes do not lead."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.evidence import HALVED, explained
from trueup.loop.descent import Descent, Fit, Look, Select, last_look
from trueup.loop.disturbed import LeftOut
from trueup.loop.elsewhere import FEW, along_axes, anywhere, evolved, losses_at
from trueup.loop.interior import nudge
from trueup.loop.probe import probed
from trueup.loop.problem import Problem
from trueup.loop.shoot import LONGER, Starts
from trueup.loop.wide import widened
from trueup.parameters import Parameter
from trueup.search.least_squares import LeastSquares
from trueup.search.robust import robust_losses


@dataclass
class Run:
    """A search under way: what its stages read and change."""

    problem: Problem
    coarse: Problem
    """The problem at a coarser step; the problem itself where none is faithful."""
    values: Array
    """(n,) to search from."""
    descent: Descent
    select: Select | None
    seed: int
    first: Problem
    """The cheapest look at the recordings."""
    saved: dict[str, Any] | None = None
    """State of an interrupted search, for the stage that it was in."""
    resumed: bool = False
    begun: bool = False
    """Whether joints have been searched one by one."""
    looks: int = 0
    """Looks gone through so far."""
    look: Look = field(init=False)  # the last of them
    later: Mapping[str, Mapping[str, Parameter]] = field(default_factory=dict)
    """Structures that are frozen at zero and wait for the fit without them: their parameters as declared, by name."""
    starts: Starts | None = None
    """Corrections of measured starts, where an earlier fit has made some."""
    early: Array | None = None  # (n,) values to which the first look led
    short: Array | None = None  # (n,) values that replay the first part of the recordings to its noise, if any do
    profiled: dict[str, float] = field(default_factory=dict)
    """To what share of the box the profiles of parameters were followed, by name."""
    untold: Mapping[str, Parameter] = field(default_factory=dict)
    """What was frozen because the recordings did not tell it, as declared, by name."""
    notes: list[str] = field(default_factory=list)
    disturbed: LeftOut = field(default_factory=LeftOut)
    """Stretches that no values replay: the search ends where these are seen, to be begun without them."""
    weighed: Fit | None = None
    """The earlier fit, of all that is free here, where its slopes are those over a stretch (see `weighing.py`)."""
    ended: Fit | None = None

    @property
    def start(self) -> Array:
        """(n_free,) where the search begins, in the unit box."""
        return np.clip(self.descent.space.to_unit(self.values), 0.0, 1.0)

    @property
    def alone(self) -> Problem | None:
        """What is replayed joint by joint of the problem, at the coarser step; None where nothing is."""
        part = self.coarse.approximate_part
        return None if part is None else part.at_step(self.coarse.simulator.step)

    @property
    def smooth(self) -> Problem:
        """Where small differences are seen: an approximation at the same step, if any."""
        return self.problem if self.coarse.approximate_part is None else self.coarse

    def go(self, look: Look, *, again: bool = False) -> LeastSquares:
        """Least squares on one look, as the next; `again` where a search has ended here before (see `Descent.polish`)."""
        run = self.descent
        if self.looks and not np.isfinite(look.problem.residuals(run.space.from_unit(run.point[None]))).all():
            run.restart(self.start)  # what replays with a coarser step may blow up with the real one
            look = replace(look, cheap=look.problem)
        if self.looks == 1 and run.search is not None and explained(run.search.residual):
            self.short = run.space.from_unit(run.point)
        self.look, self.looks = look, self.looks + 1
        begins = self.looks == 1 and not (self.resumed or self.begun)
        return self._searched(look, begins=begins, saved=_take_saved(self), again=again)

    def again(self) -> None:
        """Goes through the last look once more from there, with other parameters free."""
        self._searched(self.look, again=True)

    def _searched(
        self, look: Look, saved: dict[str, Any] | None = None, *, begins: bool = False, again: bool = False
    ) -> LeastSquares:
        if saved is None and look.cheap.simulator is not look.problem.simulator:
            return self.descent.polish(look, again=again)
        off = nudge(look.problem, self.descent.space, self.descent.point) if begins else 0.0
        return self.descent.descend(look, nudge=off, saved=saved)

    def from_there(self, point: Array | None) -> None:
        """Goes through the last look once more, from another place."""
        if point is not None:
            self.descent.move(point)
            self._searched(self.look)

    @property
    def fit(self) -> Fit:
        """Where slopes have led, or what later stages made of it."""
        if self.ended is None:
            self.ended = self.descent.finished(self.look)
            if self.ended.near is None and self.alone is not None:  # to look around: the simulator would take minutes
                near = self.coarse.at_level(self.ended.values, self.ended.residual)
                self.ended = replace(self.ended, near=near)
        return self.ended


@dataclass(frozen=True)
class Stage:
    """One thing that a search does, by name; a search is a sequence of these."""

    name: str
    act: Callable[[Run], None]


def first_seconds(run: Run) -> None:
    """The first quarter of the recordings, loosely."""
    if run.first is not run.coarse and not run.begun:
        longest = max(t.duration for t in run.first.trials)
        real = run.problem.shortened(longest) if run.coarse is not run.problem else None
        run.go(Look("first seconds", run.first, run.first, 30.0, 15, real))
        run.early = run.descent.space.from_unit(run.descent.point)


def coarse_step(run: Run) -> None:
    """All recordings at a coarser step."""
    if run.coarse is not run.problem:
        run.go(Look("all, coarse step", run.coarse, run.coarse, 5.0, 25, run.problem))


def longer_parts(run: Run) -> None:
    """Where the first part is replayed to its noise, and all is neither that nor replayed as well: from there through parts
    that grow little by little. A loss over more time has more valleys, and the one that a short part leads into goes on as
    the part grows (A. H. Ribeiro et al., On the smoothness of nonlinear system identification, Automatica 121, 2020).
    """
    found, look, begin = run.descent.search, run.look if run.looks else None, run.short
    if begin is None or found is None or look is None or look.problem.duration < run.problem.duration:
        return
    run.short, before = None, run.descent
    first = run.first.residuals(begin[None])[0]
    if found.residual is None or HALVED**2 * np.mean(found.residual**2) < max(np.mean(first**2), HALVED**2):
        return
    run.descent = replace(before, watch=before.watch.aside())
    run.descent.restart(np.clip(before.space.to_unit(begin), 0.0, 1.0))
    length, longest = (max(t.duration for t in p.trials) for p in (run.first, run.coarse))
    while (length := LONGER * length) < longest:
        part = run.coarse.shortened(length)
        run.descent.descend(Look("longer parts", part, part, 5.0, 15))
    there = run._searched(look).residual
    old, new = robust_losses(np.stack([found.residual, found.residual if there is None else there]), found.delta)
    run.descent = before if not new < old else replace(run.descent, watch=before.watch)


def refinement(run: Run) -> None:
    """All recordings as they are, from where an earlier fit ended, until steps gain no more than chance would; not where that
    has corrected starts, from which `multiple_shooting` goes on.
    """
    run.resumed = True  # nothing is to be moved off its bound
    if run.starts is None:
        run.go(Look("refinement", run.problem, run.smooth, 1.0, 20, last=True), again=True)


def as_it_came(run: Run) -> None:
    """Takes no step: all recordings as they are, where the search begins."""
    run.look, run.looks = last_look(run.problem, run.problem), run.looks + 1
    run.descent.stay(run.look)


def full_step(run: Run) -> None:
    """All recordings as they are."""
    run.go(last_look(run.problem, run.coarse))


def selection(run: Run) -> None:
    """Freezes what all recordings do not support, before the last look and after it, whichever is the first to see them."""
    if run.select is None or not run.looks or run.look.problem.duration < run.problem.duration:
        return
    select, run.select = run.select, None
    found = run.descent.search
    if found is not None and found.residual is not None:  # this may take longer than what was before
        run.descent.watch.saw("structures in turn", run.look.problem, found.loss, run.look.problem.rmse(found.residual))
    searched = run.descent.space
    if run.descent.choose(run.look, select):
        kept = run.descent.space
        run.untold = {p.name: p for p in searched.parameters if not (p.frozen or p.optional) and kept[p.name].frozen}
        if run.look.problem is run.problem:
            run.descent.descend(run.look)


def lines(run: Run) -> None:
    """Looks along the axes of single parameters, as long as more of the recordings are still to come; and again from where
    that has led: while gains are far off, no friction is better than that of a foot that sticks.
    """
    rounds = 3  # of looks; the first mends one parameter, and slopes the others
    for _ in range(rounds if run.looks and (run.looks == 1 or not run.look.last) else 0):
        found = run.descent.search
        point = None if found is None else along_axes(run.look.problem, run.descent.space, found, run.first)
        if point is None:
            return
        run.from_there(point)


def evolution(run: Run) -> None:
    """Looks everywhere, after the first look, where slopes end far above the noise and parameters are few, or where no slope
    leads down at all: residuals are rough then (contacts, falls).
    """
    run_, found = run.descent, run.descent.search
    if run.looks != 1 or found is None or (len(run_.point) > FEW and (found.iteration > 0 or run.resumed)):
        return
    led = None if explained(found.residual) else run_.led(run.look)
    if explained(found.residual if led is None else led.residual):
        return
    point = anywhere(run.look.problem, run_.space, found, run_.watch, run.seed)
    if point is not None:
        run.from_there(point)
        lines(run)  # which others, far off until now, may have led astray
    again = None if led is None else run_.led(run.look)
    if led is not None and again is not None and run.look.real is not None:
        there, here = losses_at(run.look.real, run_.space, np.stack([led.point, again.point]))
        if there < here:
            run_.move(led.point)
            run_.stay(run.look)


def evolve_first(run: Run, short: bool = True) -> None:
    """CMA-ES before anything else, briefly."""
    saved, descent = _take_saved(run), run.descent
    descent.move(evolved(run.first, descent.space, run.start, descent.watch, run.seed, short=short, saved=saved))


def evolve_long(run: Run) -> None:
    """CMA-ES before anything else, to its end."""
    evolve_first(run, short=False)


def implicit_filtering(run: Run) -> None:
    """Wide differences lead further down where the loss has stairs; not where so much was recorded that joints are searched
    alone: every look would cost the engine minutes. Nor where slopes are wide already: these would be lost.
    """
    if run.fit.weighed or run.coarse.approximate_part is not None:
        return
    run.descent.watch.saw("around the optimum", run.problem, run.fit.loss, run.problem.rmse(run.fit.residual))
    run.ended = widened(run.problem, run.fit, run.seed, run.descent.robust)


def probing(run: Run) -> None:
    """What jumps around the optimum add to its uncertainty, and lower places beyond them."""
    run.ended = probed(run.fit.near or run.problem, run.fit, run.seed)


def _take_saved(run: Run) -> dict[str, Any] | None:
    saved, run.saved = run.saved, None
    return saved
