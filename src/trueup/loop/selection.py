# SPDX-License-Identifier: Apache-2.0
"""Chooses the parameters that the recordings can support: by what they can see, and by the error on what was left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.evidence import Evidence, evidence
from trueup.loop.descent import Fit
from trueup.loop.identifiability import NO_EFFECT, UNSEEN, UNTOLD, effects, verdicts
from trueup.loop.limits import is_limit
from trueup.loop.problem import Problem
from trueup.loop.validate import (
    Block,
    by_setting,
    by_stretch,
    cautious_errors,
    left_out_errors,
    settled_loss,
    settling,
)
from trueup.parameters import Parameter
from trueup.rounding import TINY
from trueup.search.robust import robust_losses
from trueup.verdicts import PRIOR, vague

_PLAINLY = 10.0
"""Of what proves one parameter: where slopes leave no doubt, and what settling by slopes may leave of less than a tenth."""


@dataclass(frozen=True)
class Choice:
    """Parameters to freeze at their nominal value, and the sentences that say why."""

    freeze: tuple[str, ...]
    notes: tuple[str, ...]
    vague: tuple[str, ...] = ()
    """Kept because left-out recordings are replayed better with them, though their intervals are wide."""

    def words(self) -> tuple[str, ...]:
        """The sentences, where each is of one parameter, with all those in one of which the same is said."""
        said: dict[str, list[str]] = {}
        for name, note in zip(self.freeze, self.notes, strict=True):
            said.setdefault(note.removeprefix(name), []).append(name)
        return tuple(f"{', '.join(names)}{note}" for note, names in said.items())


def choose(problem: Problem, fit: Fit, covariance: Array) -> tuple[Choice, Choice]:
    """What the recordings cannot tell, and what they do not need, tried in the order of least to lose.

    Optional structures (all parameters of one `optional` name) go first, then parameters of which the recordings hardly
    narrow the range. Each is frozen unless what was left out of the fit is foretold better with it (`trueup.evidence`):
    what is known vaguely may help all the same, where a shipped value is plainly wrong.
    """
    strength = dict(zip((p.name for p in fit.space.parameters if not p.frozen), effects(fit), strict=True))
    # What has no effect at all costs nothing, and may have one elsewhere (a foot that sticks, a limit not reached).
    wide = [p for p in _wide(fit, covariance) if strength[p.name] >= NO_EFFECT]
    judge = _Judge(problem, fit)
    notes = tuple(judge.structure(name) for name in judge.structures)
    structures = tuple(judge.frozen)
    unseen, much = list[Parameter](), fit.loss + _PLAINLY * proof(problem, fit)
    for p in (p for p in wide if p.name not in structures):
        together = [judge.free.index(q) for q in (*unseen, p)]  # of several that make up for one another not all may go
        if (not unseen or _settled_below(problem, fit, [together], much)) and not judge.tried([p.name]).holds:
            unseen.append(p)
    kept = tuple(p.name for p in wide if p.name not in judge.frozen)
    return Choice(tuple(p.name for p in unseen), kept_notes(unseen), kept), Choice(structures, notes)


def untold(problem: Problem, fit: Fit, covariance: Array, kept: Sequence[str]) -> Choice:
    """What ended away from its nominal value where the recordings do not tell it, or do not see it, and are replayed as well
    with it there, by the same rule.

    `kept` are names of those that have been asked about, and are again where nothing is seen of them since; structures and
    limits have been, too.
    """
    free = [p for p in fit.space.parameters if not p.frozen]
    moved = dict(zip((p.name for p in free), ~np.isclose(fit.values, fit.space.nominal)[fit.space.free], strict=True))
    seen = verdicts(fit, covariance)
    asked = [
        p for p, verdict in zip(free, seen, strict=True)
        if verdict.word in UNTOLD and (moved[p.name] or p.unidentified is not None)
        and (p.name not in kept or verdict.word == UNSEEN) and not _structure(problem, p)
    ]  # fmt: skip
    if not asked:
        return Choice((), ())
    judge, unseen = _Judge(problem, fit), list[Parameter]()
    if judge.parts > 1:  # of one part nothing can be left out, whatever it misses
        asked = not_missed(problem, fit, asked)
    for p in asked:  # of several that make up for one another, any may go, and not all
        alone = not unseen or judge.parts == 1 or not_missed(problem, fit, [*unseen, p], together=True)
        unseen += [p] if alone and not judge.tried([p.name]).holds else []
    stay = tuple(p.name for p in asked if p not in unseen)
    return Choice(tuple(p.name for p in unseen), kept_notes(unseen), stay)


def shallow(problem: Problem, fit: Fit) -> list[Parameter]:
    """What slopes place far from its start value, though it costs hardly anything to be there: beside a place where a foot
    slips a little and all else makes up for it lies the plateau of all friction with which it sticks.
    """
    curvature = fit.jacobian.T @ (fit.jacobian * fit.weights[:, None])
    inverse = np.linalg.inv(curvature + PRIOR * np.eye(len(curvature)))
    foretold = 0.5 * (_elsewhere(fit) - fit.unit) ** 2 / np.diag(inverse)
    free, much = [p for p in fit.space.parameters if not p.frozen], _PLAINLY * proof(problem, fit)
    some = [k for k, p in enumerate(free) if foretold[k] > much and not _structure(problem, p)]
    places = [free.index(p) for p in _settled_below(problem, fit, [[k] for k in some], fit.loss + much)]
    return [free[k] for k, loss in zip(places, _settled(problem, fit, places), strict=True) if loss < fit.loss + much]


def _structure(problem: Problem, p: Parameter) -> bool:
    """Whether it is one of a structure, which has been asked about; not a limit that was searched with all else."""
    declared = problem.simulator.parameters[p.name]
    return bool(p.optional) or (p.absent is not None and (bool(declared.optional) or not is_limit(p)))


def proof(problem: Problem, fit: Fit) -> float:
    """By how much one more parameter must lower the loss to be there (G. Schwarz, Annals of Statistics 6, 1978)."""
    chance = problem.chance(fit.residual)
    alike = max(2.0 * chance / max(float(np.mean(fit.residual**2)), TINY), 1.0)
    return chance * float(np.log(max(len(fit.residual) / alike, np.e)))


def kept_notes(parameters: Sequence[Parameter]) -> tuple[str, ...]:
    """What is said of parameters that stay as they were, a sentence each."""
    said = {p.name: f"kept at {p.nominal:.4g} {p.unit}" if p.unidentified is None else "left out" for p in parameters}
    return tuple(f"{name} {how}: told by none of these recordings" for name, how in said.items())


def _wide(fit: Fit, covariance: Array) -> list[Parameter]:
    """Parameters that the recordings hardly see, one after the other: freezing one may make its partner visible.

    Of two that cannot be told apart the one with the weaker effect comes first.
    """
    free = [p for p in fit.space.parameters if not p.frozen]
    strength = effects(fit)
    precision = np.linalg.inv(covariance + 1e-14 * np.eye(len(covariance)))
    kept = list(range(len(free)))
    dropped: list[Parameter] = []
    while kept:
        spread = np.sqrt(np.maximum(np.diag(np.linalg.inv(precision[np.ix_(kept, kept)])), 0.0))
        loose = [i for i, s in zip(kept, spread, strict=True) if vague(s)]
        if not loose:
            break
        worst = min(loose, key=lambda i: strength[i])
        kept.remove(worst)
        dropped.append(free[worst])
    return dropped


def not_missed(
    problem: Problem, fit: Fit, parameters: Sequence[Parameter], *, together: bool = False
) -> list[Parameter]:
    """Those without which, each or all `together` as if nobody told them, recordings are replayed as well once all others
    have settled.
    """
    free = [p for p in fit.space.parameters if not p.frozen]
    places = [free.index(p) for p in parameters]
    without = [places] if together else [[k] for k in places]
    return _settled_below(problem, fit, without, fit.loss + problem.chance(fit.residual) * len(free))


def _settled_below(problem: Problem, fit: Fit, without: Sequence[list[int]], most: float) -> list[Parameter]:
    """The free parameters, by sets of their numbers, without which the loss stays below `most` once all others settled."""
    free, nominal = [p for p in fit.space.parameters if not p.frozen], _elsewhere(fit)
    points = np.repeat(fit.unit[None], len(without), axis=0)
    for point, places in zip(points, without, strict=True):
        point[places] = nominal[places]
    residuals = problem.residuals(fit.space.from_unit(points)) if len(without) else ()
    others = [np.delete(np.arange(len(free)), places) for places in without]
    losses = [settled_loss(fit, rest, r) for rest, r in zip(others, residuals, strict=True)]
    return [free[k] for places, loss in zip(without, losses, strict=True) if loss < most for k in places]


def _settled(problem: Problem, fit: Fit, places: Sequence[int]) -> Array:
    """(k,) the lowest loss with each free parameter of numbers `places` elsewhere while all others settle, by steps with the
    slopes of the fit (J. E. Dennis and R. B. Schnabel, Numerical Methods for Unconstrained Optimization, 1983: the chord
    method) until none gains what would prove a parameter: what one step promises may lie beyond where slopes hold.
    """
    points, lowest, gain = (
        np.repeat(fit.unit[None], len(places), axis=0),
        np.full(len(places), np.inf),
        proof(problem, fit),
    )
    points[np.arange(len(places)), places] = _elsewhere(fit)[places]
    while len(places):
        residuals = problem.residuals(fit.space.from_unit(points))
        losses = np.nan_to_num(robust_losses(residuals, fit.bend), nan=np.inf)
        before, lowest = lowest, np.fmin(lowest, losses)
        if not np.any(lowest < before - gain):
            break
        for point, place, residual in zip(points, places, residuals, strict=True):
            others = np.delete(np.arange(len(point)), place)
            if np.isfinite(residual).all():
                point[others] = np.clip(point[others] + settling(fit, others, residual)[2], 0.0, 1.0)
    return lowest


def _elsewhere(fit: Fit) -> Array:
    """(n_free,) where in the box each parameter is tried to be instead: the value of what is not identified, unless the fit
    moved it. A limit at 2.6 rad/s that is known roughly may well be one; of one that stayed at its start nothing is known.
    """
    space = fit.space
    values = np.where(np.isclose(fit.values, space.nominal), space.unidentified, space.nominal)
    return np.clip(space.to_unit(values), 0.0, 1.0)


class _Judge:
    """Freezes parameters one set after the other where what was left out of the fit does not miss them."""

    def __init__(self, problem: Problem, fit: Fit) -> None:
        self.free = [p for p in fit.space.parameters if not p.frozen]
        self.frozen: list[str] = []
        self._problem, self._fit, self._blocks = problem, fit, by_stretch(problem)
        self.parts = len(self._blocks)
        self._settings = tuple(by_setting(problem).values())
        self._nominal = _elsewhere(fit)
        self._errors: Array | None = None
        self.structures = sorted({p.optional for p in self.free if p.optional}, key=self._lost)

    def _lost(self, name: str) -> float:
        """By how much the loss rises without a structure, by slopes, once all others have settled."""
        gone = np.array([p.optional == name for p in self.free])
        fit, moved = self._fit, (self._nominal - self._fit.unit)[gone]
        curvature = fit.jacobian.T @ (fit.jacobian * fit.weights[:, None]) + PRIOR * np.eye(len(gone))
        slope = curvature[np.ix_(~gone, gone)] @ moved
        settled = np.linalg.solve(curvature[np.ix_(~gone, ~gone)], slope) if len(slope) else slope
        return float(0.5 * moved @ curvature[np.ix_(gone, gone)] @ moved - 0.5 * slope @ settled)

    def structure(self, name: str) -> str:
        """Judges one optional structure; says what came of it."""
        shown = self.tried([p.name for p in self.free if p.optional == name])
        return verdict(name, shown)

    def tried(self, names: Sequence[str]) -> Evidence:
        """The evidence for parameters, which are frozen where it does not hold: by stretches and by settings."""
        less = [*self.frozen, *names]
        if self._errors is None:
            self._errors = self._left_out([], self._blocks)
        without = self._left_out(less, self._blocks)
        shown = compared(without, self._errors)
        if shown.holds:  # and not because slopes, which contacts make rough, led too far without it
            without = np.fmin(without, cautious_errors(self._problem, self._fit, self._blocks, self._held(less)))
            shown = compared(without, self._errors)
        for blocks in self._settings:
            if shown.holds:
                shown = compared(self._left_out(less, blocks), self._left_out(self.frozen, blocks))
        if not shown.holds:
            self.frozen += names
            self._errors = without
        return shown

    def _left_out(self, frozen: Sequence[str], blocks: Sequence[Block]) -> Array:
        return left_out_errors(self._problem, self._fit, blocks, self._held(frozen))

    def _held(self, frozen: Sequence[str]) -> Array:
        return np.where([p.name in frozen for p in self.free], self._nominal, np.nan)


def compared(without: Array, with_it: Array) -> Evidence:
    """The evidence of left-out errors (B,); what cannot be replayed without a structure needs it."""
    if (np.isinf(without) & np.isfinite(with_it)).any():
        return Evidence(float("inf"), 0.0)
    some = ~np.isnan(without)
    return evidence(without[some], with_it[some])


def elsewhere(problem: Problem, without: Fit, with_it: Fit) -> str:
    """What speaks against a structure where recordings differ in a setting (gain, load, supply): those of each setting by
    fits to the others. "" where it holds there too, or all were made alike.

    Stretches of time are foretold from the stretches beside them: friction of another form than the robot's passes there.
    """
    for name, blocks in by_setting(problem).items():
        shown = compared(*(cautious_errors(problem, fit, blocks) for fit in (without, with_it)))
        if not shown.holds:
            return f"with it errors on recordings of another '{name}' than those fitted are {shown.in_words()}"
    return ""


def verdict(structure: str, shown: Evidence) -> str:
    """What came of an optional structure, in words."""
    if np.isinf(shown.gain):
        return f"{structure} kept: without it left-out recordings cannot be replayed"
    return f"{structure} {'kept' if shown.holds else 'left out'}: with it left-out errors are {shown.in_words()}"
