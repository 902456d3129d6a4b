# SPDX-License-Identifier: Apache-2.0
"""Structures that enter from the fit without them, one by one, where what was left out is foretold clearly better with them.

Begun with, they may bend the whole fit and lead it astray (forward selection: M. A. Efroymson, 1960). A limit has no slope
where it is not met, and a punch none where friction has taken its place: where a structure enters is scanned, with all
other parameters settled around each place as slopes foretell it (variable projection: G. Golub, V. Pereyra, SIAM J. Numer.
Anal. 10, 1973).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.evidence import Evidence, evidence, explained
from trueup.loop.apart import Part, parts_of
from trueup.loop.descent import Descent, Fit, Look
from trueup.loop.selection import compared, elsewhere, verdict
from trueup.loop.validate import foretold, settled_loss
from trueup.loop.watch import Watch
from trueup.parameters import Parameter, ParameterSpace
from trueup.search.robust import robust_losses

Settle = Callable[[Descent], None]
"""Where slopes lead from a descent's point."""

_PLACES = np.linspace(0.04, 0.96, 16)
"""Shares of the range in which a structure is looked for."""
_AROUND = np.linspace(-0.04, 0.04, 25)
"""The same around where it was found."""


def grown(
    descent: Descent,
    look: Look,
    later: Mapping[str, Mapping[str, Parameter]],
    settle: Settle,
    early: Sequence[Array],
    alone: bool = False,
) -> tuple[Descent, list[str]]:
    """A search that has settled on `look`, with those of the structures `later` that the evidence speaks for, and what came
    of each in words.

    `early`: values (n,) that an earlier look at less of the recordings led to, and those before any, from which a structure
    may enter too: what all of them ask of a model without it may have led it far away. `alone`: signals of the look feel
    their own parameters and nothing of the others.
    """
    notes = []
    without = descent.finished(look)
    errors = foretold(look.problem, without)
    for structure, declared in later.items():
        note = f"{structure} left out: nowhere are the recordings replayed better with it"
        # What is replayed to about its noise without it was not led away for want of it.
        begun = () if explained(without.residual) else early
        for entered in _entered(descent, look, without, declared, begun, alone):
            settle(entered)
            with_it = entered.finished(look)
            lower = foretold(look.problem, with_it)
            shown = _compared(errors, lower)
            if shown.holds:  # and not because the search has gone on, which may have led lower by itself
                if not alone:  # alone, the first scan is each joint's own
                    with_it = _closer(entered, look, declared, settle)
                    lower = foretold(look.problem, with_it)
                again = _taken_out(descent, with_it, declared)
                settle(again)
                left = again.finished(look)
                if left.loss < without.loss:
                    descent, without, errors = replace(again, watch=descent.watch), left, foretold(look.problem, left)
                    shown = _compared(errors, lower)
            note = verdict(structure, shown)
            refuted = elsewhere(look.problem, without, with_it) if shown.holds else ""
            if refuted:
                note = f"{structure} left out: {refuted}"
            elif shown.holds:
                entered.watch, descent, without, errors = descent.watch, entered, with_it, lower
                break
        notes.append(note)
    return descent, notes


def still_needed(descent: Descent, look: Look, structure: str, names: Sequence[str]) -> tuple[Descent, str]:
    """A search that has settled on `look` with the parameters `names` of a structure, or the one without them where the
    evidence does not hold there, and what came of it in words. That one is searched from there, and from the fit of before
    it entered.
    """
    with_it = descent.finished(look)
    space = descent.space.without(names)
    kept = [p.name not in names for p in descent.space.parameters if not p.frozen]
    tried = []
    for point in (with_it.unit[kept], np.clip(space.to_unit(descent.watch.bare), 0.0, 1.0)):
        without = replace(descent, space=space, watch=Watch(), search=None)
        without.restart(point)
        without.descend(look)
        tried.append((without, without.finished(look)))
    without, left = min(tried, key=lambda t: t[1].loss)
    shown = _compared(foretold(look.problem, left), foretold(look.problem, with_it))
    if shown.holds and with_it.loss < left.loss:
        return descent, verdict(structure, shown)
    note = (
        f"{structure} left out: without it the recordings are replayed better"
        if shown.holds
        else verdict(structure, shown)
    )
    return replace(without, watch=descent.watch), note


def _closer(descent: Descent, look: Look, declared: Mapping[str, Parameter], settle: Settle) -> Fit:
    """Where a search ends once its structure was scanned again, between the places of the first scan: drives with limits
    switch from speeding up to slowing down, and the loss has cracks at which slopes end.
    """
    found = descent.finished(look)
    while True:
        entering = np.array([p.name in declared for p in found.space.parameters if not p.frozen])
        places = np.repeat(found.unit[None], len(_AROUND), axis=0)
        places[:, entering] = np.clip(places[:, entering] + _AROUND[:, None], 0.0, 1.0)
        residuals = look.cheap.residuals(found.space.from_unit(places))
        losses = [settled_loss(found, np.flatnonzero(~entering), residual) for residual in residuals]
        if not min(losses) < losses[len(losses) // 2] - look.problem.chance(found.residual):
            return found
        descent.restart(places[int(np.argmin(losses))])
        settle(descent)
        before, found = found, descent.finished(look)
        if not found.loss < before.loss:
            descent.restart(before.unit)
            descent.stay(look)
            return before


def _places(count: int) -> Array:
    """(P, count or 1) shares of the ranges in which a structure of so many parameters is looked for: each of two beside all
    of the other, more of them together.
    """
    if count == 2:
        return np.stack(np.meshgrid(_PLACES[::2], _PLACES[::2]), axis=-1).reshape(-1, 2)
    return _PLACES[:, None]


def _parts(look: Look, space: ParameterSpace, point: Array, alone: bool) -> list[Part]:
    """Signals with parameters of their own, if they are `alone`; else all as one."""
    if alone:
        return parts_of(look.cheap, space, [point])
    return [Part(np.arange(look.problem.segments[-1].columns.stop), np.arange(len(point)))]


def _compared(without: Array, with_it: Array) -> Evidence:
    """The evidence of stretches (cells,): those in which nothing happens say little, so they count by their squares."""
    if not np.isfinite(without + with_it).all():
        return compared(without, with_it)
    return evidence(without, with_it, 0.5 * (without**2 + with_it**2))


def _taken_out(descent: Descent, with_it: Fit, declared: Mapping[str, Parameter]) -> Descent:
    """The search without a structure, from where it has led with it."""
    free = [p.name for p in with_it.space.parameters if not p.frozen]
    again = replace(descent, watch=Watch(), search=None)
    again.restart(with_it.unit[[name not in declared for name in free]])
    return again


def _entered(
    descent: Descent, look: Look, without: Fit, declared: Mapping[str, Parameter], early: Sequence[Array], alone: bool
) -> list[Descent]:
    """The same search with a structure where scans find it best, signal by signal where signals have parameters of their
    own: from the fit without it and from the first `early` values; where neither gains, from the next. Signals that gain
    nothing stay without; [] where none gains.
    """
    space = ParameterSpace(tuple(declared.get(p.name, p) for p in descent.space.parameters))
    free = [p.name for p in space.parameters if not p.frozen]
    entering = np.array([name in declared for name in free])
    point = np.full(len(free), 0.5)
    point[~entering] = without.unit
    parts = _parts(look, space, point, alone)
    offset = np.zeros(len(without.residual))
    if look.cheap.simulator is not look.problem.simulator:
        offset = without.residual - look.cheap.residuals(without.values[None])[0]
    old = np.cumsum(~entering) - 1  # places of the other parameters among those of the fit without it

    def near(part: Part, residual: Array) -> float:
        return settled_loss(
            without, old[part.columns[~entering[part.columns]]], residual[part.residuals], part.residuals
        )

    def far(part: Part, residual: Array) -> float:
        return float(np.nan_to_num(robust_losses(residual[None, part.residuals], without.bend)[0], nan=np.inf))

    begun = [np.clip(space.to_unit(values), 0.0, 1.0) for values in early]
    bases = ((point, near), *((np.where(entering, point, unit), far) for unit in begun))
    places, worth, found = _places(1 if alone else int(entering.sum())), look.problem.chance(without.residual), []
    for k, (base, loss) in enumerate(bases):
        if found and (alone or k > 1):
            break  # alone, signals settle by themselves: one way in is enough
        rows = np.repeat(base[None], len(places), axis=0)
        rows[:, entering] = places
        values = np.concatenate([space.without(declared).from_unit(base[None, ~entering]), space.from_unit(rows)])
        absent, *seen = look.cheap.residuals(values) + offset
        place, gained = np.array(base), np.zeros(len(free), dtype=bool)
        for part in parts:
            own, losses = part.columns[entering[part.columns]], [loss(part, residual) for residual in seen]
            if len(own) and min(losses) < loss(part, absent) - worth * len(own):
                place[own], gained[own] = rows[int(np.argmin(losses)), own], True
        if gained.any():
            found.append(_thawed(descent, space, declared, place, {n for n, g in zip(free, gained, strict=True) if g}))
    return found


def _thawed(
    descent: Descent, space: ParameterSpace, declared: Mapping[str, Parameter], place: Array, gained: set[str]
) -> Descent:
    """A search that begins at a place (n_free,) of a space, without those of a structure's parameters that gained nothing."""
    values = dict(zip(space.names, space.from_unit(place), strict=True))
    thawed = {n: replace(p, nominal=values[n], optional="") for n, p in declared.items()}  # it is no longer asked about
    whole = ParameterSpace(tuple(thawed.get(p.name, p) for p in space.parameters))
    free = [p.name for p in space.parameters if not p.frozen]
    entered = replace(descent, space=whole.without(set(declared) - gained), watch=Watch(), search=None)
    entered.restart(place[[name in gained or name not in declared for name in free]])
    return entered
