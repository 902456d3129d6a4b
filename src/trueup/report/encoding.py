# SPDX-License-Identifier: Apache-2.0
"""Arrays inside an HTML file: thinned without losing an extreme, and packed as base64."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.report.drawing import SAMPLES

MISSING = int(np.iinfo(np.int16).min)
"""The 16-bit code of a missing sample."""


def kept_samples(lines: Sequence[Array], most: int) -> np.ndarray:
    """Indices, ascending, of at most about `most` samples that keep the minimum and maximum of each line.

    `lines` are (T,) each. The samples are cut into equal stretches; of each stretch the extremes of every line
    are kept, so peaks stay where and as high as they were.
    """
    count = lines[0].size
    if count <= most:
        return np.arange(count)
    stretches = max(1, most // (2 * len(lines)))
    edges = np.linspace(0, count, stretches + 1).astype(int)[:-1]
    length = math.ceil(count / stretches)
    # every stretch as one row of (overlapping at the end) indices: argmin and argmax of all at once
    rows = np.minimum(edges[:, None] + np.arange(length)[None, :], count - 1)
    kept = [np.array([0, count - 1])]
    for line in lines:
        values = line[rows]
        low = np.where(np.isnan(values), np.inf, values)
        high = np.where(np.isnan(values), -np.inf, values)
        kept += [edges + low.argmin(axis=1), edges + high.argmax(axis=1)]
    return np.unique(np.minimum(np.concatenate(kept), count - 1))


def packed(values: Array) -> dict[str, Any]:
    """`values` (T,) for JSON: {"k": "i2", "o": offset, "s": step, "d": base64} or {"k": "f4", "d": base64}.

    16-bit steps where nine tenths of the samples span as many as a line has samples, 32-bit floats where an
    outlier would make them coarser than that; little endian. Infinite values become missing ones.
    """
    values = np.where(np.isfinite(values), values, np.nan)
    finite = values[np.isfinite(values)]
    if finite.size:
        low, high = float(finite.min()), float(finite.max())
        # Codes go to both sides of the middle; the one below them all is of what is missing.
        step = (high - low) / 2 / np.iinfo(np.int16).max
        lower, upper = np.percentile(finite, [5, 95])
        if math.isfinite(step) and SAMPLES * step <= upper - lower:
            return _sixteen_bits(values, (low + high) / 2, step)
    with np.errstate(over="ignore"):
        single = values.astype("<f4")
    return {"k": "f4", "d": _base64(np.where(np.isfinite(single), single, np.float32(np.nan)).astype("<f4"))}


def _sixteen_bits(values: Array, middle: float, step: float) -> dict[str, Any]:
    scaled = np.nan_to_num((values - middle) / (step or 1.0), nan=MISSING)
    return {"k": "i2", "o": middle, "s": step, "d": _base64(np.round(scaled).astype("<i2"))}


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode("ascii")
