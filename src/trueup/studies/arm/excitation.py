# SPDX-License-Identifier: Apache-2.0
"""What the arm is asked to do before it is identified: the papers' three algorithms, and a mixture of classes and speeds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from trueup.excitation.cell import Cell, Settings
from trueup.excitation.criteria import Criterion
from trueup.excitation.design import Options
from trueup.excitation.limits import JointLimits
from trueup.excitation.mixture import ToolMoves, class_length, mixed, wide_classes
from trueup.excitation.periodic import Sines, at_rest
from trueup.excitation.trajectories import Trajectory
from trueup.identification.dynamic_model import DynamicModel
from trueup.studies.arm.algorithms import (
    LONGEST,
    algorithm_a,
    algorithm_a_local,
    algorithm_b,
    random_planner_motion,
)
from trueup.studies.arm.hidden import RATE
from trueup.studies.arm.robot import NOMINAL, limits, ns16

FAST, SLOW = Settings(speed=1.0, turn=2.0), Settings(speed=0.25, turn=0.6)
"""Of algorithm B and test case 1: up to 1 m/s, or 0.25 m/s."""
GENTLE, ABRUPT = Settings(ramp=0.25), Settings(ramp=0.1)
"""Of test case 3: how suddenly the planner reaches its speed."""
_HARDER = 2.5
"""Times the usual acceleration limits that an abrupt planner asks for; drives hold three times nominal torque shortly."""


@dataclass(frozen=True, eq=False)
class Workshop:
    """The arm's model as far as its user knows it, a region, and how thoroughly excitations are searched."""

    model: DynamicModel
    limits: JointLimits
    cell: Cell
    criterion: Criterion
    population: int = 30
    generations: int = 10

    @classmethod
    def of(cls, cell: Cell, population: int, generations: int) -> Workshop:
        """The criterion is the papers' determinant (local identification, eq. 8 and 9)."""
        model = DynamicModel.with_friction(ns16())
        criterion = Criterion.of(model, NOMINAL, "D", weighting="printed")
        return cls(model, limits(), cell, criterion, population, generations)

    def designed(self, algorithm: str, settings: Settings, seed: int) -> Trajectory:
        """One excitation of algorithm 'A', 'A_local' or 'B', by the papers' genetic algorithm, from rest to rest."""
        options = Options(
            method="genetic", samples=200, population=self.population, generations=self.generations, seed=seed
        )
        if algorithm == "A":
            return algorithm_a(self.criterion, self.limits, options, RATE).trajectory
        if algorithm == "A_local":
            return algorithm_a_local(self.criterion, self.cell, options, RATE).trajectory
        return algorithm_b(self.criterion, self.cell, options, settings, rate=RATE).trajectory

    def random(self, kind: str, rng: np.random.Generator, points: int = 6) -> Trajectory:
        """A random motion of a test case's class: 'local fast', 'local slow', 'sines', 'wide gentle', 'wide abrupt'."""
        tree = self.model.tree
        if kind == "sines":
            motions = Sines(self.limits, longest=LONGEST)
            genes = rng.uniform(size=(1, motions.size))
            count = int(np.ceil(float(motions.motions(genes, 2).duration[0]) * RATE)) + 1
            return at_rest(motions.motions(genes, count).single(0, tree.joints, "sines"), self.limits, RATE)
        if kind.startswith("local"):
            settings = FAST if kind.endswith("fast") else SLOW
            return random_planner_motion(
                self.limits, rng, region=self.cell, settings=settings, via_points=points, rate=RATE
            )
        if kind.endswith("gentle"):
            return random_planner_motion(self.limits, rng, settings=GENTLE, via_points=points, rate=RATE)
        hard = replace(self.limits, acceleration=_HARDER * self.limits.acceleration)
        return random_planner_motion(hard, rng, settings=ABRUPT, via_points=points, rate=RATE)

    def mixed(self, seconds: float, rng: np.random.Generator) -> list[Trajectory]:
        """Ours: the mix of classes and speeds that `trueup excite` gives, over the whole range and in the region."""
        hard = replace(self.limits, acceleration=_HARDER * self.limits.acceleration)
        middle, length = self.limits.middle, class_length(seconds)
        wide = wide_classes(self.limits, middle, length=length, rate=RATE)
        abrupt = wide_classes(hard, middle, length=length, rate=RATE)["abrupt moves"]
        local = ToolMoves(self.cell, FAST, rate=RATE)
        return mixed({**wide, "abrupt moves": abrupt, "local moves": local}, self.criterion, seconds, rng)


def filled(seconds: float, choose: Callable[[int], Trajectory]) -> list[Trajectory]:
    """Trajectories choose(0), choose(1), ... until the time is filled; the last one is cut to it."""
    chosen: list[Trajectory] = []
    left = seconds
    while left > 0.5:
        t = choose(len(chosen))
        keep = t.time - t.time[0] <= left
        chosen.append(Trajectory(t.name, t.joints, t.time[keep], t.q[keep], t.qd[keep], t.qdd[keep]))
        left -= t.duration
    return chosen
