# SPDX-License-Identifier: Apache-2.0
"""When samples came: how often, where some are missing, and whether stamps are those at which samples were taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.evidence import HALVED
from trueup.instant import MISSING, usual_step
from trueup.noise import estimate_noise, spread
from trueup.rounding import SAME_INSTANT


@dataclass(frozen=True)
class Gap:
    """A stretch without samples, much longer than the usual step."""

    start: float
    """Time of the last sample before it, in s."""
    duration: float
    """In s."""

    def is_single(self, rate: float) -> bool:
        """Whether a single sample is missing of those that come at a `rate` in Hz."""
        return round(self.duration * rate) <= 2


def clock_of(time: Array) -> tuple[float, float, tuple[Gap, ...]]:
    """Usual rate in Hz, jitter in s and gaps of instants (T,)."""
    steps = np.diff(time)
    if not steps.size:
        return float("nan"), 0.0, ()
    usual = usual_step(time)
    # Where the steps scatter widely anyway, only what stands out of that scatter is a gap.
    limit = max(MISSING * usual, usual + 6.0 * float(spread(steps - usual)))
    late = np.flatnonzero(steps > limit)
    gaps = tuple(Gap(float(time[i]), float(steps[i])) for i in late)
    return 1.0 / usual, float(np.std(np.delete(steps, late))), gaps


def restless(time: Array, values: Array, gaps: Sequence[Gap]) -> bool:
    """Whether stamps (T,) in s scatter that are not those at which values (T, k) were taken: what scatters about a smooth
    motion is halved where samples are taken to come evenly between the gaps. Stamps that scatter and are right make it more.
    """
    after = np.searchsorted(time, [gap.start for gap in gaps], side="right")
    ends = np.unique(np.concatenate([[0], after - 1, after, [len(time) - 1]])).clip(0, len(time) - 1)
    even = np.interp(np.arange(len(time)), ends, time[ends])
    if np.allclose(even, time, rtol=0.0, atol=SAME_INSTANT):
        return False
    none = [None] * values.shape[1]  # a grid leaves the same with both
    scatter, left = (estimate_noise(values, at, none) for at in (time, even))
    return bool(np.any(left < HALVED * scatter))
