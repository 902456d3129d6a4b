# SPDX-License-Identifier: Apache-2.0
"""Intervals of limits, by the loss along them: slopes say nothing of a limit that is hardly met, and too much at one that is.

A limit that a drive runs into has an end on both sides; of one that it does not, or hardly, the recordings tell how low it
would have to be to be seen, and nothing above (profile likelihood: S. A. Murphy, A. W. van der Vaart, JASA 95, 2000).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.evidence import half_interval
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.loop.validate import settled_loss
from trueup.parameters import Parameter, ParameterSpace

SHARES = 2.0 ** -np.arange(8)[::-1]
"""Of the box, or of the way to one of its ends, at which losses are looked at: below a hundredth slopes hold."""


@dataclass(frozen=True)
class Seen:
    """Between which values a limit may be, in its unit, and how that is put in words."""

    low: float
    high: float
    word: str
    note: str


def is_limit(p: Parameter) -> bool:
    """Whether more of it than some size is as if there were none."""
    return p.absent is not None and p.absent >= p.upper


def limits_seen(problem: Problem, fit: Fit, names: Sequence[str] | None = None) -> Mapping[str, Seen]:
    """What is seen of each free limit, or of some by `names`, all other parameters settled around each place as slopes
    foretell it; by name.
    """
    solved = fit.shot or problem
    # An approximation at the level of the engine, which would take minutes.
    problem = fit.near or solved.at_level(fit.values, fit.residual) or solved
    free = [p for p in fit.space.parameters if not p.frozen]
    limits = [k for k, p in enumerate(free) if is_limit(p) and (names is None or p.name in names)]
    if not limits:
        return {}
    here, worth = problem.residuals(fit.values[None])[0], half_interval() ** 2 * problem.chance(fit.residual)
    level = {k: _without(k, fit, here) for k in limits}
    sides = [_Side(k, side, fit.unit[k]) for k in limits for side in (-1, 1)]
    while asked := [s for s in sides if s.asks is not None]:
        rows = np.repeat(fit.unit[None], len(asked), axis=0)
        for row, side in zip(rows, asked, strict=True):
            row[side.parameter] = side.places[side.asks or 0]
        for side, residual in zip(asked, problem.residuals(fit.space.from_unit(rows)), strict=True):
            side.tell(_without(side.parameter, fit, residual) - level[side.parameter], worth)
    found = {}
    for below, above in zip(sides[::2], sides[1::2], strict=True):
        k, ends = below.parameter, [below.end(worth), above.end(worth)]
        p, rows = free[k], np.repeat(fit.unit[None], 2, axis=0)
        rows[:, k] = ends[0] or 0.0, 1.0 if ends[1] is None else ends[1]
        low, high = fit.space.from_unit(rows)[:, fit.space.index(p.name)].tolist()
        found[p.name] = _in_words(p, max(low, p.lower), min(high, p.upper), ends)
    return found


def limits_untold(problem: Problem, fit: Fit, untold: Sequence[Parameter]) -> Mapping[str, Seen]:
    """What is seen of limits that a fit holds since recordings do not tell them, by name: each freed beside what was fitted.

    Nobody knows such a limit, but mostly how low it would have to be to be met.
    """
    found = {}
    for p in untold:
        if not is_limit(p):
            continue
        freed = p.replace(frozen=False, nominal=min(fit.space[p.name].nominal, p.upper))  # absent, it lies beyond
        space = ParameterSpace(tuple(freed if o.name == p.name else o for o in fit.space.parameters))
        place = [o.name for o in space.parameters if not o.frozen].index(p.name)
        slopes = np.insert(fit.jacobian, place, 0.0, axis=1)
        wide = replace(fit, space=space, unit=np.clip(space.to_unit(fit.values), 0.0, 1.0), jacobian=slopes)
        found[p.name] = limits_seen(problem, wide, [p.name])[p.name]
    return found


def _without(parameter: int, fit: Fit, residual: Array) -> float:
    """The loss of residuals (m,) once all other parameters than one have settled."""
    others = np.delete(np.arange(len(fit.unit)), parameter)
    return settled_loss(fit, others, residual)


class _Side:
    """One side of a limit, along which the loss only rises: where it has risen enough is found by bisection."""

    def __init__(self, parameter: int, side: int, at: float) -> None:
        self.parameter = parameter
        self.places = np.unique(np.clip(at + side * np.array([0.0, *SHARES]), 0.0, 1.0))[::side]
        self._rises = np.zeros(len(self.places))
        self._below, self._beyond = 0, len(self.places)
        self.asks = len(self.places) - 1 if len(self.places) > 1 else None
        """Number of the place whose loss is wanted next."""

    def tell(self, rise: float, worth: float) -> None:
        """By how much the loss is higher at the place that was asked about."""
        place = self.asks or 0
        self._rises[place] = rise
        if rise <= worth:
            self._below = place
        else:
            self._beyond = place
        apart = self._beyond - self._below > 1 and self._beyond < len(self.places)
        self.asks = (self._below + self._beyond) // 2 if apart else None

    def end(self, worth: float) -> float | None:
        """Where the loss has risen by `worth`; None where it never does."""
        first = self._beyond
        if first == len(self.places):
            return None
        near, far = self.places[first - 1], self.places[first]
        if not np.isfinite(self._rises[first]):
            return float(far)
        before = max(self._rises[first - 1], 0.0)
        share = (worth - before) / (self._rises[first] - before)
        # Beside the optimum the loss is a parabola, further on nearly a line between the places.
        return float(near + (np.sqrt(share) if first == 1 else share) * (far - near))


def _in_words(p: Parameter, low: float, high: float, ends: list[float | None]) -> Seen:
    advice = f"; {p.shown_by} would show it" if p.shown_by else ""
    if ends == [None, None]:
        return Seen(low, high, "no effect", f"never met in these recordings{advice}")
    if ends[1] is None:
        return Seen(low, high, "weak", f"hardly met in these recordings: {low:.3g} {p.unit} or more{advice}")
    if ends[0] is None:
        return Seen(low, high, "weak", f"no more than {high:.3g} {p.unit}; how much less is not seen")
    return Seen(low, high, "identified", "")
