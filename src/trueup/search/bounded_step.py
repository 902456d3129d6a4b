# SPDX-License-Identifier: Apache-2.0
"""Steps of Levenberg and Marquardt inside a box: what a quadratic model says of them, and what they say of its slopes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.noise import spread
from trueup.rounding import NEGLIGIBLE, ROUNDED, TINY

SHORTENED = (1.0, 0.5, 0.25)
"""Shares of a step that are tried in turn, where slopes may reach less far than it goes."""
_MOST_SHRINK = 5.0


def careful_difference(residual: Array | None, largest: float) -> float:
    """Share of the box by which parameters are moved to see slopes, where the residual (m,) is known: at most `largest`.

    Far from the recordings a coarse one sees past the ripples of friction; at the noise it must be exact, or weakly seen
    directions take the errors of the strong ones for their own slope.
    """
    if residual is None:
        return largest
    return float(np.clip(1e-4 * spread(residual) ** 2, 1e-4, largest))


def damped_step(curvature: Array, slope: Array, damping: float, at: Array) -> Array:
    """(n,) the step from `at` that minimises slope . step + step . curvature . step / 2, damped in proportion to the
    curvature's diagonal (D. Marquardt, SIAM J. 11(2), 1963): parameters pushed against a bound of [0, 1] are held there.
    """
    n = len(slope)
    diagonal = np.diag(curvature)
    floor = ROUNDED * max(float(diagonal.max()), TINY)
    damped = curvature + np.diag(damping * (diagonal + floor) + floor)
    free = np.ones(n, dtype=bool)
    step = np.zeros(n)
    for _ in range(3 * n):
        step[:] = 0.0
        if free.any():
            step[free] = -np.linalg.solve(damped[np.ix_(free, free)], slope[free])
        blocked = free & (((at <= 0.0) & (step < 0)) | ((at >= 1.0) & (step > 0)))
        if blocked.any():
            free &= ~blocked
            continue
        # What was held while others pushed may now want to leave its bound.
        pull = np.where(free, 0.0, -(slope + damped @ step) * np.where(at > 0.5, -1.0, 1.0))
        if pull.max() <= NEGLIGIBLE * np.abs(slope).max():
            break
        free[int(pull.argmax())] = True
    return step


def steps_apart(
    curvature: Array, slope: Array, dampings: Sequence[float], at: Array, log_range: Array, least: float, wide: float
) -> tuple[Array, list[int]]:
    """(b, n) where steps of several dampings end that differ, each also taken in values, and (b,) which damping made each.

    Ends are alike where the loss between them would differ by less than `least`, unless they are `wide` apart in the box:
    a logarithm near its lower bound is further from another than slopes can tell.
    """
    points: list[Array] = []
    rungs: list[int] = []
    for rung, damping in enumerate(dampings):
        step = damped_step(curvature, slope, damping, at)
        for moved in (step, in_value(step, log_range)):
            point = inside(at, moved, log_range)
            apart = [point - p for p in points]
            if all(a @ curvature @ a >= least or np.abs(a).max() > wide for a in apart):
                points.append(point)
                rungs.append(rung)
    return np.array(points), rungs


def gain(curvature: Array, slope: Array, step: Array) -> float:
    """By how much a step lowers the quadratic model."""
    return float(-(slope @ step + 0.5 * step @ curvature @ step))


def corrected(slopes: Array, before: Array, moved: Array, after: Array) -> Array:
    """Slopes (m, n) with what a step showed: Broyden's rank-one correction, Math. Comp. 19, 1965.

    `before` and `after` (m,) are the residuals at the ends of the step (n,).
    """
    surprise = after - before - slopes @ moved
    return slopes + np.outer(surprise, moved / (moved @ moved))


def inside(point: Array, step: Array, log_range: Array) -> Array:
    """The point after a step, in the box. No step divides a logarithmic parameter (`log_range` > 0, see LeastSquares) by
    more than `_MOST_SHRINK`: where it is tiny it has almost no effect, so one wrong step down there would not be taken back.
    """
    span = np.where(log_range > 0, log_range, 1e-3)
    return np.clip(point + np.maximum(step, -np.log(_MOST_SHRINK) / span), 0.0, 1.0)


def in_value(step: Array, log_range: Array) -> Array:
    """The step that changes a logarithmic parameter's value, not its logarithm, by what was computed."""
    span = np.where(log_range > 0, log_range, 1.0)
    moved = np.log1p(np.maximum(step * span, -0.95)) / span
    return np.where(log_range > 0, moved, step)
