# SPDX-License-Identifier: Apache-2.0
"""What estimates owe to quantities that were not asked for: parallel ones, of which only a sum is seen.

A drive's damping and its joint's do the same to every motion. Where one of them is calibrated and the other stays at what
the file says, the estimate holds for their sum, and its own interval must hold whatever the other is: a *consider*
parameter (S. F. Schmidt, Advances in Control Systems 3, 1966; Tapley, Schutz and Born, Statistical Orbit Determination,
2004, 6.4). What is parallel is found from the simulator's own slopes, not from a list. The step of the simulation is such a
quantity, too: it is what the model says, and none in the robot.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from trueup.arrays import Array
from trueup.calibration import Estimate, Nuisance
from trueup.engines.simulator import related_of
from trueup.evidence import EXCERPT, half_interval
from trueup.loop.descent import Fit
from trueup.loop.probe import ROUGH, unexplained
from trueup.loop.problem import Problem
from trueup.loop.uncertainty import FORETOLD
from trueup.parameters import Parameter
from trueup.rounding import ROUNDED, TINY
from trueup.search.bounded_step import gain
from trueup.search.robust import robust_weights
from trueup.verdicts import PRIOR, vague

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


def considered(problem: Problem, fit: Fit, covariance: Array, untold: Collection[str] = ()) -> tuple[Considered, ...]:
    """What the estimates owe to the simulation's step, to each related quantity that is not calibrated, to those that nobody
    asked for (`Parameter.requested`), to those held at their start values since no recording told them (`untold`), and to
    those that are calibrated and yet stay open by their `covariance` in the unit box (n_free, n_free), from slopes along a
    part of the motion.
    """
    related = related_of(problem.simulator)
    other = None if related is None else related.related()
    more = () if other is None else other.parameters.parameters[len(fit.values) :]
    free = np.flatnonzero(fit.space.free)
    beside = [i for i, p in enumerate(fit.space.parameters) if p.frozen and (not p.requested or p.name in untold)]
    places = [*free, *beside]
    parameters = [*(fit.space.parameters[i] for i in places), *more]
    nominal = [*fit.values[places].tolist(), *(p.nominal for p in more)]
    undecided = [k for k in range(len(free)) if vague(float(np.sqrt(max(covariance[k, k], 0.0))))]
    settled = [k for k in range(len(free)) if k not in undecided]
    asked = [*undecided, *range(len(free), len(parameters))]
    part, units = _excerpt(problem), fit.space.unit_slope(fit.values)
    wider = part if other is None else part.by(other)
    slopes, residual = _slopes(wider if fit.coarse_step is None else wider.at_step(fit.coarse_step), fit, beside, more)
    slopes[:, : len(free)] *= units[:, None]
    seen = _Slopes(slopes, residual, robust_weights(residual, fit.bend), units)
    if not np.isfinite(seen.boxed[:, : len(free)]).all():
        return ()
    share, found = len(seen.residual) / len(fit.residual), list[Considered]()
    for k in asked:
        if np.isfinite(seen.boxed[:, k]).all():
            slope = seen.boxed[:, k] / (units[k] if k < len(free) else 1.0)
            trade, left, pull = seen.owed(slope, [i for i in range(len(free)) if i != k], settled, share)
            p = parameters[k].replace(nominal=float(np.clip(nominal[k], parameters[k].lower, parameters[k].upper)))
            sure = left @ left + PRIOR / (p.upper - p.lower) ** 2
            half, there = half_interval() / np.sqrt(sure), p.nominal - pull / sure
            low, high = max(p.lower, min(p.nominal, there) - half), min(p.upper, max(p.nominal, there) + half)
            if not p.identifiable:
                low, high = _within_bounds(p, trade, fit)
            found.append(Considered(p, trade, low, high, left, pull, calibrated=k < len(free)))
    return (*found, *_of_step(part, fit, seen, settled), *_of_stairs(problem, fit, settled))


def _within_bounds(p: Parameter, trade: Array, fit: Fit) -> tuple[float, float]:
    """Between which ends a quantity may be that nothing tells: its bounds, as far as the estimates that make up for it stay
    within theirs.
    """
    free = [(q, float(value)) for q, value in zip(fit.space.parameters, fit.values, strict=True) if not q.frozen]
    ends = [
        sorted(((q.lower - value) / t, (q.upper - value) / t))
        for (q, value), t in zip(free, trade.tolist(), strict=True) if t != 0.0
    ]  # fmt: skip
    below, above = (max((e[0] for e in ends), default=-np.inf), min((e[1] for e in ends), default=np.inf))
    return max(p.lower, p.nominal + min(below, 0.0)), min(p.upper, p.nominal + max(above, 0.0))


def _of_step(problem: Problem, fit: Fit, slopes: _Slopes, settled: Sequence[int]) -> list[Considered]:
    """What estimates owe to the step: the errors of one step after the other add up to one that grows with it (E. Hairer,
    S. P. Norsett and G. Wanner, Solving Ordinary Differential Equations I, 1993, II.3).
    """
    step = problem.simulator.step
    twin, ((direct, _), own) = problem.at_step(0.5 * step), _slopes(problem, fit, (), ())
    finer = twin.residuals(fit.values[None])[0]
    if not np.isfinite(finer).all() or not np.isfinite(direct).all():
        return []
    slope = (own - finer) / (0.5 * step)
    _, left, pull = slopes.owed(np.stack([slope, np.zeros_like(slope)]), list(range(len(slopes.units))), settled)
    moved = _settled(twin, fit, direct, own, finer) - fit.values[fit.space.free]
    whole = np.where(np.isin(np.arange(len(slopes.units)), settled), moved, 0.0)
    return [Considered(Parameter(STEP, "s", step, 0.0, step), -whole / (0.5 * step), 0.0, step, left, pull)]


def _of_stairs(problem: Problem, fit: Fit, settled: Sequence[int]) -> list[Considered]:
    """What times owe to the step that act from one step to the next, where slopes over a step do not lead along them: where
    commands jump and forces saturate all places within a step replay alike, and any of them may be the robot's.
    """
    step, free = problem.simulator.step, [p for p in fit.space.parameters if not p.frozen]
    times = [k for k in settled if free[k].unit == "s" and free[k].scale != "log"]
    found = []
    for k in times:
        unit = np.zeros(len(free))
        unit[k] = step / (free[k].upper - free[k].lower)
        points = np.clip(fit.unit + np.outer([1.0, -1.0], unit), 0.0, 1.0)
        if unexplained(points, problem.residuals(fit.space.from_unit(points)), fit.jacobian) >= ROUGH:
            either = Parameter(STEP, "s", step, 0.0, 2.0 * step)  # a step early or late
            found.append(Considered(either, (unit > 0.0).astype(float), 0.0, 2.0 * step, np.zeros(0), 0.0))
    return found


def _settled(twin: Problem, fit: Fit, direct: Array, own: Array, finer: Array) -> Array:
    """(n_free,) values at which the `twin` of a problem pulls as little as the problem does at the fit, where it leaves its
    `own` residuals (m,) and the twin `finer` ones: a deferred correction (H. J. Stetter, Numerische Mathematik 29, 1978), by
    the `direct` slopes (n_free, m) of the problem's own step, for as long as there is more than chance to correct, and ever
    less, in no more replays than slopes take. It goes by values: to what is next to nothing a logarithm leads no way.
    """
    lower, upper = np.array([(p.lower, p.upper) for p in fit.space.parameters if not p.frozen]).T
    weights = robust_weights(own, fit.bend)
    boxed = direct * (upper - lower)[:, None]
    curvature = (boxed * weights) @ boxed.T + PRIOR * np.eye(len(boxed))
    root, chance = np.linalg.cholesky(curvature), float(np.mean(weights * own**2))
    values, found, before = fit.values.copy(), fit.values[fit.space.free], np.inf
    for _ in range(2 * len(boxed)):
        at, pull = (values[fit.space.free] - lower) / (upper - lower), boxed @ (weights * (finer - own))
        within = np.maximum(-at, -FORETOLD), np.minimum(1.0 - at, FORETOLD)
        step = lsq_linear(root.T, -np.linalg.solve(root, pull), within, method="bvls").x
        left = gain(curvature, pull, step)
        if not left < before:
            break
        found = values[fit.space.free]
        if left < chance:
            break
        before, values[fit.space.free] = left, np.clip(found + (upper - lower) * step, lower, upper)
        finer = twin.residuals(values[None])[0]
        if not np.isfinite(finer).all():
            break
    return found


def nuisance(others: Sequence[Considered]) -> Nuisance | None:
    """Of what nobody asked for among `others`, all together: where it is as likely as a normal posterior has it, about the
    values of the model. What replays best may be elsewhere, and both are held (the second moment about the model's values).
    """
    own = [c for c in others if not c.parameter.requested]
    if not own:
        return None
    left, ranges = np.array([c.left for c in own]), np.array([c.parameter.upper - c.parameter.lower for c in own])
    known = np.asarray(np.linalg.inv(left @ left.T + np.diag(PRIOR / ranges**2)), dtype=np.float64)
    there = -known @ np.array([c.pull for c in own])
    trade = np.array([c.trade for c in own]).T
    return Nuisance(tuple(c.parameter.name for c in own), known + np.outer(there, there), trade)


@dataclass(frozen=True, eq=False)
class _Slopes:
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


def _excerpt(problem: Problem) -> Problem:
    """`EXCERPT` s of motion, the shortest trials first; all of it where starts are eliminated."""
    if problem.eliminated or problem.duration <= EXCERPT:
        return problem
    order = sorted(range(len(problem.trials)), key=lambda k: problem.trials[k].duration)
    lasting = np.cumsum([problem.trials[k].duration for k in order])
    some = sorted(order[: int(np.searchsorted(lasting, EXCERPT)) + 1])
    part = problem.replayed_by([problem.trials[k] for k in some], [problem.owners[k] for k in some])
    return part.shortened(EXCERPT) if len(some) == 1 else part


def _slopes(problem: Problem, fit: Fit, beside: Sequence[int], more: Sequence[Parameter]) -> tuple[Array, Array]:
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
