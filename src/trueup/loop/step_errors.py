# SPDX-License-Identifier: Apache-2.0
"""What estimates owe to the step of the simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import lsq_linear

from trueup.arrays import Array
from trueup.loop.considered import STEP, Considered, Slopes
from trueup.loop.descent import Fit
from trueup.loop.probe import ROUGH, unexplained
from trueup.loop.problem import Problem
from trueup.loop.uncertainty import FORETOLD
from trueup.parameters import Parameter
from trueup.search.bounded_step import gain
from trueup.search.robust import robust_weights
from trueup.verdicts import PRIOR


def of_step(problem: Problem, fit: Fit, slopes: Slopes, direct: Array, settled: Sequence[int]) -> list[Considered]:
    """What estimates owe to the step: the errors of one step after the other add up to one that grows with it (E. Hairer,
    S. P. Norsett and G. Wanner, Solving Ordinary Differential Equations I, 1993, II.3). `direct` (n_free, m): `slopes` by
    values in their units, of a step that may be coarser.
    """
    step = problem.simulator.step
    twin = problem.at_step(0.5 * step)
    own, finer = (p.residuals(fit.values[None])[0] for p in (problem, twin))
    if not np.isfinite(finer).all() or not np.isfinite(direct).all():
        return []
    slope = (own - finer) / (0.5 * step)
    _, left, pull = slopes.owed(np.stack([slope, np.zeros_like(slope)]), list(range(len(slopes.units))), settled)
    moved = _settled(twin, fit, direct, own, finer) - fit.values[fit.space.free]
    whole = np.where(np.isin(np.arange(len(slopes.units)), settled), moved, 0.0)
    return [Considered(Parameter(STEP, "s", step, 0.0, step), -whole / (0.5 * step), 0.0, step, left, pull)]


def of_stairs(problem: Problem, fit: Fit, settled: Sequence[int]) -> list[Considered]:
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
    the `direct` slopes (n_free, m), for as long as there is more than chance to correct, and ever less, in no more replays
    than slopes take. It goes by values: to what is next to nothing a logarithm leads no way.
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
