# SPDX-License-Identifier: Apache-2.0
"""Measurement noise and encoder grid, estimated from a signal that moves."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb, sqrt

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from trueup.arrays import Array
from trueup.evidence import half_interval
from trueup.rounding import TINY

FEWEST = 8
"""Samples: of fewer nothing is estimated, and a part of a recording with fewer says nothing by itself."""
UNUSUAL = 6.0
"""Times what is usual (the median, or what comes next): further off is something else. In logs of real robots on which
nothing acted, joints stay within three times what they are usually beside their commands, and the largest error of a model is
up to 2.8 times what comes next (AlienGo 2.8, SO-101 2.6, XL330 1.4, UR10 1.3; of torques UR10 1.3, Panda, TX40 1.1); a table
in the way, or a push of 30 to 60 N, are 10 to 200 times."""


def estimate_noise(values: ArrayLike, time: ArrayLike, grid: Sequence[float | None] | None = None) -> Array:
    """(k,) standard deviation of the measurement noise of each column, in the unit of `values` (T, k); time (T,) in s.

    Divided differences of high order remove every motion that is smooth over a few samples, at uneven instants too,
    and leave white noise with a known factor. The median over short blocks passes over bursts (impacts, steps). Where
    values lie on an encoder grid (`grid`, where each column's step is known already) the result is at least its
    quantisation error, step / sqrt(12). NaN where a column has fewer than 8 samples. Noise that is slow (drift, filtered
    signals) is not seen.
    """
    matrix = np.asarray(values, dtype=np.float64)
    columns = matrix[:, None] if matrix.ndim == 1 else matrix
    instants = np.asarray(time, dtype=np.float64)
    noise = np.full(columns.shape[1], np.nan)
    finite = np.isfinite(columns)
    gaps = ~finite.all(axis=0)
    noise[~gaps] = _scattered(columns[:, ~gaps], instants)
    for k in np.flatnonzero(gaps):
        noise[k] = _scattered(columns[finite[:, k], k : k + 1], instants[finite[:, k]])[0]
    steps = [estimate_grid(column) for column in columns.T] if grid is None else grid
    return np.maximum(noise, np.array([step or 0.0 for step in steps]) / sqrt(12.0))


def spread(errors: ArrayLike) -> Array:
    """(...) standard deviation of errors (T, ...) from the median of their sizes, so that a few wild ones do not count.

    F. Hampel, "The influence curve and its role in robust estimation", JASA 69, 1974.
    """
    return np.median(np.abs(errors), axis=0) / half_interval(share=0.5)


def is_noise(column: Array, noise: float, step: float | None) -> bool:
    """Whether samples (T,) show nothing but their own `noise`, as it was estimated, or one `step` of their grid."""
    smoothed = 16  # samples in a mean that shows slow motion under noise
    finite = column[np.isfinite(column)]
    if finite.size < 2:
        return True
    span = float(np.ptp(finite))
    if span == 0.0 or (step is not None and span <= 1.01 * step):
        return True
    if finite.size < 20 * smoothed or not np.isfinite(noise):
        return False
    # Means of white noise scatter little; a motion, which lasts, stays in them.
    means = finite[: finite.size // smoothed * smoothed].reshape(-1, smoothed).mean(axis=1)
    return float(np.std(means)) < 1.5 * noise / np.sqrt(smoothed) and float(np.std(finite)) < 1.3 * noise


def estimate_grid(values: ArrayLike) -> float | None:
    """Step of the grid that the samples (T,) lie on, in their unit, as an encoder leaves it; None if continuous.

    The step is the largest one of which nearly all differences between neighbouring distinct values are multiples.
    """
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    if finite.size < FEWEST:
        return None
    levels = np.unique(finite)
    # Numbers stored in single precision scatter about their grid by this much.
    fuzz = 3e-7 * float(np.abs(levels).max()) + TINY
    steps = np.diff(levels)
    steps = steps[steps > fuzz]
    if steps.size < 5:  # six distinct values are needed to tell a grid
        return None
    best = max((_refined(steps, s) for s in np.quantile(steps, [0.0, 0.01, 0.05, 0.25, 0.5])), default=0.0)
    if best <= 4.0 * fuzz or _is_printed(best, float(np.ptp(levels))):
        return None
    return best


def _scattered(columns: Array, time: Array) -> Array:
    """(k,) what scatters in columns (T, k) without gaps."""
    if len(time) < FEWEST:
        return np.full(columns.shape[1], np.nan)
    # Of differences: low orders keep motion, high ones need many samples; motion only adds, so the least counts.
    orders = [order for order in (2, 3, 4, 6, 8) if len(time) >= 4 * order] or [2]
    return np.min([_scatter(columns, time, order) for order in orders], axis=0)


def _scatter(columns: Array, time: Array, order: int) -> Array:
    """(k,) noise by divided differences: weights that annul polynomials below `order`, of unit norm."""
    block = 40  # differences per block
    weights = _annulling(time, order)
    windows = sliding_window_view(columns, order + 1, axis=0)
    squares = np.einsum("tj,tkj->tk", weights, windows - windows[:, :, :1]) ** 2
    blocks = max(1, len(squares) // block)
    if blocks < 3:
        return np.sqrt(np.mean(squares, axis=0))
    sizes = np.full(blocks, len(squares) // blocks) + (np.arange(blocks) < len(squares) % blocks)
    means = np.add.reduceat(squares, np.cumsum(sizes) - sizes, axis=0) / sizes[:, None]
    # Neighbouring differences are correlated; the median of a mean of squares with few degrees of freedom is low.
    freedom = len(squares) / blocks / _redundancy(order)
    return np.sqrt(np.median(means, axis=0) / (1.0 - 2.0 / (9.0 * freedom)) ** 3)


def _annulling(time: Array, order: int) -> Array:
    """(T - order, order + 1) weights of divided differences, each row of unit norm."""
    instants = sliding_window_view(time, order + 1)
    scale = (instants[:, -1] - instants[:, 0])[:, None] / order
    relative = (instants - instants[:, :1]) / scale
    weights = np.ones_like(relative)
    for j in range(order + 1):
        for other in (*range(j), *range(j + 1, order + 1)):
            weights[:, j] /= relative[:, j] - relative[:, other]
    return weights / np.sqrt(np.sum(weights**2, axis=1, keepdims=True))


def _redundancy(order: int) -> float:
    """Samples per degree of freedom in the mean square of differences of white noise."""
    correlation = [comb(2 * order, order - k) / comb(2 * order, order) for k in range(1, order + 1)]
    return 1.0 + 2.0 * sum(r * r for r in correlation)


def _refined(steps: Array, candidate: float) -> float:
    """The grid step near `candidate` of which 98 % of `steps` are multiples, or 0."""
    if candidate <= 0.0:
        return 0.0
    step = candidate
    for _ in range(3):
        near = steps[steps < 40.0 * step]
        counts = np.round(near / step)
        if not near.size or not counts.sum():
            return 0.0
        step = float(near.sum() / counts.sum())
    near = steps[steps < 40.0 * step]
    counts = np.round(near / step)
    good = (counts > 0) & (np.abs(near / step - counts) < 0.06)
    return step if near.size >= 0.5 * steps.size and float(np.mean(good)) >= 0.98 else 0.0


def _is_printed(step: float, span: float) -> bool:
    """Whether a grid is only the last decimal that was printed: a power of ten, with very many levels."""
    exponent = np.log10(step)
    return bool(abs(exponent - np.round(exponent)) < 1e-3 and span / step > 5e3)
