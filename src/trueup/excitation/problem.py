# SPDX-License-Identifier: Apache-2.0
"""From a model file and a few wishes to an excitation problem: tree, limits, criterion, region, options."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trueup.arrays import Array
from trueup.cores import cores
from trueup.errors import ModelError
from trueup.excitation.cell import Cell, Settings
from trueup.excitation.chain import Chain
from trueup.excitation.criteria import Criterion, Friction, Kind
from trueup.excitation.design import Options
from trueup.excitation.excite import Wish
from trueup.excitation.feasibility import Clearance, Feasibility
from trueup.excitation.limits import JointLimits
from trueup.excitation.periodic import Fourier
from trueup.excitation.planner import ViaPoints
from trueup.excitation.regions import Region
from trueup.excitation.trajectories import RATE
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.model_file import load_tree
from trueup.identification.regressors import inverse_dynamics


@dataclass(frozen=True)
class Asked:
    """What a user asks of an excitation; SI units."""

    motion: str = "mix"
    region: str | None = None
    """A region file."""
    limits: str | None = None
    """A limits file."""
    peak: float = 1.0
    """Times the nominal torque that drives give for short times."""
    lock: tuple[str, ...] = ()
    via_points: int = 6
    speed: float = 1.0
    duration: float | None = None
    criterion: Kind = "D"
    friction: Friction = "with"
    margin: float = 0.02
    rate: float = RATE
    budget: float = 20.0
    seed: int = 0
    gravity: tuple[float, ...] | None = None
    """(3,) m/s^2 in the base frame; None: as the model has it."""


@dataclass(frozen=True, eq=False)
class ExcitationProblem:
    """All that `excite` needs, and what was assumed."""

    criterion: Criterion
    feasibility: Feasibility
    wish: Wish
    options: Options
    chain: Chain
    """To the tool."""
    notes: tuple[str, ...]


def clearance_for(model: str | Path, joints: Sequence[str], floor: float | str | None = "auto") -> Clearance:
    """What tells how far the parts of a model are from each other at postures of these joints. Raises ModelError."""
    from trueup.engines.mujoco.clearance import MujocoClearance
    from trueup.engines.mujoco.model import load

    return MujocoClearance.of(load(Path(model)), joints, floor=floor)


def excitation_problem(
    path: str | Path, asked: Asked, clearance: Callable[[tuple[str, ...]], Clearance] | None = None
) -> ExcitationProblem:
    """Reads the model, the region and the limits; `clearance` makes what measures distances for named joints.

    Raises ModelError and UnknownNameError.
    """
    whole = load_tree(path)
    tree, notes = _arm(whole if asked.gravity is None else whole.replace(gravity=asked.gravity), asked.lock)
    _refuse_loops(tree)
    limits = JointLimits.of(tree)
    if asked.limits:
        limits = limits.from_file(asked.limits)
    limits = limits.with_peak(asked.peak)
    region = Region.load(asked.region) if asked.region else None
    distance = clearance(tree.joints) if clearance is not None else None
    apart = None if distance is None else distance.distances
    cell = None
    if region is not None:
        cell = Cell.of(tree, region, limits, seed=asked.seed, apart=apart, margin=asked.margin)
    chain = cell.chain if cell is not None else Chain.of(tree)
    model = DynamicModel.with_friction(tree)
    try:
        parameters: Array | None = model.nominal()
    except ModelError:
        parameters = None
        notes.append("the model has links without inertia: torque is not checked")
    torque, said = _torque(tree, limits, parameters)
    criterion = Criterion.of(
        model, torque, "D" if asked.criterion == "prediction" else asked.criterion, friction=asked.friction
    )
    if asked.criterion == "prediction":
        kind = Fourier(limits, 10.0) if cell is None else ViaPoints(cell)
        genes = np.random.default_rng(asked.seed).uniform(size=(40, kind.size))
        criterion = criterion.for_motions(kind.motions(genes, 200))
    feasibility = Feasibility(limits, distance, asked.margin, model, parameters, cell, 0.0)
    settings = Settings(speed=asked.speed, turn=2.0 * asked.speed)
    wish = Wish(asked.motion, asked.duration or Wish.duration, asked.via_points, settings, asked.rate)
    options = Options(samples=1000, seed=asked.seed, budget=asked.budget, candidates=12000, threads=min(4, cores()))
    more = (*(() if cell is None else cell.notes), *(() if distance is None else distance.notes))
    return ExcitationProblem(
        criterion, feasibility, wish, options, chain, (*notes, *tree.notes, *limits.notes, *said, *more)
    )


def _refuse_loops(tree: KinematicTree) -> None:
    """Raises ModelError where joints that would move are in a loop: no mechanism could follow them one by one."""
    for loop in tree.loops:
        moved = [joint for joint in loop if joint in tree.joints]
        if moved:
            raise ModelError(
                f"the model closes a loop over {', '.join(loop)}, so that {', '.join(moved)} cannot move freely: motions are "
                "designed for arms without loops. Lock them (--lock), or take <connect> and <weld> out where the arm has none"
            )


def _arm(tree: KinematicTree, lock: tuple[str, ...]) -> tuple[KinematicTree, list[str]]:
    """The tree with locked joints, and without fingers and other joints beside the chain to the last link."""
    tree = tree.lock(lock)
    beside = [joint for joint in tree.joints if joint not in Chain.of(tree).joints]
    if not beside:
        return tree, []
    return tree.lock(beside), [f"joints beside the arm are held where they are: {', '.join(beside)}"]


def _torque(tree: KinematicTree, limits: JointLimits, parameters: Array | None) -> tuple[Array, tuple[str, ...]]:
    """(n,) nominal torques; where the model has none, what the arm's own weight and motion take, and said."""
    unknown = np.isnan(limits.torque)
    if not unknown.any():
        return limits.torque, ()
    if parameters is None:
        return np.where(unknown, 1.0, limits.torque), ("no torque limits and no inertia: all joints count alike",)
    kind = Fourier(limits.within(range_share=0.9), 8.0)
    m = kind.motions(np.random.default_rng(0).uniform(size=(20, kind.size)), 100)
    q, qd, qdd = (x.reshape(-1, tree.n) for x in (m.q, m.qd, m.qdd))
    taken = np.abs(inverse_dynamics(tree, tree.weighed(), q, qd, qdd)).max(axis=0)
    made = np.where(unknown, np.maximum(taken, 1e-3 * taken.max()), limits.torque)
    said = "torque limits not in the model are taken as what fast motions need: " + ", ".join(
        f"{joint} {value:.3g}" for joint, value in zip(tree.joints, made, strict=True)
    )
    return made, (said,)
