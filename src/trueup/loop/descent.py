# SPDX-License-Identifier: Apache-2.0
"""Least squares through looks, from a first look at the recordings to all of them at the full step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.errors import CalibrationError
from trueup.evidence import explained
from trueup.loop.disturbed import LeftOut
from trueup.loop.problem import Problem
from trueup.loop.shoot import Starts
from trueup.loop.watch import Watch
from trueup.parameters import ParameterSpace
from trueup.rounding import NEGLIGIBLE
from trueup.search.bounded_step import careful_difference
from trueup.search.least_squares import LeastSquares
from trueup.search.robust import robust_losses, robust_weights

HELD = 3e-3  # least damping of the first looks: what is weakly seen must not wander off before all data are in
SETTLED = 5e-3  # share of the loss: what gains less is worth no new approximation, step or place


@dataclass
class Fit:
    """Where a search ended, with the slopes there."""

    space: ParameterSpace
    unit: Array
    """(n_free,) in the unit box."""
    residual: Array
    """(m,) at the optimum, full step."""
    jacobian: Array
    """(m, n_free) d residual / d unit."""
    weights: Array
    """(m,) robust weights."""
    ended: str
    loss: float = 0.0
    bend: float = np.inf
    """Residuals far beyond it count as outliers."""
    scatter: Array | None = None
    """(n_free, n_free) uncertainty that residuals do not show: mean square by which the place changes that slopes point
    to, from one side of the optimum to the other (see `probe.py`), and with other noise at the starts (`starts.py`)."""
    near: Problem | None = None  # a cheaper problem at the level of the real one, if the fit was made with one
    coarse_step: float | None = None  # s, that simulates nearly the same: changes may be looked at with it
    starts: Starts | None = None  # corrections of the measured starts, if those matter
    shot: Problem | None = None  # the problem with these, which was solved
    weighed: bool = False  # whether slopes are those over a stretch (see `weighing.py`)
    disturbed: LeftOut = field(default_factory=LeftOut)  # why the search ended early: to be begun without this
    notes: tuple[str, ...] = ()  # what was decided on the way, in words

    @property
    def values(self) -> Array:
        """(n,) all values, frozen ones included."""
        return self.space.from_unit(self.unit)


Select = Callable[[Problem, Fit], ParameterSpace]
"""From the problem that was solved and where, the space with what is not worth fitting frozen."""


@dataclass(frozen=True)
class Look:
    """One look at the recordings. A first look may end early, the last must not."""

    name: str
    problem: Problem
    cheap: Problem
    """Where slopes are taken: often the same at a coarser step."""
    tolerance: float
    """In units of what chance alone gives."""
    most: int
    """Iterations."""
    real: Problem | None = None  # the same recordings at the real step, where the problem has a coarser one
    last: bool = False
    """Whether everything is looked at, so that what is weakly seen may move."""

    def columns(self, space: ParameterSpace, candidates: Array) -> Array:
        """Residuals at the point and around it: differences from the cheaper problem, the level from the real one."""
        residuals = self.cheap.residuals(space.from_unit(candidates))
        if not np.isfinite(residuals[0]).all():
            # A coarser step may fail where the real one does not.
            return self.problem.residuals(space.from_unit(candidates))
        if self.cheap.simulator is not self.problem.simulator:
            residuals += self.problem.residuals(space.from_unit(candidates[:1]))[0] - residuals[0]
        return residuals


def last_look(problem: Problem, cheap: Problem) -> Look:
    """At everything, to the end."""
    return Look("all, full step", problem, cheap, 0.05, 20, last=True)


@dataclass
class Descent:
    """Goes through the looks with least squares; what one has learned starts the next."""

    space: ParameterSpace
    point: Array
    watch: Watch
    robust: float
    search: LeastSquares | None = None
    solver: Callable[..., LeastSquares] = LeastSquares
    near: Problem | None = None
    """What the last look solved: cheaper than its problem, at the level of it."""
    _slopes: Array | None = None
    """(m, n_free) already taken at the point for the next look."""

    def descend(
        self, look: Look, nudge: float = 0.0, saved: dict[str, Any] | None = None, *, confirm: bool = True,
        impatient: bool = False, wanted: float = np.inf,
    ) -> LeastSquares:  # fmt: skip
        """Least squares on one look, to its end; the last one takes slopes there, to `confirm`. It ends early where slopes
        promise no loss below what is `wanted`.
        """
        slopes = self._at_hand(look)
        search, self.near, self._slopes = self._begun(look, nudge, confirm), None, None
        search.impatient, search.wanted = impatient, wanted
        if saved is not None:
            search.resume(saved)
        elif slopes is not None:
            search.adopt(slopes, self._residual(look.problem))
        while not search.done:
            candidates = search.ask()
            if search.jacobian is None:
                search.tell(candidates, look.columns(self.space, candidates))
            else:
                search.tell(candidates, look.problem.residuals(self.space.from_unit(candidates)))
            if search.jacobian is not None and search.residual is not None:
                self.watch.saw(look.name, look.problem, search.loss, look.problem.rmse(search.residual))
            else:
                self.watch.save(look.name, self.space, search.state())
        self.search, self.point = search, search.point
        return search

    def stay(self, look: Look) -> None:
        """Takes the point for where the search on a look has ended."""
        self.search, self.near, self._slopes = self._begun(look, 0.0, True), None, None

    def restart(self, point: Array) -> None:
        """Forgets all that was learned, and goes on from `point` (n_free,)."""
        self.point, self.search, self.near, self._slopes = point, None, None, None

    def move(self, point: Array) -> None:
        """Goes on from another `point` (n_free,), where slopes that were taken for the next look do not hold."""
        self.point, self._slopes = point, None

    def polish(self, look: Look, again: bool = False) -> LeastSquares:
        """The last look where slopes come from a cheaper problem. The cheaper one is solved at the level of the real one,
        which is looked at again where that ends: one simulation of it each time round. `again`: stays unless that is lower.
        """
        rounds = 3  # approximations at most; then the real problem is searched, unless no such model explains the robot
        begun, fine = self.point, self._residual(look.problem)
        for left in reversed(range(rounds)):
            confirm = left == rounds - 1 and not again
            near = look.cheap.at_level(self.space.from_unit(self.point), fine)
            if near is None:
                return self.descend(replace(look, cheap=look.problem))
            search = self.descend(replace(look, problem=near, cheap=near), confirm=confirm, impatient=True)
            before, fine = fine, self._residual(look.problem)
            old, new = robust_losses(np.stack([before, fine]), search.delta)
            if not new < old and confirm:
                break
            if not new < old:
                search.point, search.residual, search.loss = begun, before, float(old)
                self.point, self._slopes = begun, None
                return search
            search.residual, search.loss, self._slopes = fine, float(new), search.jacobian
            self.near = look.cheap.at_level(self.space.from_unit(self.point), fine)
            if search.stuck and explained(fine):
                # A crack in the cheaper problem need not be one in the real one: its slopes lead on there.
                return self.descend(look)
            if old - new < SETTLED * old or (left == 0 and not explained(fine)):
                self._slopes = None
                return search
            begun = self.point
        self.point, self._slopes = begun, None
        return self.descend(look)

    def led(self, look: Look) -> LeastSquares | None:
        """Where slopes lead from here at the real step; stays here. None where that fails, or is what was looked at."""
        if look.real is None:
            return None
        real = replace(last_look(look.real, look.problem), name=look.name)
        if not np.isfinite(self._residual(real.problem)).all():
            return None  # where the coarser step led, the real one fails
        return replace(self, watch=Watch()).polish(real)

    def take_up(self, slopes: Array) -> None:
        """Begins the next look with `slopes` (m, n_free) of its residuals here, known from elsewhere."""
        self._slopes = slopes

    def _at_hand(self, look: Look) -> Array | None:
        """(m, n_free) slopes to begin a look with: those taken for it, or those of the last look if it ended here."""
        last, size = self.search, look.problem.segments[-1].columns.stop
        if self._slopes is not None or last is None or last.jacobian is None or len(last.jacobian) != size:
            return self._slopes
        return last.jacobian if np.array_equal(last.point, self.point) else None

    def _residual(self, problem: Problem) -> Array:
        return problem.residuals(self.space.from_unit(self.point[None]))[0]

    def _begun(self, look: Look, nudge: float, confirm: bool) -> LeastSquares:
        free = [p for p in self.space.parameters if not p.frozen]
        ranges = np.array([p.log_range for p in free])
        last = look.last
        return self.solver(
            self.point, ranges, least_damping=1e-9 if last else HELD, share=2e-2 if last else 3e-2, robust=self.robust,
            tolerance=look.tolerance, max_iterations=look.most, nudge=nudge, confirm=confirm and last,
            difference=careful_difference(None if self.search is None else self.search.residual, LeastSquares.difference),
            worth=lambda residual: look.problem.chance(residual) * len(free) * _patience(residual),
        )  # fmt: skip

    def choose(self, look: Look, select: Select) -> bool:
        """Asks which parameters to keep; True if some were frozen."""
        found = self.finished(look, again=True)
        space = select(look.problem, found)
        kept = [not p.frozen for p in space.parameters if not self.space[p.name].frozen]
        values = np.where(space.free, found.values, space.nominal)
        self.space, self.point = space, np.clip(space.to_unit(values), 0.0, 1.0)
        self._slopes = found.jacobian[:, kept]
        return not all(kept)

    def finished(self, look: Look, again: bool = False) -> Fit:
        """Where the search ended. Slopes are taken if it has none, or `again` where they are not of this very place."""
        search = self.search
        if search is None:
            raise CalibrationError("nothing was searched")
        if search.jacobian is None or (again and not search.fresh):
            search.jacobian = None
            candidates = search.ask()
            search.tell(candidates, look.columns(self.space, candidates))
        if search.jacobian is None or search.residual is None:
            raise CalibrationError("the search ended without slopes")
        point, last = search.point, (search.weights(), search.done, search.loss, search.delta)
        return Fit(self.space, point, search.residual, search.jacobian, *last, near=self.near)


def descended(problem: Problem, fit: Fit, start: Array, robust: float) -> Fit:
    """Where slopes lead from `start` (n_free,), judged by the same measure as `fit`: its loss may be higher."""
    run, look = Descent(fit.space, np.clip(start, 0.0, 1.0), Watch(), robust), last_look(problem, problem)
    run.descend(look)
    found = run.finished(look)
    loss = float(robust_losses(found.residual[None], fit.bend)[0])
    return replace(found, bend=fit.bend, loss=loss, weights=robust_weights(found.residual, fit.bend), near=None)


def _patience(residual: Array) -> float:
    """1 where the residuals are noise; up to 20 where no model of this kind gets near it, and the last percent of the
    replay error is not worth minutes of simulation.
    """
    misfit = max(0.0, 1.0 - 1.0 / (square := max(float(np.mean(residual**2)), NEGLIGIBLE)))
    return 1.0 + 4.0 * misfit**4 * float(np.clip(0.1 * np.sqrt(square), 1.0, 5.0))
