# SPDX-License-Identifier: Apache-2.0
"""Freezes what the recordings do not support, while a search is under way and once it has ended, and remembers why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.loop.descent import Fit, descended
from trueup.loop.fit import REFINEMENT, SHIPPED, Stage, fit
from trueup.loop.problem import Problem
from trueup.loop.scans import missed
from trueup.loop.selection import Choice, choose, kept_notes, proof, shallow, untold
from trueup.loop.uncertainty import unit_covariance
from trueup.loop.watch import Watch
from trueup.parameters import Parameter, ParameterSpace
from trueup.search.robust import robust_losses


class Chooser:
    """What a search asks for the space that is worth searching; `choices` say what came of it: untold and structures."""

    def __init__(self) -> None:
        self.choices: tuple[Choice, ...] = ()

    def __call__(self, problem: Problem, found: Fit) -> ParameterSpace:
        """The space without what the recordings do not support, unless that leaves nothing."""
        unseen, structures = choose(problem, found, unit_covariance(problem, found))
        every = int(found.space.free.sum())
        if len(unseen.freeze) + len(structures.freeze) >= every:  # what is left then is asked about at the end
            unseen = replace(unseen, freeze=(), notes=())
        self.choices = unseen, structures
        names = (*unseen.freeze, *structures.freeze)
        return found.space.left_open(names) if len(names) < every else found.space

    def ended(self, problem: Problem, found: Fit, watch: Watch, how: Mapping[str, Any]) -> Fit:
        """The fit, or one without what ended away from its start where nothing tells of it any more.

        What was frozen meanwhile may have told of others, and searches that follow no slope move what has no effect. `how`:
        what the search was told (`fit`).
        """
        self.choices = self.choices or (Choice((), ()), Choice((), ()))
        self._still(found.space)
        first, lowest, asked = found, found.loss, False
        while True:
            late = untold(
                found.shot or found.near or problem, found, unit_covariance(problem, found), self.choices[0].vague
            )
            if not late.freeze:
                self._take(late)
                held = found if asked else self._at_start_values(problem, found, watch, how)
                if held is found:
                    return found
                found, lowest, asked = held, _loss(held, first), True  # what is held now may have told of others
                continue
            nothing = len(late.freeze) == int(found.space.free.sum())
            space = found.space.left_open(late.freeze[:-1] if nothing else late.freeze)
            values = np.where(space.free, found.values, space.nominal)
            told = {**how, "stages": SHIPPED} if nothing else {**how, "stages": _refining(how), "begun": found}
            again = fit(problem, space, space.nominal if nothing else values, watch.aside(), **told)
            lower = (loss := _loss(again, first)) < lowest - proof(problem, found)
            if lower and not again.weighed:  # it was no optimum where it was asked; among touches lower is chance
                lowest = loss
                told = {**how, "stages": _refining(how), "begun": replace(found, starts=again.starts)}
                found = _with_notes(fit(problem, found.space, again.values, watch, **told), found)
                continue
            self._take(late)
            found = _with_notes(again, found)
            if nothing:
                return replace(found, ended="the recordings tell nothing of what was to be found: all is as it came")

    def _at_start_values(self, problem: Problem, found: Fit, watch: Watch, how: Mapping[str, Any]) -> Fit:
        """The fit, or one with the start values of what it needs no other value of: of two that explain the recordings
        alike the one that was known before. All are asked about at once, then those that no score test misses in halves.
        """
        asked = shallow(found.shot or found.near or problem, found)[: int(found.space.free.sum()) - 1]
        groups = [asked] if asked else []
        while groups:
            some = groups.pop()
            held, values = _held_at_start(problem, found, some, how["robust"])
            again = None
            if values is not None:
                space = found.space.left_open([p.name for p in held])
                again = fit(problem, space, values, watch.aside(), **{**how, "stages": _refining(how)}, begun=found)
            if again is not None and _loss(again, found) < found.loss + proof(problem, found) * len(held):
                self._take(Choice(tuple(p.name for p in held), kept_notes(held)))
                found = _with_notes(again, found)
            elif len(held) > 1:
                groups += [held[len(held) // 2 :], held[: len(held) // 2]]
        return found

    def _take(self, late: Choice) -> None:
        first, *rest = self.choices
        self.choices = (Choice(*(a + b for a, b in zip(_parts(first), _parts(late), strict=True))), *rest)

    def _still(self, space: ParameterSpace) -> None:
        """Forgets what was said of those that were freed since."""
        first, *rest = self.choices
        pairs = [(n, note) for n, note in zip(first.freeze, first.notes, strict=True) if space[n].frozen]
        self.choices = (replace(first, freeze=tuple(n for n, _ in pairs), notes=tuple(n for _, n in pairs)), *rest)


def _held_at_start(
    problem: Problem, found: Fit, held: Sequence[Parameter], robust: float
) -> tuple[list[Parameter], Array | None]:
    """Which of some parameters may stay at their start values, and the values (n,) of all to search from; None where that
    explains the recordings worse. What a score test tells of there was told after all. Corrections of starts stay as they
    are: with them a look is a tenth of a fit.
    """
    solved, need, held, values = found.shot or found.near or problem, proof(problem, found), list(held), found.values
    while True:
        space = found.space.left_open([p.name for p in held])
        values = np.where(space.free, values, space.nominal)
        look = descended(solved, replace(found, space=space), space.to_unit(values), robust)
        values, needed = look.values, missed(solved, look, held, need) if held else []
        if not needed:
            return held, values if look.loss < found.loss + need * len(held) else None
        held = [p for p in held if p not in needed]


def _refining(how: Mapping[str, Any]) -> tuple[Stage, ...]:
    """What refines a fit of a search, which is not told what the search is not."""
    return tuple(s for s in REFINEMENT if s is REFINEMENT[0] or s in how["stages"])


def _with_notes(fit: Fit, before: Fit) -> Fit:
    """The fit with what was said of the one before it, too."""
    return replace(fit, notes=tuple(dict.fromkeys((*before.notes, *fit.notes))))


def _loss(fit: Fit, like: Fit) -> float:
    """The loss of a fit by the measure of another."""
    return float(robust_losses(fit.residual[None], like.bend)[0])


def _parts(choice: Choice) -> tuple[tuple[str, ...], ...]:
    return choice.freeze, choice.notes, choice.vague
