# SPDX-License-Identifier: Apache-2.0
"""A quantity that nobody asked for, or that stays open, and what estimates owe to it, from the simulator's own slopes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Estimate
from trueup.evidence import EXCERPT
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.parameters import Parameter
from trueup.rounding import ROUNDED, TINY
from trueup.verdicts import PRIOR

_APART = math.cbrt(ROUNDED)
"""Share of its value or range by which a quantity is moved to both sides: where what rounding leaves of the difference, and
what it bends, are as small together as can be (W. Press et al., Numerical Recipes, 2007, 5.7)."""
STEP = "step of the simulation"


@dataclass(frozen=True)
class Considered:
    """A quantity that was not asked for, and what the estimates owe to it."""

    parameter: Parameter
    trade: Array
    """(n_free,) by how much each estimate changes for one unit more of it, in their units."""
    low: float
    high: float
    """Between which ends it may be, in its unit: its bounds, or nearer where the recordings tell, which then hold both the
    value that the model has and the one that replays best (a score test's step: C. R. Rao, 1948)."""
    left: Array
    """(m,) what the estimates do not make up for of a unit of it, in residuals of variance one."""
    pull: float
    """By how much the negative logarithm of the likelihood grows for that unit."""
    calibrated: bool = False
    """Whether it was asked for, and stays open all the same."""

    def reach(self, trade: float) -> tuple[float, float]:
        """How far down and up an estimate with that trade may be moved by it; both are positive."""
        ends = trade * (self.low - self.parameter.nominal), trade * (self.high - self.parameter.nominal)
        return max(-min(ends), 0.0), max(*ends, 0.0)

    @property
    def verdict(self) -> str:
        """What an estimate is where this rules its interval."""
        return "effective" if self.parameter.name == STEP else "tied"

    def words(self, e: Estimate, trade: float) -> str:
        """What is seen of an estimate, as far as its own interval tells, and where the rest is."""
        p, size = self.parameter, abs(trade)
        if p.name == STEP and self.high > p.nominal:
            return (
                f"known to {1e3 * p.nominal:.3g} ms only, a step of the simulation: what a jump does, it does there wherever "
                "in a step it comes; a finer --step tells more"
            )
        if p.name == STEP:
            return (
                f"replays best at the model's step of {1e3 * p.nominal:.3g} ms; with ever finer ones it would be about "
                f"{e.value - trade * p.nominal:.4g} {e.unit}".rstrip()
            )
        value, low, high = (x - trade * p.nominal for x in (e.value, e.low, e.high))
        held = f"{p.name} {'is' if self.calibrated else 'stays at'} {p.nominal:.4g}"
        held += "" if self.calibrated else ", as the model has it"
        if not e.lower_bound <= value <= e.upper_bound:  # what trades against others in turn, as all that scales
            return f"seen with {p.name} only: {trade:+.3g} {e.unit or '1'} for each {p.unit or '1'} of it; {held}"
        other = p.name if f"{size:.2g}" == "1" else f"{size:.3g} x {p.name}"
        sign = "+" if trade < 0.0 else "-"
        return (
            f"only {e.name} {sign} {other} is seen: {value:.4g} [{low:.4g}, {high:.4g}] {e.unit}".rstrip() + f"; {held}"
        )


@dataclass(frozen=True, eq=False)
class Slopes:
    """Residuals, and their slopes."""

    boxed: Array
    """(2, n_free + m, residuals) for a unit of the box of each free parameter, and one unit of others; their doubts."""
    residual: Array
    weights: Array
    units: Array
    """(n_free,) units of a parameter in one of its box."""

    def owed(
        self, slope: Array, others: Sequence[int], settled: Sequence[int], share: float = 1.0
    ) -> tuple[Array, Array, float]:
        """(n_free,) by how much the `settled` estimates change for one unit of what has that slope, in their units, where
        the `others` make up for it; and what is left of it and its pull (see `Considered`), of a `share` of all residuals.
        """
        trade, left, information = _traded(self.boxed[:, others], slope, self.weights)
        whole = np.zeros(len(self.units))
        whole[others] = trade * self.units[others]
        noise = share * max(float(np.mean(self.weights * self.residual**2)), TINY)
        left, residual = (np.sqrt(self.weights / noise) * x for x in (left, self.residual))
        seen = np.sqrt(information / noise / max(float(left @ left), TINY))  # less where slopes are not sure of it
        pull = float(left @ residual) if information > 0.0 else 0.0
        return np.where(np.isin(np.arange(len(whole)), settled), whole, 0.0), seen * left, pull


def _traded(own: Array, slope: Array, weights: Array) -> tuple[Array, Array, float]:
    """How estimates with slopes `own` (2, n, m) make up for one unit of a quantity with `slope` (2, m), each with what it is
    unsure of; what is left of it (m,), and the square sum of that beyond what is unsure.
    """
    (boxed, unsure), (moved, doubt) = own, slope
    inverse = np.linalg.inv((boxed * weights) @ boxed.T + PRIOR * np.eye(len(boxed)))
    trade = -inverse @ (boxed @ (weights * moved))
    error = doubt + trade @ unsure
    trade[np.abs(trade) < np.abs(inverse @ (boxed @ (weights * error)))] = 0.0  # no more than slopes are unsure
    left, error = moved + trade @ boxed, doubt + trade @ unsure
    return trade, left, max(float(weights @ (left**2 - error**2)), 0.0)


def excerpt(problem: Problem) -> Problem:
    """`EXCERPT` s of motion, the shortest trials first; all of it where starts are eliminated."""
    if problem.eliminated or problem.duration <= EXCERPT:
        return problem
    order = sorted(range(len(problem.trials)), key=lambda k: problem.trials[k].duration)
    lasting = np.cumsum([problem.trials[k].duration for k in order])
    some = sorted(order[: int(np.searchsorted(lasting, EXCERPT)) + 1])
    part = problem.replayed_by([problem.trials[k] for k in some], [problem.owners[k] for k in some])
    return part.shortened(EXCERPT) if len(some) == 1 else part


def slopes_of(problem: Problem, fit: Fit, beside: Sequence[int], more: Sequence[Parameter]) -> tuple[Array, Array]:
    """(2, n_free + m, residuals) slopes for one unit of each free parameter, of the frozen ones at places `beside`, and of
    each quantity behind them, and how far steps to both sides differ in them; and the residuals (residuals,) between. The
    fit's own slopes may be some steps old.
    """
    own, first = fit.space.parameters, len(fit.values)
    moved = [(i, own[i]) for i in (*np.flatnonzero(fit.space.free).tolist(), *beside)]
    moved += [(first + i, p) for i, p in enumerate(more)]
    base = np.concatenate([fit.values, [p.nominal for p in more]])
    places = [i for i, _ in moved]
    sizes = [max(base[i], _APART * p.upper) if p.scale == "log" else p.upper - p.lower for i, p in moved]
    steps = _APART * np.array(sizes)
    # Beyond a bound a simulation may fail: what has no room for a step is moved to the other side alone.
    room = np.array([[p.upper - base[i], base[i] - p.lower] for i, p in moved]).T
    up, down = np.where(room >= steps, steps, 0.0)
    rows = np.repeat(base[None], 2 * len(moved) + 1, axis=0)
    rows[np.arange(len(moved)), places] += up
    rows[len(moved) + np.arange(len(moved)), places] -= down
    residuals = problem.residuals(rows)
    higher = (residuals[: len(moved)] - residuals[-1]) / steps[:, None]
    lower = (residuals[-1] - residuals[len(moved) : -1]) / steps[:, None]
    higher, lower = np.where((up > 0.0)[:, None], higher, lower), np.where((down > 0.0)[:, None], lower, higher)
    return np.stack([0.5 * (higher + lower), 0.5 * (higher - lower)]), residuals[-1]
