# SPDX-License-Identifier: Apache-2.0
"""What floating-point numbers cannot tell apart: quotients of nothing, the same instant, whole steps of a clock."""

from __future__ import annotations

import math

import numpy as np

TINY = float(np.finfo(float).tiny)
"""Keeps quotients and logarithms of nothing finite, and changes nothing else."""
CERTAIN = -math.log(np.finfo(float).eps)
"""Log odds: beyond, a chance is 0 or 1 but for rounding."""
NEGLIGIBLE = 1e-12
"""What is smaller beside one is what rounding leaves of sums: a floor of variances and determinants, a ridge."""
ROUNDED = 1e-9
"""Relative: results of longer computations, or in SI units of robots, that differ by less are the same."""
PRINTED = 1e-6
"""What numbers lose that are written with six digits: relative, in SI units of robots, or of a step between instants."""
SAME_INSTANT = ROUNDED
"""s: clocks are printed with a few decimals, and sums of steps round; instants closer than this are the same."""
DATE = SAME_INSTANT / float(np.finfo(float).eps)
"""s, 52 days: clocks further from zero, which count from a date, do not tell instants apart, and are moved to begin at 0."""


def whole_steps(duration: float, step: float) -> int:
    """How many steps fit into a duration; one that ends there but for rounding does."""
    return math.floor(duration / step + SAME_INSTANT)


def first_step(instant: float, step: float) -> int:
    """The number of the first step that is not before an instant, counted from zero; the same instant is not before."""
    return math.ceil(instant / step - SAME_INSTANT)
