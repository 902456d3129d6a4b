# SPDX-License-Identifier: Apache-2.0
"""Round numbers for the axes of hand-drawn charts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from trueup.report.numbers import fixed
from trueup.rounding import ROUNDED


def nice_marks(low: float, high: float, most: int) -> list[float]:
    """At most `most` multiples of 1, 2 or 5 x 10^n between `low` and `high`, ascending."""
    if not low < high:
        return [low]
    magnitude = 10.0 ** (math.floor(math.log10(high - low)) - 2)
    for step in (f * magnitude * 10.0**d for d in range(5) for f in (1.0, 2.0, 5.0)):
        first, last = math.ceil(low / step - ROUNDED), math.floor(high / step + ROUNDED)
        if last - first + 1 <= most:
            return [i * step for i in range(first, last + 1)]
    return [low, high]


def spans_decades(low: float, high: float) -> bool:
    """Whether an axis from `low` to `high` is better logarithmic: both above zero, two decades apart."""
    return low > 0 and high / low > 100


def mark_texts(marks: Sequence[float]) -> list[str]:
    """The marks with as many decimals as their distance needs."""
    distance = min((b - a for a, b in pairwise(marks)), default=abs(marks[0]) if marks else 1.0)
    decimals = max(0, -math.floor(math.log10(distance) + ROUNDED)) if distance > 0 else 0
    return [fixed(m, decimals) for m in marks]
