# SPDX-License-Identifier: Apache-2.0
"""An emulated industrial motion planner: straight tool moves and joint moves through via points, blended, at a set speed.

What users of industrial arms program: a list of poses, a speed, a fly-by accuracy. Sub-workspace evolved trajectories,
section II-B, lets a commercial interpolator do this; here it is done from rest to rest with trapezoidal or rounded
speed profiles, slowed down where a joint could not follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array
from trueup.errors import ModelError
from trueup.excitation.cell import Cell, Settings, failures, overridden
from trueup.excitation.joint_moves import joint_programs
from trueup.excitation.limits import JointLimits
from trueup.excitation.trajectories import RATE, Motions, Trajectory

if TYPE_CHECKING:
    from trueup.identification.kinematic_tree import KinematicTree


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


def random_planner_motion(
    tree: KinematicTree, limits: JointLimits, rng: np.random.Generator, *, region: Cell | None = None, via_points: int = 6,
    speed: float | tuple[float, float] = (0.2, 1.0), settings: Settings | None = None, rate: float = RATE,
    range_share: float = 0.8, tries: int = 200,
) -> Trajectory:  # fmt: skip
    """A random motion of the planner from rest to rest: straight moves in a region, or joint moves over the whole range.

    `speed`: share of the settings' speed, or the range that it is drawn from. `settings.ramp` says how abrupt. Test
    cases 1 and 3 of Local identification, section III-D. Raises ModelError where no try can be performed.
    """
    chosen = settings or Settings()
    why = ""
    for _ in range(tries):
        share = float(rng.uniform(*speed)) if isinstance(speed, tuple) else float(speed)
        if region is None:
            narrow = limits.within(range_share=range_share)
            points = rng.uniform(narrow.lower, narrow.upper, (1, via_points, tree.n))
            pace = replace(chosen, joint_share=chosen.joint_share * share)
            make = lambda count, points=points, pace=pace: joint_moves(limits, points, [pace], count)  # noqa: E731
        else:
            way = region.via_points(rng.uniform(size=(1, via_points, region.genes)))
            pace = chosen.scaled(share, share)
            make = lambda count, way=way, pace=pace: region.straight(*way, [pace], count)  # noqa: E731
        coarse = make(161)
        why = coarse.failure[0]
        if not why:
            fine = make(int(np.ceil(float(coarse.duration[0]) * rate)) + 1)
            if not fine.failure[0]:
                return fine.single(0, tree.joints, "random planner motion")
    raise ModelError(f"none of {tries} random motions of the planner can be performed; the last one is {why}")
