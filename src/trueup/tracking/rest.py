# SPDX-License-Identifier: Apache-2.0
"""Whether a car stood when it was first commanded: then what it was commanded before is known, which no log shows."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.instant import HARDLY, MOVING, REACH
from trueup.noise import FEWEST
from trueup.rounding import ROUNDED


def stood(time: Array, signals: Array, first: float) -> bool:
    """Whether what was tracked as `signals` (T, k) at `time` (T,) stood at the instant `first`, all on one clock in s.

    What was tracked before tells, by whether it moves; where nothing was, what follows: its speed at first, of a parabola,
    is nothing, or little beside that at the end, or the other way (it is late). False where too little of that instant was
    tracked.
    """
    before = (time <= first) & (time >= first - REACH)
    if before.sum() >= FEWEST:
        return not _goes(time[before] - first, signals[before], 1)
    after = np.flatnonzero(time >= first)
    after = after[: max(FEWEST, int(np.sum(time[after] <= first + REACH)))]
    if len(after) < FEWEST or time[after[0]] > first + REACH:
        return False
    return not _goes(time[after] - time[after[0]], signals[after], 2)


def _goes(since: Array, signals: Array, degree: int) -> bool:
    """Whether any signal has a speed at `since` (T,) 0, by a polynomial of some degree, and not only begins to move."""
    powers = np.stack([since**k for k in range(degree + 1)], axis=1)
    inverse = np.linalg.pinv(powers)
    found = inverse @ signals
    spread = np.sqrt(np.sum((signals - powers @ found) ** 2, axis=0) / (len(since) - degree - 1))
    unsure = MOVING * spread * float(np.linalg.norm(inverse[1]))
    end = found[1] + 2.0 * since[-1] * found[2:].sum(axis=0)
    return bool(np.any(found[1] * np.sign(end) > np.maximum(unsure, HARDLY * np.abs(end)) + ROUNDED))
