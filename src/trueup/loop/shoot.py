# SPDX-License-Identifier: Apache-2.0
"""Multiple shooting: replays that begin at measured instants, from states that are known but for the noise there.

H. G. Bock and K. J. Plitt, A multiple shooting algorithm for direct solution of optimal control problems, IFAC 1984.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.instant import Instant, at_instant
from trueup.loop.condensing import Eliminated, cut
from trueup.loop.problem import Problem
from trueup.noise import spread
from trueup.rounding import SAME_INSTANT
from trueup.samples import wrapped
from trueup.trial import Observed, Trial

LONGER = 1.4  # times the part before: doubled ones led one of four legs astray, and one of eight cars
SHORTEST = 0.1  # s: the shortest part of a replay; by then a start has shown whether it has an effect
_DAMPINGS = (0.0, 0.1, 1.0, 10.0)  # of the corrections that are tried side by side


@dataclass(frozen=True, eq=False)
class Ahead:
    """Replays from corrected starts, and beside them to one side."""

    begun: list[Trial]
    residual: Array
    """(m,)"""
    more: Array
    """(K, m) by how much one standard deviation more of each correction changes them."""

    def known(self, less: Array | None = None, side: float = -1.0) -> Array:
        """(K, m) half the changes and their negative (`side` -1), or their sum, where to the other side they are `less`
        (None: all turned round). What cannot be simulated is not corrected: 0.
        """
        change = 0.5 * (self.more + side * (-self.more if less is None else less))
        return np.where(np.isfinite(change).all(axis=1, keepdims=True), change, 0.0)


@dataclass(frozen=True, eq=False)
class Starts:
    """Corrections of measured starts, as numbers in standard deviations: value and speed of each label that has an effect."""

    measured: tuple[Trial, ...]
    handles: tuple[tuple[str, int, int], ...]
    """Channel, place of the label in it, and 0 for its value, 1 for its speed."""
    sizes: Array
    """(R, K) standard deviation of each, in the channel's unit (per second)."""
    amounts: Array
    """(R, K) corrections, in these."""
    roots: Array | None = None
    """(R, K, K) square roots of the covariances that replays have left of the corrections: over so much slopes are taken.
    None: 1 each."""

    @classmethod
    def every(cls, problem: Problem) -> Starts:
        """No corrections, of whatever was measured."""
        widths = {n: len(c.labels) for t in problem.trials for n, c in t.initial.items()}
        handles = tuple((name, j, order) for name, width in widths.items() for j in range(width) for order in (0, 1))
        sizes = np.zeros((len(problem.trials), len(handles)))
        for r, trial in enumerate(problem.trials):
            told = _sizes(trial)
            sizes[r] = [told[n][order, j] if n in told and j < told[n].shape[1] else 0.0 for n, j, order in handles]
        return cls(problem.trials, handles, sizes, np.zeros_like(sizes))

    @classmethod
    def as_measured(cls, problem: Problem, values: Array) -> Starts:
        """No corrections, of whatever changes the first samples at values (n,)."""
        every = cls.every(problem)
        begun = problem.replayed_by([cut(t, t.start, SHORTEST) for t in problem.trials], problem.owners)
        ahead = replace(every, measured=begun.trials).ahead(begun, values)
        seen = np.flatnonzero(ahead.known().any(axis=1))
        sizes = every.sizes[:, seen]
        return cls(problem.trials, tuple(every.handles[k] for k in seen), sizes, np.zeros_like(sizes))

    def ahead(self, problem: Problem, values: Array) -> Ahead:
        """The corrected trials, and how one standard deviation more of each correction changes their residuals."""
        begun = self.trials()
        residual, *moved = self._moved(problem, values, [begun], 1.0)
        return Ahead(begun, residual, np.array(moved).reshape(len(self.handles), len(residual)) - residual)

    def eliminated_from(
        self, problem: Problem, values: Array, *, bent: bool = True, ahead: Ahead | None = None
    ) -> Problem:
        """The problem begun with these corrections and with further ones eliminated, as seen at values (n,) to both sides, or
        to one if they are not to be `bent`. `ahead`: what was seen there to that side.
        """
        if not self.handles:
            return problem
        ahead = ahead or self.ahead(problem, values)
        less = None
        if bent:  # the part that turns its sign with the correction's, and the part that does not
            less = np.array(self._moved(problem, values, [], -1.0)) - ahead.residual
        slopes, bends = (ahead.known(less, side) for side in (-1.0, 1.0))
        size = max(1.0, float(spread(ahead.residual)))
        parts = [problem.columns(r) for r in range(len(self.measured))]
        gone = []
        for r, p in enumerate(parts):
            changes = slopes[:, p].T
            if self.roots is not None:
                changes = np.linalg.solve(self.roots[r].T, changes.T).T
            gone.append(Eliminated.of(p, changes, bends[:, p].T, self.amounts[r], size))
        return problem.with_starts(ahead.begun, gone)

    def _moved(self, problem: Problem, values: Array, begun: list[list[Trial]], side: float) -> list[Array]:
        """(m,) residuals of trials, and of those with each correction a standard deviation further to one side."""
        k = len(self.handles)
        steps = side * np.eye(k) if self.roots is None else side * np.moveaxis(self.roots, 2, 0)
        begun = [*begun, *(replace(self, amounts=self.amounts + step).trials() for step in steps)]
        several = problem.replayed_by([t for own in begun for t in own], problem.owners * len(begun))
        return list(several.plain_residuals(values[None]).reshape(len(begun), -1))

    def corrected(self, problem: Problem, values: Array) -> tuple[Starts, float]:
        """Corrections that replay better with values (n,), and by how much more or less than slopes foretell.

        Steps of Levenberg and Marquardt, of several lengths at once, and beginning where the trial before ends, which leads
        on from where a touch of the ground lets no step lower the error; each trial takes its own best, or stays.
        """
        begun = problem.plain_residuals(values[None])
        steps = [self.amounts, *(np.array([s.solved(begun[0], d) for s in problem.eliminated]) for d in _DAMPINGS)]
        if (going_on := self.continued(problem, values)) is not None:
            steps.append(going_on)
        tried = problem.replayed_by(
            [t for amounts in steps[1:] for t in replace(self, amounts=amounts).trials()],
            problem.owners * (len(steps) - 1),
        )
        residuals = np.concatenate([begun, tried.plain_residuals(values[None]).reshape(len(steps) - 1, -1)])
        amounts, surprise = np.array(steps), 0.0
        for s in problem.eliminated:
            s.apply(begun)
        chosen = np.empty_like(self.amounts)
        for r, s in enumerate(problem.eliminated):
            losses = np.nan_to_num(s.loss(residuals, amounts[:, r]), nan=np.inf)
            chosen[r] = amounts[losses.argmin(), r]
            surprise += s.size**2 * abs(float(losses.min()) - float(s.loss(begun, np.zeros((1, 1)))[0]))
        return replace(self, amounts=chosen, roots=np.array([s.root() for s in problem.eliminated])), surprise

    def continued(self, problem: Problem, values: Array) -> Array | None:
        """(R, K) corrections with which each trial begins where the replay of the one before it ends, by values (n,): between
        windows nothing jumps (the continuity of Bock and Plitt). None where no trial goes on from another; those of here for
        the first of a recording, and after a replay that fails.
        """
        after = [k for k in range(1, len(self.measured)) if _goes_on(self.measured[k - 1], self.measured[k])]
        if not after:
            return None
        step, begun = problem.simulator.step, self.trials()
        ends = problem.replayed_by([_end(begun[k - 1], step) for k in after], [problem.owners[k - 1] for k in after])
        amounts = self.amounts.copy()
        for k, end in zip(after, ends.rollouts(values[None]), strict=True):
            measured = _instants(self.measured[k])
            for n, (name, j, order) in enumerate(self.handles):
                if not end.failures and self.sizes[k, n] and name in end.channels:
                    before, there, beyond = end.channels[name][0, :, j]
                    state = measured[name]
                    more = there - state.value[j] if order == 0 else (beyond - before) / (2.0 * step) - state.speed[j]
                    turns = order == 0 and self.measured[k].initial[name].unit == "rad"
                    amounts[k, n] = (wrapped(more) if turns else more) / self.sizes[k, n]
        return amounts

    def first(self, problem: Problem, longest: float) -> tuple[Problem, Starts]:
        """The problem on the first `longest` s of its trials as they were measured, and these for it."""
        part = problem.replayed_by([cut(t, t.start, longest) for t in self.measured], problem.owners)
        return part, replace(self, measured=part.trials)

    def as_wide(self) -> Starts:
        """These, of which nothing but what was measured is known."""
        return replace(self, roots=None)

    def trials(self) -> list[Trial]:
        """The trials with these corrections."""
        return [self._begun(r, row) for r, row in enumerate(self.amounts)]

    def _begun(self, r: int, amounts: Array) -> Trial:
        trial = self.measured[r]
        corrections = {name: np.zeros((2, len(c.labels))) for name, c in trial.initial.items()}
        for (name, j, order), amount, size in zip(self.handles, amounts, self.sizes[r], strict=True):
            if size:
                corrections[name][order, j] = amount * size
        return replace(trial, corrections={n: c for n, c in corrections.items() if c.any()})


def _goes_on(before: Trial, trial: Trial) -> bool:
    """Whether a trial begins where the one before it ends."""
    return before.name == trial.name and abs(before.start + before.duration - trial.start) < SAME_INSTANT


def _end(trial: Trial, step: float) -> Trial:
    """The trial, observed at its end and a step before and behind."""
    stop = trial.start + trial.duration
    around = stop + step * np.array([-1.0, 0.0, 1.0])
    seen = {n: Observed(c.labels, c.unit, around) for n, c in trial.initial.items() if n in trial.observed}
    return replace(trial, duration=trial.duration + step, observed=seen)


def _sizes(trial: Trial) -> dict[str, Array]:
    """Channel to (2, k) standard deviations of its values and speeds at the trial's start, where they can be told."""
    found = {name: np.nan_to_num([begun.value_sd, begun.speed_sd]) for name, begun in _instants(trial).items()}
    return {name: np.hypot(sd, trial.initial_sd.get(name, 0.0)) for name, sd in found.items()}


def _instants(trial: Trial) -> dict[str, Instant]:
    """Channel to its values and speeds at the trial's start, as measured."""
    speeds = {c.labels: c for c in trial.initial.values() if c.unit.endswith("/s")}
    found = {}
    for name, channel in trial.initial.items():
        paired = speeds.get(channel.labels)
        fits = paired is not None and paired.unit == f"{channel.unit}/s"
        found[name] = at_instant(channel, paired if fits else None, trial.start)
    return found
