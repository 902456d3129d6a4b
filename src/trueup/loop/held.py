# SPDX-License-Identifier: Apache-2.0
"""How far estimates may be off by what is held at its start value, since no recording tells it.

A rotor that starts at nothing has no slope there, yet as heavy as what it moves it halves what a drive's gains are worth:
slopes at the start value say nothing of that. So each is taken as far as the recordings leave it open, with all else settled
on the way: a profile likelihood (S. A. Murphy and A. W. van der Vaart, J. Am. Stat. Assoc. 95, 2000), followed from size to
size (continuation).
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trueup.arrays import Array, Mask
from trueup.evidence import half_interval
from trueup.loop.descent import Fit
from trueup.loop.limits import SHARES, is_limit
from trueup.loop.problem import WORTH, Problem
from trueup.loop.rivals import Rival
from trueup.loop.uncertainty import FORETOLD, INEXACT
from trueup.parameters import Parameter
from trueup.rounding import ROUNDED
from trueup.search.bounded_step import damped_step, gain
from trueup.search.least_squares import LeastSquares
from trueup.search.robust import robust_losses
from trueup.verdicts import vague

_STEPS = 6
"""At most, with the slopes of the fit, to where all else settles for one size; they follow a factor of two."""
_NEAR = 0.1
"""Share of the loss that chance leaves open: for less no further step is simulated, as it moves ends by a twentieth."""


def held_open(problem: Problem, fit: Fit, untold: Sequence[Parameter], covariance: Array) -> tuple[Rival, ...]:
    """What the frozen parameters `untold` (as declared) might be in truth, and those that are free and yet nowhere by their
    `covariance` (n_free, n_free) in the unit box; and how far that moves each estimate. Nothing for long recordings, as for
    structures (`rivals`). Limits that no recording met are told by where they would be met (`limits.py`).
    """
    if problem.duration > WORTH:
        return ()
    near = fit.near or fit.shot or problem
    if fit.near is None and fit.coarse_step is not None:
        near = near.at_step(fit.coarse_step)  # changes alone are looked at, as of structures
    along = _Along(near, fit, half_interval() ** 2 * near.chance(fit.residual))
    free = (p for p in fit.space.parameters if not p.frozen)
    spreads = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
    loose = [p for p, s in zip(free, spreads, strict=True) if vague(s) and p.absent is None]
    return along.rivals((*(p for p in untold if not is_limit(p)), *loose))


_Walk = Generator[Array, Array, list[Array]]
"""Asks for values (k, n), is told residuals (k, m), and ends with places (n_free,)."""


@dataclass(frozen=True, eq=False)
class _Along:
    """A fit, looked at along what is held in it."""

    problem: Problem
    fit: Fit
    open: float
    """As much more loss as chance leaves open."""

    @cached_property
    def begun(self) -> Array:
        """(m,) residuals of the problem at the fit."""
        return self.problem.residuals(self.fit.values[None])[0]

    @cached_property
    def curvature(self) -> Array:
        """(n_free, n_free) of the loss at the fit."""
        return self.fit.jacobian.T @ (self.fit.jacobian * self.fit.weights[:, None])

    def rivals(self, parameters: Sequence[Parameter]) -> tuple[Rival, ...]:
        """Each parameter, down and up as far as it is open."""
        walks = self._together([self._followed(p.name, end) for p in parameters for end in (p.lower, p.upper)])
        space, found = self.fit.space, list[Rival]()
        for p, down, up in zip(parameters, walks[::2], walks[1::2], strict=True):
            free = np.array([space.from_unit(u)[space.free] for u in (self.fit.unit, *down, *up)])
            found.append(Rival(p.name, p, free[0] - free.min(axis=0), free.max(axis=0) - free[0], held=True))
        return tuple(found)

    def _together(self, walks: Sequence[_Walk]) -> list[list[Array]]:
        """Where each walk ends; what they ask for is simulated at once. As many go side by side as remember no more residuals
        than the fit has slopes.
        """
        ends, going, waiting = dict[int, list[Array]](), dict[int, Array](), list(range(len(walks)))[::-1]
        while waiting or going:
            while waiting and len(going) <= len(self.fit.unit) // (_STEPS + 1):
                self._on(k := waiting.pop(), walks[k], None, going, ends)
            edges = np.cumsum([len(rows) for rows in going.values()])[:-1]
            told = np.split(self.problem.residuals(np.concatenate(list(going.values()))), edges) if going else ()
            for k, own in zip(list(going), told, strict=True):
                self._on(k, walks[k], own, going, ends)
        return [ends[k] for k in range(len(walks))]

    @staticmethod
    def _on(k: int, walk: _Walk, told: Array | None, going: dict[int, Array], ends: dict[int, list[Array]]) -> None:
        """One more round of walk number `k`, which is told residuals, unless it only begins."""
        try:
            going[k] = next(walk) if told is None else walk.send(told)
        except StopIteration as ended:
            going.pop(k, None)
            ends[k] = ended.value

    def _followed(self, name: str, end: float) -> _Walk:
        """Where (n_free,) all else settles on the way to one end, as long as the recordings leave that open; the last place
        lies between two sizes, as losses grow about as squares.
        """
        i, fit, found = self.fit.space.index(name), self.fit, list[Array]()
        here = float(fit.values[i])
        if abs(end - here) <= ROUNDED * max(abs(here), abs(end)):
            return found
        sizes = here + (end - here) * SHARES
        first = 0
        for half in np.array_split(sizes, 2):  # where the smaller ones show, the larger ones need not be simulated
            rows = np.repeat(fit.values[None], len(half), axis=0)
            rows[:, i] = half
            stays = self._more((yield rows) - self.begun) <= self.open
            first += len(half) if stays.all() else int(np.argmin(stays))
            if not stays.all():
                break
        at, last = fit.unit, 0.0
        for size in sizes[first:].tolist():
            more, unit = yield from self._settled(i, size, at)
            if not more <= self.open:
                if np.isfinite(more):
                    found.append(at + np.sqrt((self.open - last) / (more - last)) * (unit - at))
                break
            found.append(unit)
            at, last = unit, max(more, 0.0)
        return found

    def _settled(self, i: int, size: float, at: Array) -> Generator[Array, Array, tuple[float, Array]]:
        """How much more loss there is with value `i` of that size, and where all else settles, from `at` on: the lowest of
        some steps with slopes that each of them corrects.
        """
        fit, seen = self.fit, list[tuple[float, Array]]()
        row, before, moved = fit.values.copy(), None, np.zeros_like(at)
        row[i], own = size, np.flatnonzero(fit.space.free) == i  # it may be free, too
        at, slopes = np.where(own, fit.space.to_unit(row), at), _Slopes(fit, self.curvature, ~own)
        while len(seen) <= _STEPS:
            row[fit.space.free], row[i] = fit.space.from_unit(at)[fit.space.free], size
            residual = fit.residual + (yield row[None].copy())[0] - self.begun
            seen.append((float(self._more((residual - fit.residual)[None])[0]), at))
            lowest = min(more for more, _ in seen)
            if not np.isfinite(residual).all() or lowest <= 0.0 or (lowest <= self.open and seen[-1][0] > lowest):
                break  # open it is, and slopes lead no further
            if before is not None and moved.any():
                slopes.correct(before, moved, residual)
            pull = slopes.pull(residual)
            step = damped_step(slopes.curvature, pull, INEXACT, at)
            after = np.clip(at + np.clip(step, -FORETOLD, FORETOLD), 0.0, 1.0)
            promise = gain(slopes.curvature, pull, after - at)
            if promise < _NEAR * self.open or seen[-1][0] - LeastSquares.hope * promise > self.open:
                break
            before, moved, at = residual, after - at, after
        return min(seen, key=lambda look: look[0])

    def _more(self, moved: Array) -> Array:
        """(k,) by how much the loss rises as residuals change by `moved` (k, m)."""
        losses = robust_losses(np.vstack([np.zeros_like(moved[:1]), moved]) + self.fit.residual, self.fit.bend)
        return np.nan_to_num(losses[1:] - losses[0], nan=np.inf)


class _Slopes:
    """Slopes of a fit in `some` of its free parameters, with what steps showed since: rank-one corrections (C. G. Broyden,
    Math. Comp. 19, 1965), which are kept beside slopes that many look at, and their curvature (n_free, n_free) with them.
    """

    def __init__(self, fit: Fit, curvature: Array, some: Mask) -> None:
        self._fit, self._some, self._shown = fit, some, list[tuple[Array, Array]]()
        self.curvature = curvature * some * some[:, None]

    def pull(self, residual: Array) -> Array:
        """(n_free,) slope of the loss of residuals (m,)."""
        weighted = self._fit.weights * residual
        found = self._some * (self._fit.jacobian.T @ weighted)
        return found + sum((along * (surprise @ weighted) for surprise, along in self._shown), np.zeros_like(found))

    def correct(self, before: Array, moved: Array, after: Array) -> None:
        """With the residuals `before` and `after` (m,) a step (n_free,) was made."""
        surprise = after - before - self._fit.jacobian @ (self._some * moved)
        surprise -= sum((s * (along @ moved) for s, along in self._shown), np.zeros_like(surprise))
        along = moved / (moved @ moved)
        crossed = np.outer(self.pull(surprise), along)
        self.curvature += crossed + crossed.T + (surprise @ (self._fit.weights * surprise)) * np.outer(along, along)
        self._shown.append((surprise, along))
