# SPDX-License-Identifier: Apache-2.0
"""How far estimates may be off by what is held at its start value, since no recording tells it.

A rotor that starts at nothing has no slope there, yet as heavy as what it moves it halves what a drive's gains are worth:
slopes at the start value say nothing of that. So each is taken as far as the recordings leave it open, with all else settled
on the way: a profile likelihood (S. A. Murphy and A. W. van der Vaart, J. Am. Stat. Assoc. 95, 2000), followed from size to
size (continuation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trueup.arrays import Array
from trueup.calibration import NORMAL_95
from trueup.loop.descent import Fit
from trueup.loop.problem import WORTH, Problem
from trueup.loop.rivals import Rival
from trueup.loop.uncertainty import FORETOLD, INEXACT
from trueup.parameters import Parameter
from trueup.rounding import ROUNDED
from trueup.search.bounded_step import corrected, damped_step
from trueup.search.robust import robust_losses
from trueup.verdicts import vague

_HALVINGS = 8
"""Sizes between the start value and an end of the range: below a hundredth of the way slopes hold."""
_STEPS = 6
"""With the slopes of the fit, to where all else settles for one size; they follow a factor of two."""


def held_open(problem: Problem, fit: Fit, untold: Sequence[Parameter], covariance: Array) -> tuple[Rival, ...]:
    """What the frozen parameters `untold` (as declared) might be in truth, and those that are free and yet nowhere by their
    `covariance` (n_free, n_free) in the unit box; and how far that moves each estimate. Nothing for long recordings, as for
    structures (`rivals`).
    """
    if problem.duration > WORTH:
        return ()
    near = fit.near or fit.shot or problem
    along = _Along(near, fit, NORMAL_95**2 * near.chance(fit.residual))
    free = (p for p in fit.space.parameters if not p.frozen)
    spreads = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
    loose = [p for p, s in zip(free, spreads, strict=True) if vague(s) and p.absent is None]
    return tuple(along.rival(p) for p in (*untold, *loose))


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

    def rival(self, p: Parameter) -> Rival:
        """One parameter, down and up as far as it is open."""
        space, ends = self.fit.space, [self.fit.unit]
        for end in (p.lower, p.upper):
            ends += self._followed(p.name, end)
        free = np.array([space.from_unit(u)[space.free] for u in ends])
        return Rival(p.name, p, free[0] - free.min(axis=0), free.max(axis=0) - free[0], held=True)

    def _followed(self, name: str, end: float) -> list[Array]:
        """Where (n_free,) all else settles on the way to one end, as long as the recordings leave that open; the last place
        lies between two sizes, as losses grow about as squares.
        """
        i, fit, found = self.fit.space.index(name), self.fit, list[Array]()
        here = float(fit.values[i])
        if abs(end - here) <= ROUNDED * max(abs(here), abs(end)):
            return found
        sizes = here + (end - here) * 2.0 ** -np.arange(_HALVINGS)[::-1]
        first = 0
        for half in np.array_split(sizes, 2):  # where the smaller ones show, the larger ones need not be simulated
            rows = np.repeat(fit.values[None], len(half), axis=0)
            rows[:, i] = half
            stays = self._more(self.problem.residuals(rows) - self.begun) <= self.open
            first += len(half) if stays.all() else int(np.argmin(stays))
            if not stays.all():
                break
        at, last = fit.unit, 0.0
        for size in sizes[first:].tolist():
            more, unit = self._settled(i, size, at)
            if not more <= self.open:
                if np.isfinite(more):
                    found.append(at + np.sqrt((self.open - last) / (more - last)) * (unit - at))
                break
            found.append(unit)
            at, last = unit, max(more, 0.0)
        return found

    def _settled(self, i: int, size: float, at: Array) -> tuple[float, Array]:
        """How much more loss there is with value `i` of that size, and where all else settles, from `at` on: the lowest of
        some steps with slopes that each of them corrects (Broyden).
        """
        fit, seen = self.fit, list[tuple[float, Array]]()
        row, before, moved = fit.values.copy(), None, np.zeros_like(at)
        row[i], own = size, np.flatnonzero(fit.space.free) == i  # it may be free, too
        at, slopes = np.where(own, fit.space.to_unit(row), at), np.where(own, 0.0, fit.jacobian)
        while len(seen) <= _STEPS:
            row[fit.space.free], row[i] = fit.space.from_unit(at)[fit.space.free], size
            residual = fit.residual + self.problem.residuals(row[None])[0] - self.begun
            seen.append((float(self._more((residual - fit.residual)[None])[0]), at))
            if not np.isfinite(residual).all() or seen[-1][0] <= 0.0:
                break
            if before is not None and moved.any():
                slopes = corrected(slopes, before, moved, residual)
            weighted = slopes * fit.weights[:, None]
            step = damped_step(slopes.T @ weighted, weighted.T @ residual, INEXACT, at)
            after = np.clip(at + np.clip(step, -FORETOLD, FORETOLD), 0.0, 1.0)
            before, moved, at = residual, after - at, after
        return min(seen, key=lambda look: look[0])

    def _more(self, moved: Array) -> Array:
        """(k,) by how much the loss rises as residuals change by `moved` (k, m)."""
        losses = robust_losses(np.vstack([np.zeros_like(moved[:1]), moved]) + self.fit.residual, self.fit.bend)
        return np.nan_to_num(losses[1:] - losses[0], nan=np.inf)
