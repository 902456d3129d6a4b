# SPDX-License-Identifier: Apache-2.0
"""Single samples that stand far off their neighbours: faults of a bus or a sensor that a filter would smear."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.noise import spread

Array = NDArray[np.float64]

_NEAR = 3
"""Samples on either side: faults of up to three samples are seen, and a step, which has its like on one side, is none."""
_NEIGHBOURS, _NOISE, _RANGE = 8.0, 12.0, 0.05
"""Times the neighbours' own scatter, times the usual distance from them, and share of the signal's range: only a fault
exceeds all three."""
_MANY = 0.02
"""Share of samples from which on it is the signal that is so."""


def without_spikes(values: Array) -> tuple[Array, Array]:
    """(T, k) signals with NaN for their spikes, and (k,) how many samples of each that are.

    Samples are compared with the median of their neighbours (Hampel, "The influence curve and its role in robust
    estimation", 1974). A signal that is full of them is left alone; what is missing already stays so.
    """
    kept, counts = np.array(values), np.zeros(values.shape[1])
    known = np.isfinite(kept)
    if len(kept) < 8 * _NEAR or not known.all(axis=1).any():
        return kept, counts
    at = np.arange(len(kept))
    full = np.stack(
        [np.interp(at, at[good], x[good]) if good.any() else x for x, good in zip(kept.T, known.T, strict=True)], axis=1
    )
    low, high = np.quantile(full, [0.01, 0.99], axis=0)
    least = _RANGE * (high - low)
    spikes = np.zeros(full.shape, dtype=bool)
    jumping = np.abs(np.diff(full, axis=0)).max(axis=0) > 0.5 * least  # others have none: most logs cost nothing
    spikes[:, jumping] = _far_off(full[:, jumping], least[jumping])
    spikes &= known & (spikes.mean(axis=0) < _MANY)
    kept[spikes] = np.nan
    return kept, spikes.sum(axis=0).astype(np.float64)


def _far_off(full: Array, least: Array) -> NDArray[np.bool_]:
    """(T, k) whether samples are off their neighbours' median by more than `least` (k,) and more than is usual there."""
    around = np.pad(full, ((_NEAR, _NEAR), (0, 0)), mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(around, 2 * _NEAR + 1, axis=0)
    middle = np.median(around, axis=-1)
    off = np.abs(full - middle)
    usual = np.array([spread(x[x > 0.0]) if np.any(x > 0.0) else 0.0 for x in off.T])
    far = off > np.maximum(_NOISE * usual, least)
    scatter = np.median(np.abs(around[far] - middle[far][:, None]), axis=-1)
    far[far] = off[far] > _NEIGHBOURS * scatter
    return far
