# SPDX-License-Identifier: Apache-2.0
"""Walking through a course of targets in all directions.

After goToTarget of P. MacAlpine et al., "Design and optimization of an omnidirectional humanoid walk", AAAI 2012.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import Rollout
from trueup.rounding import SAME_INSTANT
from trueup.tasks.walking import PLACE, Walk


@dataclass(frozen=True, kw_only=True, eq=False)
class OmniWalk(Walk):
    """Through a course of targets in all directions: metres made good toward each while it is the present one.

    Where the robot is to step on the spot, metres that it drifts are taken off.
    """

    stretch: float = 1.0
    """Factor on all times of the course: longer for slower walks."""
    fall: float = 5.0
    """m, as in goToTarget."""

    name: str = field(init=False, default="walk around")
    unit: str = field(init=False, default="m")
    counts: str = field(init=False, default="way made good")

    @property
    def duration(self) -> float:
        """See Walk."""
        return self.stretch * sum(leg[0] for leg in COURSE)

    @property
    def course(self) -> Array:
        """See Walk."""
        lasting, x, y = np.array(COURSE).T
        begun = self.stretch * (np.cumsum(lasting) - lasting)
        every = np.ones(len(x))
        return np.stack([begun, x, y, self.share * every, every], axis=1)

    def made_good(self, rollout: Rollout) -> Array:
        """(b,) m."""
        place = rollout.held().channels[PLACE][:, :, :2]
        time, begun = rollout.trial.observed[PLACE].time, [*self.course[:, 0], self.duration]
        made = np.zeros(len(place))
        for k, target in enumerate(self.course[:, 1:3]):
            first, last = (place[:, np.searchsorted(time, begun[i] - SAME_INSTANT)] for i in (k, k + 1))
            if np.isnan(target).any():
                made -= np.linalg.norm(last - first, axis=1)
            else:
                made += np.linalg.norm(target - first, axis=1) - np.linalg.norm(target - last, axis=1)
        return made


_STOP = float("nan")
COURSE = (
    (8.0, 2.0, 0.0), (6.0, -1.0, 0.0), (5.0, 0.0, 1.0), (5.0, 0.0, -1.0), (2.0, _STOP, _STOP),  # the four directions
    (6.0, 1.5, 1.5), (6.0, 1.5, -1.5), (2.0, _STOP, _STOP), (6.0, -2.0, 0.0),  # obliquely, and about turn
    *((1.5, 0.6 * np.cos(a), 0.6 * np.sin(a)) for a in np.linspace(0.0, 2.0 * np.pi, 9)),  # a circle
    *((0.5, 3.0, 3.0 * side) for side in (1.0, -1.0) * 5), (1.0, _STOP, _STOP),  # quick changes, and a stop
)  # fmt: skip
"""Targets in the field's frame: for how long (s), x and y (m)."""
