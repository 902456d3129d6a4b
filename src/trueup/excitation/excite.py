# SPDX-License-Identifier: Apache-2.0
"""An excitation that an arm can perform: designed within its limits and clear of collision, checked densely, extended.

The search keeps away from obstacles by a penalty on simple shapes; the result is checked on the real ones, densely.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.errors import IdentificationError
from trueup.excitation.cell import Settings
from trueup.excitation.criteria import Criterion
from trueup.excitation.design import Excitation, Options, Told, design
from trueup.excitation.feasibility import Feasibility, spread
from trueup.excitation.limits import JointLimits
from trueup.excitation.periodic import Fourier, MotionClass, Sines, at_rest, joint_box
from trueup.excitation.planner import ViaPoints
from trueup.excitation.proximity import SOFT, Proxies, Proximity
from trueup.excitation.trajectories import RATE, Trajectory

Array = NDArray[np.float64]

_SHARES = (1.0, 0.75, 0.55, 0.4, 0.3, 0.2, 0.1)
_ONE_PASS, _LONGEST = 12.0, 20.0
"""s up to which a series is one pass; longer ones are passes of this many s at most, at several speeds."""
_CLOSED = 1e-6  # rad, from the end of a path to its start
_ENOUGH = 0.1
"""Share of random motions that must be clear for a range to be searched."""


@dataclass(frozen=True)
class Wish:
    """What excitation is asked for."""

    motion: str = "fourier"
    """'fourier', 'via-points' or 'sines'."""
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
    found: Excitation
    passes: tuple[float, ...]
    """How many times slower than designed each pass over the path is."""
    clearance: float
    """m; inf where nothing was checked."""
    nearest: str
    notes: tuple[str, ...]


def excite(
    criterion: Criterion, feasibility: Feasibility, wish: Wish | None = None, options: Options | None = None, *,
    told: Told | None = None,
) -> Outcome:  # fmt: skip
    """The best motion that keeps all limits. Raises IdentificationError where none is found, with what stood in the way."""
    asked, chosen = wish or Wish(), options or Options(samples=1000)
    limits = feasibility.limits.within(range_share=asked.spare, speed_share=asked.spare)
    limits = replace(limits, acceleration=limits.acceleration * asked.spare)
    joints = criterion.model.tree.joints
    kind, notes = _kind(asked, limits, feasibility, joints, np.random.default_rng(chosen.seed))
    trajectory, found = _feasible(kind, criterion, feasibility, asked, chosen, limits, told)
    passes = _passes(trajectory.duration, asked)
    whole, closed = trajectory, np.abs(trajectory.q[-1] - trajectory.q[0]).max() < _CLOSED
    for k, factor in enumerate(passes[1:], 1):  # a path that does not end where it begins is gone back
        again = _resampled(trajectory.slower(factor), asked.rate)
        whole = whole.then(again if closed or k % 2 == 0 else again.back())
    distance, parts, _ = feasibility.nearest(spread(trajectory)[1])
    return Outcome(whole, found, passes, distance, parts, notes)


def _feasible(
    kind: MotionClass, criterion: Criterion, feasibility: Feasibility, wish: Wish, options: Options, limits: JointLimits,
    told: Told | None,
) -> tuple[Trajectory, Excitation]:  # fmt: skip
    """The best motion that passes the dense check: by penalties that grow until it does.

    Between coarse samples, and where shapes are not capsules, a motion comes nearer than the search has seen; each
    further round keeps as much more distance as was missing. Raises IdentificationError after six.
    """
    margin, weight = feasibility.margin + 0.5 * SOFT, Proximity.weight
    starts, spare, problems, began = None, 0.0, (), time.perf_counter()
    for _ in range(6):
        penalty = None
        if feasibility.clearance is not None or feasibility.cell is not None:
            penalty = Proximity(criterion.model.tree, _shapes(feasibility), margin, weight, feasibility.cell, spare)
        left = replace(options, budget=max(0.2 * options.budget, options.budget - (time.perf_counter() - began)))
        excitation = design(kind, criterion, left, penalty=penalty, starts=starts, told=told, rate=wish.rate)
        trajectory = at_rest(excitation.trajectory, limits) if wish.motion == "sines" else excitation.trajectory
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


def home(
    limits: JointLimits, feasibility: Feasibility, joints: tuple[str, ...], rng: np.random.Generator, postures: int = 600
) -> Array:  # fmt: skip
    """(n,) a posture far from collisions and from the ends of the ranges, with room around it."""
    half = np.minimum(0.5 * (limits.upper - limits.lower), np.pi)
    middle = 0.5 * (limits.upper + limits.lower)
    q = middle + rng.uniform(-0.6, 0.6, (postures, len(joints))) * half
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
    if feasibility.cell is not None:
        middle, half = joint_box(feasibility.cell)
    else:
        middle = home(limits, feasibility, joints, rng)
        half = np.minimum(0.5 * (limits.upper - limits.lower), np.pi)
    blocking = ""
    for share in _SHARES:
        lower, upper = np.maximum(limits.lower, middle - share * half), np.minimum(limits.upper, middle + share * half)
        kind = _series(wish, replace(limits, lower=lower, upper=upper))
        motions = kind.motions(rng.uniform(size=(40, kind.size)), 200)
        clear = [feasibility.allows(motions.single(b, joints)) for b in range(40)]
        if np.mean(clear) >= _ENOUGH:
            said = f"joint ranges narrowed to {100 * share:.0f} % about a free posture" if share < 1.0 else ""
            return kind, (said,) if said else ()
        for p in feasibility.problems(motions.single(0, joints)):
            blocking = str(p) if p.kind in ("collision", "region", "torque") else blocking
    raise IdentificationError(
        f"even small motions about the posture {np.round(middle, 2).tolist()} are not possible: {blocking or 'unknown'}"
    )


def _series(wish: Wish, limits: JointLimits) -> Fourier | Sines:
    seconds = _period(wish)
    if wish.motion == "fourier":
        return Fourier(limits, seconds, int(np.clip(round(0.5 * seconds), 4, 10)))
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


def _resampled(trajectory: Trajectory, rate: float) -> Trajectory:
    """At `rate` Hz, by cubic interpolation that keeps position and speed."""
    from scipy.interpolate import CubicHermiteSpline

    t = trajectory
    time = np.linspace(t.time[0], t.time[-1], int(np.ceil(t.duration * rate)) + 1)
    way = CubicHermiteSpline(t.time, t.q, t.qd)
    speed = CubicHermiteSpline(t.time, t.qd, t.qdd)
    return Trajectory(t.name, t.joints, time, way(time), speed(time), speed(time, 1))
