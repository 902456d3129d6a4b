# SPDX-License-Identifier: Apache-2.0
"""Does it hold on what was not fitted? Leave one recording out, without starting over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.recording import PART_OF

Array = NDArray[np.float64]


def left_out_points(problem: Problem, fit: Fit, held: Array | None = None) -> Array:
    """(R, n_free) where the fit would go if it had never seen recording r: one Gauss-Newton step from the optimum.

    Windows cut from one recording are left out together: neighbours share what is wrong with both.
    `held` (n_free,) are values in the unit box for parameters that must not be used, NaN for the others.
    """
    weighted = fit.jacobian * fit.weights[:, None]
    fixed = np.zeros(len(fit.unit), dtype=bool) if held is None else np.isfinite(held)
    jump = np.where(fixed, (held if held is not None else fit.unit) - fit.unit, 0.0)
    curvature = fit.jacobian.T @ weighted
    slope = weighted.T @ fit.residual
    points = np.empty((len(problem.trials), len(fit.unit)))
    for together in _together(problem):
        own = np.zeros(len(fit.residual), dtype=bool)
        for segment in problem.segments:
            if segment.recording in together:
                own[segment.columns] = True
        left = curvature - fit.jacobian[own].T @ weighted[own]
        pull = slope - weighted[own].T @ fit.residual[own] + left @ jump
        free = ~fixed
        damped = left[np.ix_(free, free)]
        ridge = 1e-4 * np.diag(np.diag(curvature)[free]) + 12.0 * np.eye(int(free.sum()))
        step = np.array(jump)
        step[free] = -np.linalg.solve(damped + ridge, pull[free])
        point = np.clip(fit.unit + np.clip(step, -0.5, 0.5), 0.0, 1.0)
        point[fixed] = np.clip((held if held is not None else fit.unit)[fixed], 0.0, 1.0)
        points[together] = point
    return points


def _together(problem: Problem) -> list[list[int]]:
    """Recordings by what they were cut from; each by itself where all were cut from one."""
    groups: dict[str, list[int]] = {}
    for r, recording in enumerate(problem.recordings):
        groups.setdefault(recording.provenance.get(PART_OF, recording.name), []).append(r)
    return list(groups.values()) if len(groups) > 1 else [[r] for r in range(len(problem.trials))]


def left_out_errors(problem: Problem, fit: Fit, variants: list[Array | None]) -> Array:
    """(len(variants), R) replay error of each recording, in the main channel's unit, by a fit that never saw it.

    Each variant names the parameters it does without (see `left_out_points`). inf where the replay fails.
    """
    points = [left_out_points(problem, fit, held) for held in variants]
    errors = np.full((len(variants), len(problem.trials)), np.inf)
    for r in range(len(problem.trials)):
        rows = fit.space.from_unit(np.array([p[r] for p in points]))
        residuals = problem.residuals(rows, only=[r])
        scales, offset = [], 0
        for segment in problem.segments:
            if segment.recording == r:
                stop = offset + segment.count
                if segment.channel == problem.main[0] and segment.count:
                    scales.append(np.mean((residuals[:, offset:stop] * segment.units) ** 2, axis=1))
                offset = stop
        if scales:
            errors[:, r] = np.sqrt(np.mean(scales, axis=0))
    return np.where(np.isfinite(errors), errors, np.inf)
