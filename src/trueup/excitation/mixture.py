# SPDX-License-Identifier: Apache-2.0
"""A mix of motions: classes and speeds share the time equally, each with those after which torque is best predicted.

What one class of motion hardly asks (friction at creeping speed, inertia in abrupt starts) another does. On a stand-in
arm (`trueup.studies.arm`) no motion optimised within one class predicts the torque of all others as well.
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
from trueup.excitation.periodic import Fourier, MotionClass, Sines, at_rest
from trueup.excitation.planner import ViaPoints, joint_moves
from trueup.excitation.trajectories import RATE, Motions, Trajectory

Draw = Callable[[np.random.Generator], "Trajectory | None"]
"""A random motion of one class from rest to rest; None where the draw cannot be performed."""
Allowed = Callable[[Trajectory], "Trajectory | None"]
"""The motion as it may be performed (slower, say), or None."""

Clear = Callable[[Array, Array], bool]
"""Whether a joint move from one posture to another meets nothing."""

GENTLE, ABRUPT = Settings(ramp=0.25), Settings(ramp=0.1)
"""How suddenly a planner reaches its speed: local identification, section III-D."""
_NEAR, _CREEP = 0.3, (0.03, 0.3)
"""Of slow joint moves: share of the range, since they take long, and of the top speeds."""
_SLOW = (0.25, 0.3)
"""Of the tool's speeds on slow moves: 0.25 m/s and 0.6 rad/s of the study's 1 and 2."""
_LOOKS = 20
"""Random postures from which one is taken that can be reached."""
_HARMONICS, _FASTER = 4, 1.5
"""Terms of a Fourier series; the fastest sine over the slowest at least."""
_DRAWS = 200
"""Motions of a class that are drawn at most."""
_OTHERS = 3
"""Motions of each class that stand for what shall be predicted; they are not chosen where there are more."""
_SAMPLED = 300
"""Samples of a motion from which it is judged what it tells."""


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
            others = (rng.uniform(self.among.lower, self.among.upper) for _ in range(_LOOKS))
            free = next((q for q in others if self.clear is None or self.clear(way[-1], q)), None)
            if free is None:
                return None
            way.append(free)
        while self.clear is not None and len(way) > 1 and not self.clear(way[-1], self.home):
            way.pop()
        pace = replace(self.settings, joint_share=self.settings.joint_share * rng.uniform(*self.speeds))
        points = np.stack([*way, self.home])
        return _sampled(lambda count: joint_moves(self.limits, points, [pace], count), self.limits.joints, self.rate)


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
        return _sampled(lambda count: kind.motions(genes, count), self.cell.limits.joints, self.rate)


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
        motion = _sampled(lambda count: self.kind.motions(genes, count), joints, rate)
        if motion is None:
            return None
        motion = at_rest(motion, self.limits, rate)
        there, back = (link(self.limits, *ends, rate) for ends in ((self.home, motion.q[0]), (motion.q[-1], self.home)))
        return None if there is None or back is None else there.then(motion).then(back)


def class_length(seconds: float) -> float:
    """S of a series where five classes share `seconds`: with the ways to it and back it fits into a fifth of them."""
    return float(np.clip(0.7 * seconds / 5.0, 2.0, 8.0))


def link(limits: JointLimits, start: Array, end: Array, rate: float = RATE) -> Trajectory | None:
    """A joint move from one posture to another."""
    if np.abs(end - start).max() < 1e-9:
        still = np.zeros((2, len(start)))
        return Trajectory("link", limits.joints, np.array([0.0, 1.0 / rate]), start + still, still, still)
    return _sampled(lambda count: joint_moves(limits, np.stack([start, end]), samples=count), limits.joints, rate)


def _sampled(make: Callable[[int], Motions], joints: tuple[str, ...], rate: float) -> Trajectory | None:
    coarse = make(161)
    if not coarse.possible[0]:
        return None
    fine = make(int(np.ceil(float(coarse.duration[0]) * rate)) + 1)
    return fine.single(0, joints) if fine.possible[0] else None


def wide_classes(
    limits: JointLimits, home: Array, free: JointLimits | None = None, *, length: float = 8.0, rate: float = RATE,
    share: float = 0.8, clear: Clear | None = None,
) -> dict[str, Draw]:  # fmt: skip
    """Motions over a share of the joints' ranges, from a posture and back to it; series and sines of about `length` s.

    Of those only where they are `free`: moves are looked for one by one.
    """
    around = (free or limits).within(range_share=share)
    return {
        "series": Series(Fourier(around, length, _HARMONICS), limits, home, rate),
        "sines": Series(_sines(around, 1.25 * length), limits, home, rate),
        "slow moves": Moves(
            limits, around.within(range_share=_NEAR), home, GENTLE, speeds=_CREEP, clear=clear, rate=rate
        ),
        "gentle moves": Moves(limits, limits.within(range_share=share), home, GENTLE, clear=clear, rate=rate),
        "abrupt moves": Moves(limits, limits.within(range_share=share), home, ABRUPT, clear=clear, rate=rate),
    }


def _sines(limits: JointLimits, longest: float) -> Sines:
    """Sums of sines over as much of the ranges as speed and acceleration allow within `longest` s."""
    w = _FASTER * 2.0 * np.pi / longest
    reach = np.minimum(0.5 * (limits.upper - limits.lower), np.minimum(limits.acceleration / w**2, limits.speed / w))
    return Sines(limits, reach=np.minimum(reach, np.pi), longest=longest)


def local_classes(
    cell: Cell, limits: JointLimits, settings: Settings, length: float = 8.0, rate: float = RATE
) -> dict[str, Draw]:
    """Motions with the tool in a region, from its middle and back; `limits`: ranges of the joints that keep it there."""
    slow, abrupt = settings.scaled(*_SLOW), replace(settings, ramp=ABRUPT.ramp)
    return {
        "series": Series(Fourier(limits, length, _HARMONICS), cell.limits, cell.posture, rate),
        "sines": Series(_sines(limits, 1.25 * length), cell.limits, cell.posture, rate),
        "slow moves": ToolMoves(cell, slow, rate=rate),
        "fast moves": ToolMoves(cell, settings, rate=rate),
        "abrupt moves": ToolMoves(cell, abrupt, rate=rate),
    }


def mixed(
    classes: Mapping[str, Draw], criterion: Criterion, seconds: float, rng: np.random.Generator, *,
    allowed: Allowed | None = None, tries: int = 12, budget: float = np.inf, told: Told | None = None,
) -> list[Trajectory]:  # fmt: skip
    """The time shared equally by all classes, in each the motions after which torque is best predicted.

    Greedily from `tries` random motions, by the mean variance of predicted torque (over nominal) on others of all classes.
    Raises IdentificationError where the time is too short.
    """
    pools, began = {}, time.perf_counter()
    for k, (kind, draw) in enumerate(classes.items(), 1):
        until = began + budget * k / len(classes)
        pools[kind] = _drawn(kind, draw, criterion, rng, allowed, tries + _OTHERS, until)
        if told is not None:
            seen = sum(len(pool) for pool in pools.values())
            told(Step(float("nan"), seen, time.perf_counter() - began, k / len(classes)))
    pools = {kind: pool for kind, pool in pools.items() if pool}
    if not pools:
        raise IdentificationError("no motion of any class can be performed")
    target = np.sum([M / t.duration for pool in pools.values() for t, M in pool[:_OTHERS]], axis=0)
    known, chosen = 1e-6 * np.diag(np.diag(target)), list[Trajectory]()
    rest = [pool[_OTHERS:] or pool for pool in pools.values()]
    for k, parts in enumerate([*rest, [part for pool in rest for part in pool]], 1):  # what is left goes to any class
        while True:
            left = seconds * min(k / len(rest), 1.0) - sum(t.duration for t in chosen)
            fitting = [part for part in parts if part[0].duration <= left and not any(part[0] is t for t in chosen)]
            if not fitting:
                break
            gains = [np.trace(np.linalg.solve(known + M, target)) for _, M in fitting]
            trajectory, M = fitting[int(np.argmin(gains))]
            known = known + M
            chosen.append(trajectory)
    if not chosen:
        raise IdentificationError(f"{seconds:g} s are too short for a mixture of {len(classes)} classes of motion")
    return chosen


def _drawn(
    kind: str,
    draw: Draw,
    criterion: Criterion,
    rng: np.random.Generator,
    allowed: Allowed | None,
    count: int,
    until: float,
) -> list[tuple[Trajectory, Array]]:
    """Motions of a class that are allowed, named by it, each with what it tells."""
    found: list[tuple[Trajectory, Array]] = []
    for _ in range(_DRAWS):
        t = draw(rng)
        t = t if t is None or allowed is None else allowed(t)
        if t is not None:
            found.append((replace(t, name=kind), _information(criterion, t)))
        if len(found) == count or time.perf_counter() > until:
            break
    return found


def _information(criterion: Criterion, t: Trajectory) -> Array:
    """(c, c) what a trajectory tells of the base parameters, rows over nominal torque, summed over all its samples."""
    every = max(1, len(t.time) // _SAMPLED)
    sampled = (t.q[None, ::every], t.qd[None, ::every], t.qdd[None, ::every])
    return every * criterion.model.information(*sampled, 1.0 / criterion.torque, criterion.independent)[0]
