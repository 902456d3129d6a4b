# SPDX-License-Identifier: Apache-2.0
"""How fast a path may be driven: limits on lateral and longitudinal acceleration made into a speed profile."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.errors import RecordingError
from trueup.rounding import NEGLIGIBLE


@dataclass(frozen=True)
class SpeedLimits:
    """What the target speed must respect. Raises RecordingError for limits that are not positive."""

    lateral: float = math.inf
    """Greatest speed^2 * curvature, in m/s^2."""
    acceleration: float = math.inf
    """Greatest gain of speed, in m/s^2."""
    deceleration: float = math.inf
    """Greatest loss of speed, in m/s^2."""
    highest: float = math.inf
    """In m/s."""
    lowest: float = 0.1
    """Target speeds stay above this, in m/s: at zero the robot would never start."""
    start: float | None = None
    """Speed at the first point, in m/s; None: whatever is wanted there."""
    stop: float | None = None
    """Speed at the last point, in m/s; None: whatever is wanted there."""

    def __post_init__(self) -> None:
        """Checks the signs."""
        for name in ("lateral", "acceleration", "deceleration", "highest", "lowest"):
            if not getattr(self, name) > 0.0:
                raise RecordingError(f"speed limit '{name}' is {getattr(self, name)}; it must be positive")


def speed_profile(arc: Array, curvature: Array, wanted: Array, limits: SpeedLimits) -> Array:
    """(N,) the fastest speed in m/s that is nowhere above `wanted` (N,) nor the limits, at arc lengths (N,) in m.

    Curves first (v^2 |curvature| <= lateral), then forward with the acceleration and backward with the deceleration
    limit: v_next^2 <= v^2 + 2 a ds.
    """
    bend = np.maximum(np.abs(curvature), NEGLIGIBLE)
    speed = np.minimum(np.minimum(wanted, limits.highest), np.sqrt(limits.lateral / bend))
    if limits.start is not None:
        speed[0] = min(speed[0], limits.start)
    if limits.stop is not None:
        speed[-1] = min(speed[-1], limits.stop)
    speed = np.maximum(speed, limits.lowest)
    steps = np.diff(arc)
    if math.isfinite(limits.acceleration):
        for i, ds in enumerate(steps):
            speed[i + 1] = min(speed[i + 1], math.sqrt(speed[i] ** 2 + 2.0 * limits.acceleration * ds))
    if math.isfinite(limits.deceleration):
        for i in range(len(steps) - 1, -1, -1):
            speed[i] = min(speed[i], math.sqrt(speed[i + 1] ** 2 + 2.0 * limits.deceleration * steps[i]))
    return speed
