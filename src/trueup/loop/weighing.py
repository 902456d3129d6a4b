# SPDX-License-Identifier: Apache-2.0
"""Where feet touch and let go: slopes over a stretch in which single touches average out, and steps by these.

A difference by a hair tells of the touches that happen to lie in it, and a search along such slopes ends at any of them. Here
all parameters are moved at once, by the columns of an orthogonal design and its mirror image: each slope is told by all
replays and not by two of them, as things are weighed together (H. Hotelling, Annals of Mathematical Statistics 15(3), 1944;
R. L. Plackett and J. P. Burman, Biometrika 33(4), 1946). They are moved along the axes of what is still open, as far as it is
open: a combination that hardly shows is moved far, and touches weigh the less in its slope (posterior linearization:
A. F. Garcia-Fernandez, L. Svensson, M. R. Morelande and S. Sarkka, IEEE Trans. Signal Processing 63(20), 2015).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.loop.probe import PROBED
from trueup.loop.problem import Problem
from trueup.loop.shoot import Starts
from trueup.loop.shooting import multiple_shooting
from trueup.loop.stages import Run
from trueup.loop.windows import OFF, carried
from trueup.parameters import ParameterSpace
from trueup.search.bounded_step import SHORTENED, damped_step
from trueup.search.robust import robust_losses, robust_weights
from trueup.verdicts import PRIOR

_TOGETHER, _MOST = 3, 18
"""Rounds whose means are compared, and are averaged once they fall no further; and rounds at most."""


@dataclass(frozen=True, eq=False)
class Weighed:
    """Replays around a place in the unit box."""

    unit: Array
    """(n,)"""
    residual: Array
    """(m,) at the place."""
    slopes: Array
    """(m, n)"""
    weights: Array
    """(m,) robust weights."""
    loss: float
    """The mean around it; inf where it, or too much around it, cannot be simulated: then there are no slopes."""

    @classmethod
    def around(
        cls, problem: Problem, space: ParameterSpace, unit: Array, axes: Array, bend: float, rng: np.random.Generator
    ) -> Weighed:
        """From 2 n + 3 replays, along `axes` (n, n): columns in the unit box."""
        steps = design(len(unit), rng) @ axes.T
        more, less = np.clip(unit + steps, 0.0, 1.0), np.clip(unit - steps, 0.0, 1.0)
        seen = problem.residuals(space.from_unit(np.concatenate([unit[None], more, less])))
        up, down = seen[1 : 1 + len(more)], seen[1 + len(more) :]
        good = np.isfinite(up).all(axis=1) & np.isfinite(down).all(axis=1)
        weights = robust_weights(seen[0], bend)
        if np.count_nonzero(good) < len(unit) or not np.isfinite(seen[0]).all():
            return cls(unit, seen[0], np.zeros((seen.shape[1], len(unit))), weights, np.inf)
        # In units of the axes, which differ by orders of magnitude.
        along = np.linalg.solve(axes, (more - less)[good].T).T
        slopes = np.linalg.solve(axes.T, np.linalg.lstsq(along, (up - down)[good], rcond=None)[0]).T
        losses = robust_losses(np.concatenate([up[good], down[good]]), bend)
        return cls(unit, seen[0], np.asarray(slopes, dtype=np.float64), weights, float(np.mean(losses)))

    @property
    def curvature(self) -> Array:
        """(n, n) of the loss, with what is believed of the box beforehand."""
        return curvature_of(self.slopes, self.weights)

    def step(self) -> Array:
        """(n,) where a step of Gauss and Newton leads, within the box."""
        slope = self.slopes.T @ (self.weights * self.residual)
        return np.clip(self.unit + damped_step(self.curvature, slope, 0.0, self.unit), 0.0, 1.0)


def curvature_of(slopes: Array, weights: Array) -> Array:
    """(n, n) from slopes (m, n) and robust weights (m,)."""
    return slopes.T @ (slopes * weights[:, None]) + PRIOR * np.eye(slopes.shape[1])


def axes_of(curvature: Array) -> Array:
    """(n, n) principal axes of what a curvature leaves open, as columns `PROBED` standard deviations long; `OFF` at most."""
    sizes, axes = np.linalg.eigh(curvature)
    return axes * np.minimum(PROBED / np.sqrt(sizes), OFF)


def design(count: int, rng: np.random.Generator) -> Array:
    """(count + 1, count) orthogonal columns of mean square one, in an order of chance: cosines."""
    rows = np.arange(count + 1)[:, None] + 0.5
    return np.sqrt(2.0) * np.cos(np.pi * rows * rng.permutation(np.arange(1, count + 1)) / (count + 1))


@dataclass(frozen=True, eq=False)
class _Place:
    """A place to look around, with starts corrected for it."""

    unit: Array
    """(n,)"""
    problem: Problem
    starts: Starts
    loss: float
    """There; inf where it cannot be simulated."""

    @classmethod
    def at(cls, problem: Problem, starts: Starts, space: ParameterSpace, unit: Array, bend: float) -> _Place:
        """With starts as they are."""
        values = space.from_unit(unit)
        problem = starts.eliminated_from(problem, values)
        loss = float(robust_losses(problem.residuals(values[None]), bend)[0])
        return cls(unit, problem, starts, loss if np.isfinite(loss) else np.inf)

    def moved(self, space: ParameterSpace, unit: Array, bend: float) -> _Place:
        """Another place, with starts corrected for it."""
        starts, _ = self.starts.corrected(self.problem, space.from_unit(unit))
        return _Place.at(self.problem, starts, space, unit, bend)

    def onward(self, weighed: Weighed, space: ParameterSpace, bend: float) -> _Place | None:
        """Where the step of these slopes leads, or half or a quarter of it: where replays are no worse than those around here
        were. None if none of these is: slopes tell no more.
        """
        step = weighed.step() - self.unit
        for share in SHORTENED:
            there = self.moved(space, self.unit + share * step, bend)
            if there.loss <= weighed.loss:
                return there
        return None


def weighing(run: Run) -> None:
    """Goes on from multiple shooting where what contacts carry is replayed in windows: starts and all else in turns.

    Designs differ from round to round, and so do the steps by them: what is kept is the mean of the last places (B. T.
    Polyak and A. B. Juditsky, SIAM J. Control and Optimization 30(4), 1992), and how these differ is part of what is unsure.
    It stays where it began if replays around that place are better; slopes are those over a stretch all the same. A fit that
    was begun by such slopes takes two steps. A step that ends higher than what lies around its beginning is shortened, as the
    linearization does not reach so far (M. Raitoharju, L. Svensson, A. F. Garcia-Fernandez and R. Piche, IEEE Signal
    Processing Letters 25(4), 2018, damp steps of the same kind).
    """
    fit = run.weighed or run.fit
    if fit.starts is None or not run.problem.windowed or not carried(run.problem) or not len(fit.unit):
        return
    space, bend, rng = fit.space, fit.bend, np.random.default_rng(run.seed)
    there = _Place.at(run.problem, fit.starts, space, fit.unit, bend)
    axes, places, found, ended = axes_of(curvature_of(fit.jacobian, fit.weights)), [fit.unit], [], False
    most, worth = (_MOST if run.weighed is None else _TOGETHER - 1), run.problem.chance(fit.residual) * len(fit.unit)
    while True:
        weighed = Weighed.around(there.problem, space, there.unit, axes, bend, rng)
        run.descent.watch.saw("weighed together", there.problem, weighed.loss, there.problem.rmse(weighed.residual))
        if np.isfinite(weighed.loss):
            found.append((weighed, there))
        if ended or not np.isfinite(weighed.loss):
            break
        axes = axes_of(weighed.curvature)
        onward = there.onward(weighed, space, bend)
        if onward is None:
            break
        places.append(onward.unit)
        ended = len(found) == most or _level([one.loss for one, _ in found], worth)
        there = there.moved(space, np.mean(places[-_TOGETHER:], axis=0), bend) if ended else onward
    if not found:
        if run.weighed is not None:  # nothing around where it was to go on can be simulated: the search of before
            run.weighed = None
            multiple_shooting(run)
        return
    weighed, there = min((found[0], found[-1]), key=lambda one: one[0].loss)
    run.problem = there.problem
    run.descent.move(weighed.unit)
    run.ended = replace(
        fit, unit=weighed.unit, residual=weighed.residual, jacobian=weighed.slopes, weights=weighed.weights,
        loss=float(robust_losses(weighed.residual[None], bend)[0]), near=None, starts=there.starts, shot=run.problem,
        weighed=True,
    )  # fmt: skip
    if run.weighed is None:
        apart = np.array(places[-_TOGETHER:]) - weighed.unit
        scatter = apart.T @ apart / len(apart)
        run.ended.scatter = scatter if fit.scatter is None else scatter + fit.scatter


def _level(losses: Sequence[float], worth: float) -> bool:
    """Whether the last rounds are no lower than those before, but for what chance is `worth`."""
    if len(losses) % _TOGETHER or len(losses) < 2 * _TOGETHER:
        return False
    return float(np.mean(losses[-_TOGETHER:])) > float(np.mean(losses[-2 * _TOGETHER : -_TOGETHER])) - worth
