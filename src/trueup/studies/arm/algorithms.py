# SPDX-License-Identifier: Apache-2.0
"""The papers' excitations: algorithms A, A_local and B, and the random motions of a planner on which they are tested."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueup.errors import ModelError
from trueup.excitation.cell import Cell, Settings
from trueup.excitation.criteria import Criterion
from trueup.excitation.design import Excitation, Options, design
from trueup.excitation.limits import JointLimits
from trueup.excitation.mixture import sampled
from trueup.excitation.periodic import Sines, at_rest, joint_box
from trueup.excitation.planner import ViaPoints, joint_moves
from trueup.excitation.trajectories import RATE, Trajectory

LONGEST = 10.0  # s of a sum of sines
_TRIES = 200


def algorithm_a(criterion: Criterion, limits: JointLimits, options: Options, rate: float = RATE) -> Excitation:
    """Sums of sines over the whole range (Local identification, section II-1), with a start and a stop."""
    return _rested(design(Sines(limits, longest=LONGEST), criterion, options, name="A", rate=rate), limits)


def algorithm_a_local(criterion: Criterion, cell: Cell, options: Options, rate: float = RATE) -> Excitation:
    """The same sums of sines bounded to the joint positions of a region (section II-3)."""
    middle, reach = joint_box(cell)
    kind = Sines(cell.limits, middle=middle, reach=reach, longest=LONGEST)
    return _rested(design(kind, criterion, options, name="A_local", rate=rate), cell.limits)


def algorithm_b(
    criterion: Criterion, cell: Cell, options: Options, settings: Settings | None = None, *, via_points: int = 6,
    rate: float = RATE,
) -> Excitation:  # fmt: skip
    """Via points in a region and one speed, through the motion planner (section II-2)."""
    return design(ViaPoints(cell, via_points, settings or Settings()), criterion, options, name="B", rate=rate)


def random_planner_motion(
    limits: JointLimits, rng: np.random.Generator, *, region: Cell | None = None, via_points: int = 6,
    speed: tuple[float, float] = (0.2, 1.0), settings: Settings | None = None, rate: float = RATE,
) -> Trajectory:  # fmt: skip
    """A random motion of the planner from rest to rest: straight moves in a region, or joint moves over the range.

    `speed`: the range that its share of the settings' speed is drawn from. `settings.ramp` says how abrupt. Test cases 1
    and 3 of Local identification, section III-D. Raises ModelError where none of many can be performed.
    """
    chosen, narrow = settings or Settings(), limits.within(range_share=0.8)
    for _ in range(_TRIES):
        share = float(rng.uniform(*speed))
        if region is None:
            points = rng.uniform(narrow.lower, narrow.upper, (1, via_points, len(limits.joints)))
            pace = replace(chosen, joint_share=chosen.joint_share * share)
            motion = sampled(lambda count, p=points, s=pace: joint_moves(limits, p, [s], count), limits.joints, rate)
        else:
            way = region.via_points(rng.uniform(size=(1, via_points, region.genes)))
            pace = chosen.scaled(share, share)
            motion = sampled(lambda count, w=way, s=pace: region.straight(*w, [s], count), limits.joints, rate)
        if motion is not None:
            return replace(motion, name="random planner motion")
    raise ModelError(f"none of {_TRIES} random motions of the planner can be performed")


def _rested(excitation: Excitation, limits: JointLimits) -> Excitation:
    return replace(excitation, trajectory=at_rest(excitation.trajectory, limits))
