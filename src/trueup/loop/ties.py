# SPDX-License-Identifier: Apache-2.0
"""What estimates owe to quantities that were not asked for: parallel ones, of which only a sum is seen.

A drive's damping and its joint's do the same to every motion. Where one of them is calibrated and the other stays at what
the file says, the estimate holds for their sum, and its own interval must hold whatever the other is: a *consider*
parameter (S. F. Schmidt, Advances in Control Systems 3, 1966; Tapley, Schutz and Born, Statistical Orbit Determination,
2004, 6.4). What is parallel is found from the simulator's own slopes, not from a list.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.calibration import NORMAL_95, Estimate
from trueup.engines.simulator import Related, Simulator
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.loop.uncertainty import PRIOR, vague
from trueup.parameters import Parameter
from trueup.rounding import TINY

Array = NDArray[np.float64]

_STEP = 1e-3  # share of its value or range by which a quantity is moved
EXCERPT = 20.0  # s of motion: what is parallel, or lacking, is so in every motion


@dataclass(frozen=True)
class Considered:
    """A quantity that was not asked for, and what the estimates owe to it."""

    parameter: Parameter
    trade: Array
    """(n_free,) by how much each estimate changes for one unit more of it, in their units."""
    low: float
    high: float
    """Between which ends it may be, in its unit: its bounds, or nearer where the recordings tell."""
    calibrated: bool = False
    """Whether it was asked for, and stays open all the same."""

    def reach(self, trade: float) -> tuple[float, float]:
        """How far down and up an estimate with that trade may be moved by it; both are positive."""
        ends = trade * (self.low - self.parameter.nominal), trade * (self.high - self.parameter.nominal)
        return max(-min(ends), 0.0), max(*ends, 0.0)

    def words(self, e: Estimate, trade: float) -> str:
        """What is seen of an estimate, as far as its own interval tells, and where the rest is."""
        p, size = self.parameter, abs(trade)
        value, low, high = (x - trade * p.nominal for x in (e.value, e.low, e.high))
        other = p.name if f"{size:.2g}" == "1" else f"{size:.3g} x {p.name}"
        sign = "+" if trade < 0.0 else "-"
        return (
            f"only {e.name} {sign} {other} is seen: {value:.4g} [{low:.4g}, {high:.4g}] {e.unit}".rstrip()
            + f"; {p.name} {'is' if self.calibrated else 'stays at'} {p.nominal:.4g}"
            + ("" if self.calibrated else ", as the model has it")
        )


def considered(problem: Problem, fit: Fit, covariance: Array) -> tuple[Considered, ...]:
    """What the estimates owe to each related quantity that is not calibrated, and to those that are and yet stay open by
    their `covariance` in the unit box (n_free, n_free), from slopes along a part of the motion.
    """
    other = _related(problem.simulator)
    more = () if other is None else other.parameters.parameters[len(fit.values) :]
    free = np.flatnonzero(fit.space.free)
    parameters = [*(fit.space.parameters[i] for i in free), *more]
    nominal = [*fit.values[free].tolist(), *(p.nominal for p in more)]
    undecided = [k for k in range(len(free)) if vague(float(np.sqrt(max(covariance[k, k], 0.0))))]
    asked = [*undecided, *range(len(free), len(parameters))]
    if not asked:
        return ()
    some, share = _excerpt(problem)
    columns = np.concatenate([np.arange(c.start, c.stop) for c in (problem.columns(k) for k in some)])
    weights = fit.weights[columns]
    slopes = _slopes(problem if other is None else problem.by(other), fit, more, some)
    units = fit.space.unit_slope(fit.values)
    if not np.isfinite(slopes[:, : len(free)]).all():
        return ()
    noise = max(float(np.mean(weights * fit.residual[columns] ** 2)), TINY)
    found = []
    for k in asked:
        if np.isfinite(slopes[:, k]).all():
            settled = [i for i in range(len(free)) if i != k and i not in undecided]
            trade, told = _traded(slopes[:, settled] * units[settled, None], slopes[:, k], weights)
            p = parameters[k].replace(nominal=float(np.clip(nominal[k], parameters[k].lower, parameters[k].upper)))
            half = NORMAL_95 / np.sqrt(told / share / noise + PRIOR / (p.upper - p.lower) ** 2)
            whole = np.zeros(len(free))
            whole[settled] = trade * units[settled]
            low, high = max(p.lower, p.nominal - half), min(p.upper, p.nominal + half)
            found.append(Considered(p, whole, low, high, calibrated=k < len(free)))
    return tuple(found)


def _traded(own: Array, slope: Array, weights: Array) -> tuple[Array, float]:
    """How estimates with slopes `own` (2, n, m) make up for one unit of a quantity with `slope` (2, m), each with what it is
    unsure of, and the square sum that is left.
    """
    (boxed, unsure), (moved, doubt) = own, slope
    inverse = np.linalg.inv((boxed * weights) @ boxed.T + PRIOR * np.eye(len(boxed)))
    trade = -inverse @ (boxed @ (weights * moved))
    error = doubt + trade @ unsure
    trade[np.abs(trade) < np.abs(inverse @ (boxed @ (weights * error)))] = 0.0  # no more than slopes are unsure
    left, error = moved + trade @ boxed, doubt + trade @ unsure
    return trade, max(float(weights @ (left**2 - error**2)), 0.0)


def _related(simulator: Simulator) -> Simulator | None:
    """The simulator itself, not an approximation or a restricted view of it, with what it knows to be related."""
    while not isinstance(simulator, Related):
        simulator = getattr(simulator, "whole", None)  # type: ignore[assignment]
        if simulator is None:
            return None
    return simulator.related()


def _excerpt(problem: Problem) -> tuple[list[int], float]:
    """Trials of `EXCERPT` s in all, the shortest first, or all where starts are eliminated; their share of the residuals."""
    order = sorted(range(len(problem.trials)), key=lambda k: problem.trials[k].duration)
    lasting = np.cumsum([problem.trials[k].duration for k in order])
    some = sorted(order[: len(order) if problem.eliminated else int(np.searchsorted(lasting, EXCERPT)) + 1])
    sizes = [problem.columns(k).stop - problem.columns(k).start for k in range(len(problem.trials))]
    return some, sum(sizes[k] for k in some) / sum(sizes)


def _slopes(problem: Problem, fit: Fit, more: Sequence[Parameter], some: Sequence[int]) -> Array:
    """(2, n_free + m, residuals of `some` trials) slopes for one unit of each free parameter and each quantity behind them,
    and how far steps to both sides differ in them. The fit's own slopes may be some steps old.
    """
    moved = [(i, p) for i, p in enumerate((*fit.space.parameters, *more)) if not p.frozen]
    base = np.concatenate([fit.values, [p.nominal for p in more]])
    places = [i for i, _ in moved]
    steps = np.array(
        [_STEP * (max(base[i], _STEP * p.upper) if p.scale == "log" else p.upper - p.lower) for i, p in moved]
    )
    rows = np.repeat(base[None], 2 * len(moved) + 1, axis=0)
    rows[np.arange(len(moved)), places] += steps
    rows[len(moved) + np.arange(len(moved)), places] -= steps
    residuals = problem.residuals(rows) if problem.eliminated else problem.plain_residuals(rows, some)
    up, down = residuals[: len(moved)] - residuals[-1], residuals[-1] - residuals[len(moved) : -1]
    return np.stack([0.5 * (up + down), 0.5 * (up - down)]) / steps[:, None]
