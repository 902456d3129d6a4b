# SPDX-License-Identifier: Apache-2.0
"""What estimates owe to quantities that were not asked for: parallel ones, of which only a sum is seen.

A drive's damping and its joint's do the same to every motion. Where one of them is calibrated and the other stays at what
the file says, the estimate holds for their sum, and its own interval must hold whatever the other is: a *consider*
parameter (S. F. Schmidt, Advances in Control Systems 3, 1966; Tapley, Schutz and Born, Statistical Orbit Determination,
2004, 6.4). What is parallel is found from the simulator's own slopes, not from a list. The step of the simulation is such a
quantity, too: it is what the model says, and none in the robot.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Nuisance
from trueup.engines.simulator import related_of
from trueup.evidence import half_interval
from trueup.loop.considered import Considered, Slopes, excerpt, slopes_of
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.loop.step_errors import of_stairs, of_step
from trueup.parameters import Parameter
from trueup.search.robust import robust_weights
from trueup.verdicts import PRIOR, vague


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
    part, units = excerpt(problem), fit.space.unit_slope(fit.values)
    wider = part if other is None else part.by(other)
    slopes, residual = slopes_of(
        wider if fit.coarse_step is None else wider.at_step(fit.coarse_step), fit, beside, more
    )
    direct = slopes[0, : len(free)].copy()
    slopes[:, : len(free)] *= units[:, None]
    seen = Slopes(slopes, residual, robust_weights(residual, fit.bend), units)
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
    return (*found, *of_step(part, fit, seen, direct, settled), *of_stairs(problem, fit, settled))


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
