# SPDX-License-Identifier: Apache-2.0
"""A mix of motions: of random ones of several classes and speeds those that together tell the parameters best.

What one class of motion hardly asks another does; how much of each is performed, the information decides. Many different
short motions show each structure that the model may lack (drives that are coupled, say) in every part of the log, so that
parts left out of a fit agree about it: a part that is unlike all others hides it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.errors import IdentificationError
from trueup.excitation.cell import Cell, Settings
from trueup.excitation.criteria import Criterion
from trueup.excitation.design import Step, Told
from trueup.excitation.limits import JointLimits
from trueup.excitation.periodic import Fourier, MotionClass, at_rest
from trueup.excitation.planner import ViaPoints, joint_moves
from trueup.excitation.trajectories import RATE, SAMPLED, Motions, Trajectory
from trueup.identification.information import log_determinants
from trueup.rounding import NEGLIGIBLE, ROUNDED

Draw = Callable[[np.random.Generator], "Trajectory | None"]
"""A random motion of one class from rest to rest; None where the draw cannot be performed."""
Allowed = Callable[[Trajectory], "Trajectory | None"]
"""The motion as it may be performed (slower, say), or None."""

Clear = Callable[[Array, Array], bool]
"""Whether a joint move from one posture to another meets nothing."""

GENTLE, ABRUPT = Settings(ramp=0.25), Settings(ramp=0.1)
"""How suddenly a planner reaches its speed: local identification, section III-D."""
_DRAWS = 200
"""Motions of a class, or postures of a motion, that are drawn at most to find what can be performed, or reached."""


@dataclass(frozen=True, eq=False)
class Moves:
    """Joint moves from a posture through random ones and back, as programs of industrial arms make them."""

    limits: JointLimits
    among: JointLimits
    """Ranges of the postures."""
    home: Array
    settings: Settings
    points: int = 4
    speeds: tuple[float, float] = (0.2, 1.0)
    """Shares of the settings' speed that are drawn from."""
    clear: Clear | None = None
    rate: float = RATE

    def __call__(self, rng: np.random.Generator) -> Trajectory | None:
        """A random one, whose straight ways from posture to posture are clear."""
        way = [self.home]
        while len(way) <= self.points:
            others = (rng.uniform(self.among.lower, self.among.upper) for _ in range(_DRAWS))
            free = next((q for q in others if self.clear is None or self.clear(way[-1], q)), None)
            if free is None:
                return None
            way.append(free)
        while self.clear is not None and len(way) > 1 and not self.clear(way[-1], self.home):
            way.pop()
        pace = replace(self.settings, joint_share=self.settings.joint_share * rng.uniform(*self.speeds))
        points = np.stack([*way, self.home])
        return sampled(lambda count: joint_moves(self.limits, points, [pace], count), self.limits.joints, self.rate)


@dataclass(frozen=True, eq=False)
class ToolMoves:
    """Straight moves of the tool in a region, from its middle and back."""

    cell: Cell
    settings: Settings
    points: int = 4
    rate: float = RATE

    def __call__(self, rng: np.random.Generator) -> Trajectory | None:
        """A random one."""
        kind = ViaPoints(self.cell, self.points, self.settings)
        genes = rng.uniform(size=(1, kind.size))
        genes[0, : self.cell.genes] = 0.5
        return sampled(lambda count: kind.motions(genes, count), self.cell.limits.joints, self.rate)


@dataclass(frozen=True, eq=False)
class Series:
    """Random motions of a class of series, reached from a posture and left to it by joint moves."""

    kind: MotionClass
    limits: JointLimits
    home: Array
    rate: float = RATE

    def __call__(self, rng: np.random.Generator) -> Trajectory | None:
        """A random one."""
        rate, joints, genes = self.rate, self.limits.joints, rng.uniform(size=(1, self.kind.size))
        motion = sampled(lambda count: self.kind.motions(genes, count), joints, rate)
        if motion is None:
            return None
        motion = at_rest(motion, self.limits, rate)
        there, back = (link(self.limits, *ends, rate) for ends in ((self.home, motion.q[0]), (motion.q[-1], self.home)))
        return None if there is None or back is None else there.then(motion).then(back)


def class_length(seconds: float) -> float:
    """S of a series of which, with the ways to it and back, five fit into `seconds`."""
    return float(np.clip(0.7 * seconds / 5.0, 2.0, 8.0))


def link(limits: JointLimits, start: Array, end: Array, rate: float = RATE) -> Trajectory | None:
    """A joint move from one posture to another."""
    if np.abs(end - start).max() < ROUNDED:
        still = np.zeros((2, len(start)))
        return Trajectory("link", limits.joints, np.array([0.0, 1.0 / rate]), start + still, still, still)
    return sampled(lambda count: joint_moves(limits, np.stack([start, end]), samples=count), limits.joints, rate)


def sampled(make: Callable[[int], Motions], joints: tuple[str, ...], rate: float) -> Trajectory | None:
    """A motion that `make` gives at any number of samples, at `rate` Hz; None where it cannot be performed."""
    coarse = make(161)
    if not coarse.possible[0]:
        return None
    fine = make(int(np.ceil(float(coarse.duration[0]) * rate)) + 1)
    return fine.single(0, joints) if fine.possible[0] else None


def wide_classes(
    limits: JointLimits, home: Array, free: JointLimits | None = None, *, length: float = 8.0, rate: float = RATE,
    clear: Clear | None = None,
) -> dict[str, Draw]:  # fmt: skip
    """Motions over most of the joints' ranges, from a posture and back to it; series of about `length` s.

    Of those only where they are `free`: moves are looked for one by one.
    """
    among, around = (x.within(range_share=0.8) for x in (limits, free or limits))
    return {
        "series": Series(Fourier.lasting(around, length), limits, home, rate),
        "gentle moves": Moves(limits, among, home, GENTLE, clear=clear, rate=rate),
        "abrupt moves": Moves(limits, among, home, ABRUPT, clear=clear, rate=rate),
    }


def local_classes(
    cell: Cell, limits: JointLimits, settings: Settings, length: float = 8.0, rate: float = RATE
) -> dict[str, Draw]:
    """Motions with the tool in a region, from its middle and back; `limits`: ranges of the joints that keep it there."""
    return {
        "series": Series(Fourier.lasting(limits, length), cell.limits, cell.posture, rate),
        "fast moves": ToolMoves(cell, settings, rate=rate),
        "abrupt moves": ToolMoves(cell, replace(settings, ramp=ABRUPT.ramp), rate=rate),
    }


def mixed(
    classes: Mapping[str, Draw], criterion: Criterion, seconds: float, rng: np.random.Generator, *,
    allowed: Allowed | None = None, told: Told | None = None,
) -> list[Trajectory]:  # fmt: skip
    """Of 15 random motions of each class those that together tell the base parameters best, until the time is filled.

    Greedily by what each adds to log det of their information (D-optimality) for a second that it takes: how much each class
    gets follows from that. Raises IdentificationError where the time is too short.
    """
    began, pool, chosen = time.perf_counter(), list[tuple[Trajectory, Array]](), list[Trajectory]()
    for k, (kind, draw) in enumerate(classes.items(), 1):
        pool += _candidates(kind, draw, criterion, rng, allowed)
        if told is not None:
            told(Step(float("nan"), len(pool), time.perf_counter() - began, k / len(classes)))
    if not pool:
        raise IdentificationError("no motion of any class can be performed")
    # So much is known before the first, parameter by parameter: a determinant needs full rank.
    known = NEGLIGIBLE * np.diag(np.sum([np.diag(M) for _, M in pool], axis=0))
    while pool := [(t, M) for t, M in pool if t.duration <= seconds - sum(c.duration for c in chosen)]:
        gained = log_determinants(np.stack([known + M for _, M in pool])) - log_determinants(known[None])
        trajectory, M = pool.pop(int(np.argmax(gained / np.array([t.duration for t, _ in pool]))))
        known = known + M
        chosen.append(trajectory)
    if not chosen:
        raise IdentificationError(f"{seconds:g} s are too short for a mixture of {len(classes)} classes of motion")
    return chosen


def _candidates(
    kind: str, draw: Draw, criterion: Criterion, rng: np.random.Generator, allowed: Allowed | None
) -> list[tuple[Trajectory, Array]]:  # fmt: skip
    """Motions of a class that are allowed, named by it, each with what it tells."""
    count, found = 15, list[tuple[Trajectory, Array]]()
    for _ in range(_DRAWS):
        t = draw(rng)
        t = t if t is None or allowed is None else allowed(t)
        if t is not None:
            found.append((replace(t, name=kind), _information(criterion, t)))
        if len(found) == count:
            break
    return found


def _information(criterion: Criterion, t: Trajectory) -> Array:
    """(c, c) what a trajectory tells of the base parameters, rows over nominal torque, summed over all its samples."""
    every = max(1, len(t.time) // SAMPLED)
    sampled = (t.q[None, ::every], t.qd[None, ::every], t.qdd[None, ::every])
    return every * criterion.model.information(*sampled, 1.0 / criterion.torque, criterion.independent)[0]
