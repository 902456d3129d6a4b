# SPDX-License-Identifier: Apache-2.0
"""An excitation that an arm can perform: designed within its limits and clear of collision, checked densely, extended.

The search keeps away from obstacles by a penalty on simple shapes; the result is checked on the real ones, densely.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.compiled import clock
from trueup.errors import IdentificationError
from trueup.excitation.cell import Settings
from trueup.excitation.criteria import Criterion
from trueup.excitation.design import Excitation, Options, Told, design
from trueup.excitation.expectation import as_motions
from trueup.excitation.feasibility import Feasibility, spread
from trueup.excitation.limits import JointLimits
from trueup.excitation.mixture import class_length, local_classes, mixed, wide_classes
from trueup.excitation.periodic import Fourier, MotionClass, Sines, at_rest, joint_box
from trueup.excitation.planner import ViaPoints
from trueup.excitation.proximity import SOFT, Proxies, Proximity
from trueup.excitation.trajectories import RATE, Trajectory
from trueup.rounding import PRINTED

_SHARES = (1.0, 0.75, 0.55, 0.4, 0.3, 0.2, 0.1)
_ONE_PASS, _LONGEST = 12.0, 20.0
"""s up to which a series is one pass; longer ones are passes of this many s at most, at several speeds."""
_MIXED = 20.0
"""s from which on there is time for a mix: five motions of some 4 s with the ways to them and back."""
_ENOUGH = 0.1
"""Share of random motions that must be clear for a range to be searched."""


@dataclass(frozen=True)
class Wish:
    """What excitation is asked for."""

    motion: str = "mix"
    """'mix' of classes and speeds (see mixture), or one class: 'fourier', 'via-points' or 'sines'."""
    duration: float = 30.0
    """s in all, about."""
    via_points: int = 6
    settings: Settings | None = None
    rate: float = RATE
    """Hz of the trajectory."""
    spare: float = 0.95
    """Share of the limits of range, speed and acceleration that is used."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """A feasible excitation and how it came about."""

    trajectory: Trajectory
    excitation: Excitation
    passes: tuple[float, ...]
    """How many times slower than designed each pass over the path is."""
    clearance: float
    """m; inf where nothing was checked."""
    nearest: str
    notes: tuple[str, ...]
    mix: str = ""
    """Classes of motion with the time that each got, in words."""


def excite(
    criterion: Criterion, feasibility: Feasibility, wish: Wish | None = None, options: Options | None = None, *,
    told: Told | None = None,
) -> Outcome:  # fmt: skip
    """The best motion that keeps all limits. Raises IdentificationError where none is found, with what stood in the way."""
    asked, chosen = wish or Wish(), options or Options(samples=1000)
    limits = feasibility.limits.within(range_share=asked.spare, speed_share=asked.spare)
    limits = replace(limits, acceleration=limits.acceleration * asked.spare)
    joints, rng, notes = criterion.model.tree.joints, np.random.default_rng(chosen.seed), list[str]()
    if asked.motion == "mix":
        if asked.duration >= _MIXED:
            return _mixed(criterion, feasibility, asked, limits, rng, told)
        notes.append(f"a mix of motions takes {_MIXED:g} s: one class of motion was searched instead")
        asked = replace(asked, motion="fourier")
    kind, said = _kind(asked, limits, feasibility, joints, rng)
    trajectory, found = _feasible(kind, criterion, feasibility, asked, chosen, limits, told)
    passes = _passes(trajectory.duration, asked)
    whole, closed = trajectory, np.abs(trajectory.q[-1] - trajectory.q[0]).max() < PRINTED
    for k, factor in enumerate(passes[1:], 1):  # a path that does not end where it begins is gone back
        again = trajectory.slower(factor).sampled(asked.rate)
        whole = whole.then(again if closed or k % 2 == 0 else again.back())
    distance, parts, _ = feasibility.nearest(spread(whole)[1])
    return Outcome(whole, found, passes, distance, parts, (*notes, *said))


def _mixed(
    criterion: Criterion, feasibility: Feasibility, wish: Wish, limits: JointLimits, rng: np.random.Generator,
    told: Told | None,
) -> Outcome:  # fmt: skip
    """Motions of several classes, each from one posture and back to it. Raises IdentificationError where none is found."""
    began, cpu, joints = time.perf_counter(), time.process_time(), criterion.model.tree.joints
    free, start, notes = _free(replace(wish, motion="fourier"), limits, feasibility, joints, rng)
    length = class_length(wish.duration)
    if feasibility.cell is not None:
        cell = replace(feasibility.cell, limits=limits)
        classes = local_classes(cell, free, wish.settings or Settings(), length, wish.rate)
    else:
        classes = wide_classes(limits, start, free, length=length, rate=wish.rate, clear=feasibility.clear_way)
    parts = mixed(classes, criterion, wish.duration, rng, allowed=feasibility.slowed, told=told)
    whole = parts[0]
    for part in parts[1:]:
        whole = whole.then(part)
    whole = replace(whole, name="excitation")
    if problems := feasibility.problems(whole):
        raise IdentificationError(f"the mix of motions breaks limits: {'; '.join(str(p) for p in problems)}")
    distance, pair, _ = feasibility.nearest(spread(whole)[1])
    judged = as_motions(whole)
    found = Excitation(
        whole, np.zeros(0), float(criterion.losses(judged)[0]), float(criterion.printed(judged)[0]), (), len(parts),
        time.perf_counter() - began, time.process_time() - cpu,
    )  # fmt: skip
    shared = {name: sum(p.duration for p in parts if p.name == name) for name in classes}
    mix = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in shared.items() if seconds)
    return Outcome(whole, found, (1.0,), distance, pair, notes, mix)


def _feasible(
    kind: MotionClass, criterion: Criterion, feasibility: Feasibility, wish: Wish, options: Options, limits: JointLimits,
    told: Told | None,
) -> tuple[Trajectory, Excitation]:  # fmt: skip
    """The best motion that passes the dense check: by penalties that grow until it does.

    Between coarse samples, and where shapes are not capsules, a motion comes nearer than the search has seen; each
    further round keeps as much more distance as was missing. Raises IdentificationError after six.
    """
    margin, weight = feasibility.margin + 0.5 * SOFT, Proximity.weight
    starts, spare, problems, began = None, 0.0, (), clock()
    for _ in range(6):
        penalty = None
        if feasibility.clearance is not None or feasibility.cell is not None:
            penalty = Proximity(criterion.model.tree, _shapes(feasibility), margin, weight, feasibility.cell, spare)
        left = replace(options, budget=max(0.2 * options.budget, options.budget - (clock() - began)))
        excitation = design(kind, criterion, left, penalty=penalty, starts=starts, told=told, rate=wish.rate)
        trajectory = at_rest(excitation.trajectory, limits) if wish.motion == "sines" else excitation.trajectory
        trajectory = feasibility.within_torque(trajectory)
        problems = feasibility.problems(trajectory)
        if not problems:
            return trajectory, excitation
        starts, weight = excitation.genes[None], 3.0 * weight
        margin += max([0.5 * SOFT, *(p.limit - p.value for p in problems if p.kind == "collision")])
        spare += max([0.0, *(p.value - p.limit + SOFT / 4 for p in problems if p.kind == "region")])
    left_over = "; ".join(str(p) for p in problems)
    raise IdentificationError(
        f"no motion was found that keeps all limits; what remains: {left_over}; try another --seed"
    )


def _shapes(feasibility: Feasibility) -> Proxies:
    if feasibility.clearance is not None:
        return Proxies(*feasibility.clearance.shapes())  # type: ignore[arg-type]
    none, pairs = np.zeros((0, 3)), np.zeros((0, 2), dtype=np.int64)
    return Proxies(np.zeros(0, dtype=np.int64), none, none, np.zeros(0), none, np.zeros((0, 3, 3)), none, pairs, pairs)


def home(limits: JointLimits, feasibility: Feasibility, joints: tuple[str, ...], rng: np.random.Generator) -> Array:
    """(n,) a posture far from collisions and from the ends of the ranges, with room around it."""
    middle, half = limits.middle, limits.reach
    q = middle + rng.uniform(-0.6, 0.6, (600, len(joints))) * half
    q[0] = middle
    if feasibility.clearance is None:
        return middle
    distance, _ = feasibility.clearance.distances(q)
    likely = np.argsort(-np.minimum(distance, 0.3))[:12]
    # Room counts more than distance: of random postures around it, how many are free?
    around = rng.uniform(-0.25, 0.25, (30, len(joints))) * half
    free = [(feasibility.clearance.distances(q[k] + around)[0] > feasibility.margin).mean() for k in likely]
    return q[likely[int(np.argmax(free))]]


def _kind(
    wish: Wish, limits: JointLimits, feasibility: Feasibility, joints: tuple[str, ...], rng: np.random.Generator
) -> tuple[MotionClass, tuple[str, ...]]:
    """The class of motion that is searched, with its range narrowed to where enough of it is free."""
    if wish.motion == "via-points":
        if feasibility.cell is None:
            raise IdentificationError("motions through via points need a region for them (--region box.toml)")
        return ViaPoints(replace(feasibility.cell, limits=limits), wish.via_points, wish.settings or Settings()), ()
    free, _, notes = _free(wish, limits, feasibility, joints, rng)
    return _series(wish, free), notes


def _free(
    wish: Wish, limits: JointLimits, feasibility: Feasibility, joints: tuple[str, ...], rng: np.random.Generator
) -> tuple[JointLimits, Array, tuple[str, ...]]:
    """Limits with ranges in which enough random motions are free, (n,) the posture about which they lie, and notes."""
    if feasibility.cell is not None:
        middle, half = joint_box(feasibility.cell)
    else:
        middle, half = home(limits, feasibility, joints, rng), limits.reach
    blocking = ""
    for share in _SHARES:
        lower, upper = np.maximum(limits.lower, middle - share * half), np.minimum(limits.upper, middle + share * half)
        narrow = replace(limits, lower=lower, upper=upper)
        kind = _series(wish, narrow)
        motions = kind.motions(rng.uniform(size=(40, kind.size)), 200)
        clear = [feasibility.slowed(motions.single(b, joints)) is not None for b in range(40)]
        if np.mean(clear) >= _ENOUGH:
            said = f"joint ranges narrowed to {100 * share:.0f} % about a free posture" if share < 1.0 else ""
            return narrow, middle, (said,) if said else ()
        for p in feasibility.problems(motions.single(0, joints)):
            blocking = str(p) if p.kind != "acceleration" and p.kind != "rest" else blocking
    hint = "; if drives give more than their nominal torque for short times, say so: --peak 2.5" * (
        "torque" in blocking
    )
    raise IdentificationError(
        f"even small motions about the posture {np.round(middle, 2).tolist()} are not possible: {blocking or 'unknown'}{hint}"
    )


def _series(wish: Wish, limits: JointLimits) -> Fourier | Sines:
    seconds = _period(wish)
    if wish.motion == "fourier":
        return Fourier.lasting(limits, seconds)
    if wish.motion == "sines":
        return Sines(limits, longest=seconds)
    raise IdentificationError(f"motion '{wish.motion}' is unknown; motions are: fourier, sines, via-points")


def _period(wish: Wish) -> float:
    """S of one pass at full speed."""
    whole = wish.duration
    return whole if whole <= _ONE_PASS else min(whole / 3.0, _LONGEST)


def _passes(seconds: float, wish: Wish) -> tuple[float, ...]:
    """Slower passes over the same path until the duration is filled: the cheapest way to tell friction from inertia."""
    left, factors = wish.duration - seconds, [1.0]
    for factor in (2.0, 1.4, 2.8, 4.0):
        if left > 0.7 * factor * seconds:
            factors.append(factor)
            left -= factor * seconds
    while left > 0.7 * seconds:
        factors.append(1.0)
        left -= seconds
    return tuple(factors)
