# SPDX-License-Identifier: Apache-2.0
"""An emulated industrial motion planner: straight tool moves and joint moves through via points, blended, at a set speed.

What users of industrial arms program: a list of poses, a speed, a fly-by accuracy. Sub-workspace evolved trajectories,
section II-B, lets a commercial interpolator do this; here it is done from rest to rest with trapezoidal or rounded
speed profiles, slowed down where a joint could not follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array
from trueup.excitation.cell import Cell, Settings, failures, overridden
from trueup.excitation.joint_moves import joint_programs
from trueup.excitation.limits import JointLimits
from trueup.excitation.trajectories import Motions


@dataclass(frozen=True, eq=False)
class ViaPoints:
    """Algorithm B's class of motion: K via points in a region and one speed, 6 K + 1 genes in [0, 1].

    Sub-workspace evolved trajectories, section II-B. The tool goes straight from one via point to the next, blended.
    """

    cell: Cell
    points: int = 6
    settings: Settings = field(default_factory=Settings)
    slowest: float = 0.2
    """The speed at gene 0, as a share of that at gene 1, which is that of the settings."""
    closed: bool = True
    """The last move leads back to the first via point, so that the motion can be repeated."""

    @property
    def size(self) -> int:
        """The number of genes."""
        return self.points * self.cell.genes + 1

    def motions(self, genes: Array, samples: int, threads: int = 1) -> Motions:
        """The motions of genes (B, size), each sampled evenly over its own duration."""
        each = genes[:, :-1].reshape(len(genes), self.points, -1)
        if self.closed:
            each = np.concatenate([each, each[:, :1]], axis=1)
        share = self.slowest + (1.0 - self.slowest) * genes[:, -1]
        paces = [self.settings.scaled(float(s), float(s)) for s in share]
        return self.cell.straight(*self.cell.via_points(each), paces, samples, threads=threads)


def joint_moves(
    limits: JointLimits, points: ArrayLike, settings: Settings | Sequence[Settings] | None = None, samples: int = 1000
) -> Motions:
    """Joint moves through postures (B, K, n) or (K, n): all joints start and stop together, blended at the postures.

    The slowest joint of a move goes at `joint_share` of its speed limit; `zone` does not apply.
    """
    given = np.asarray(points, dtype=np.float64)
    postures = np.ascontiguousarray(given[None] if given.ndim == 2 else given)
    B, _, n = postures.shape
    each = [settings or Settings()] * B if not isinstance(settings, Sequence) else list(settings)
    time, ended = np.zeros((B, samples)), np.zeros(B, dtype=np.int64)
    q, qd, qdd = (np.zeros((B, samples, n)) for _ in range(3))
    pace = np.array([[s.joint_share, s.ramp, s.rounding, s.fly] for s in each])
    joint_programs(postures, pace, limits.speed, limits.acceleration, time, q, qd, qdd, ended)
    return overridden(Motions(time, q, qd, qdd, failures(ended)), each)
