# SPDX-License-Identifier: Apache-2.0
"""Samples of a signal, missing ones among them: what is in force at each, and angles without jumps of a turn."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array


def in_force(values: Array) -> Array:
    """(T, k) a command's values, each that is missing as the last one sent before it, at the beginning as the first one.

    A controller holds what it was told (zero-order hold). A column without any value stays NaN.
    """
    known = np.isfinite(values)
    if known.all():
        return values
    first = np.argmax(known, axis=0)
    last = np.maximum.accumulate(np.where(known, np.arange(len(values))[:, None], first), axis=0)
    return np.take_along_axis(values, last, axis=0)


def unwound(angles: Array) -> Array:
    """(T, k) angles without jumps of a turn, missing samples aside: half way between pi and -pi lies no heading of zero."""
    values = angles.copy()
    for column in values.T:
        known = np.isfinite(column)
        column[known] = np.unwrap(column[known])
    return angles if np.array_equal(values, angles, equal_nan=True) else values
