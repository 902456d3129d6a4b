# SPDX-License-Identifier: Apache-2.0
"""Stages of the search that hold one parameter elsewhere and have the others settle: along its profile, and off its bound.

Where parameters make up for one another, a search along slopes creeps over the stairs and ridges of their valley. A profile
(D. J. Venzon and S. H. Moolgavkar, Applied Statistics 37(1), 1988) has the others settle for each place, and so leads along
the floor of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.evidence import explained
from trueup.loop.descent import Descent, Fit, Look, last_look
from trueup.loop.elsewhere import EDGE, LOOKED_AT
from trueup.loop.limits import is_limit
from trueup.loop.probe import ROUGH, unexplained
from trueup.loop.problem import Problem
from trueup.loop.stages import Run
from trueup.loop.validate import settled_loss, settling
from trueup.loop.watch import Watch
from trueup.loop.windows import carried
from trueup.parameters import ParameterSpace

_APART = 0.05
"""Share of a limit's range between the places at which its profile is looked at."""
_TOGETHER = 4  # places that are simulated at once, and among which a loss may rise and fall again


def profiles(run: Run) -> None:
    """Looks along the profile of each time that acts from one step to the next, a delay under drives that saturate, and of
    each limit.

    Slopes along a delay are those of a stair's tread, and rates, limits and damping make up for the one at which a search
    over a coarser step or a part of the recordings has ended; a limit has none where it is not met, and ends elsewhere
    while gains are wrong, or structures wait, and a delay makes up for it, however little is left. Not where so much was
    recorded that joints are searched alone: every place would cost the engine minutes. Nor in windows: what is not replayed
    there is mostly noise at their starts, and replays that short are smooth. Nor where feet touch: all that is searched has
    cracks there, and a quadruped's profiles took most of the time and led nowhere.
    """
    if not run.looks or run.descent.search is None or run.coarse.approximate_part is not None:
        return
    if run.problem.windowed or carried(run.problem):
        return
    free = [p for p in run.descent.space.parameters if not p.frozen]
    for k, p in enumerate(free if len(free) > 1 else ()):
        if p.unit == "s" and p.scale != "log":
            width = run.look.problem.simulator.step / (p.upper - p.lower)
            if _rough(run, k, width):
                reach = min(run.profiled.get(p.name, np.inf), 0.5 * run.descent.point[k])
                _along_profile(run, k, max(reach, width), width)
                run.profiled[p.name] = width
        elif is_limit(p) and not run.later:
            _where_promised(run, k)


def _rough(run: Run, k: int, width: float) -> bool:
    """Whether slopes along the parameter do not lead over `width` of the box."""
    point = run.descent.point
    around = np.clip(point + width * np.outer([1.0, -1.0], np.arange(len(point)) == k), 0.0, 1.0)
    residuals = run.look.problem.residuals(run.descent.space.from_unit(around))
    return unexplained(around, residuals, run.descent.finished(run.look).jacobian) >= ROUGH


def _promising(problem: Problem, found: Fit, k: int) -> list[Array]:
    """Points (n_free,) with the limit `k` of the free parameters elsewhere, anywhere down or up (from one that is not met it
    may be far to one that is), and the others where slopes foretell that they settle: the best of either side, if its loss is
    foretold to be lower by more than chance than where the others settle around the limit as it is.
    """
    here = problem.residuals(found.space.from_unit(found.unit[None]))[0]
    least = settled_loss(found, np.delete(np.arange(len(found.unit)), k), here) - problem.chance(found.residual)
    away, best = np.arange(_APART, 1.0, _APART), []
    for side in (-away, away):
        places = np.clip(found.unit[k] + side, 0.0, 1.0)
        places = places[np.append(True, np.diff(places) != 0.0)]
        rows = np.repeat(found.unit[None], len(places), axis=0)
        rows[:, k] = places
        best.append(_outward(problem, found, k, met_beyond(problem, found.space, rows, here)))
    return [point for loss, point in sorted(best, key=lambda p: p[0]) if loss < least]


def _outward(problem: Problem, found: Fit, k: int, rows: Array) -> tuple[float, Array]:
    """The lowest loss among points (b, n_free), with a limit ever further out and the others where they settle, and where
    these do; some are looked at at once, as long as it falls: further out ever more of what is asked for is beyond the limit.
    """
    others, lowest, point = np.delete(np.arange(len(found.unit)), k), np.inf, found.unit
    for first in range(0, len(rows), _TOGETHER):
        some = rows[first : first + _TOGETHER]
        residuals = problem.residuals(found.space.from_unit(some))
        losses = [settled_loss(found, others, residual) for residual in residuals]
        best = int(np.argmin(losses))
        if losses[best] >= lowest:
            break
        lowest, point = losses[best], some[best].copy()
        point[others] = np.clip(point[others] + settling(found, others, residuals[best])[2], 0.0, 1.0)
    return lowest, point


def met_beyond(problem: Problem, space: ParameterSpace, rows: Array, here: Array) -> Array:
    """Those of points (b, n_free), with a limit ever further out, that replay otherwise than it does `here` (m,): up to there
    it is not met. A bisection takes less than the replays between.
    """

    def same(k: int) -> bool:
        return np.array_equal(problem.residuals(space.from_unit(rows[[k]]))[0], here)

    first, last = (len(rows), len(rows)) if same(-1) else (0, len(rows) - 1)
    while first < last:
        middle = (first + last) // 2
        first, last = (middle + 1, last) if same(middle) else (first, middle)
    return rows[first:]


def _where_promised(run: Run, k: int) -> None:
    """Goes along a limit's profile where a look with the others settled as slopes foretell promises more than chance, as long
    as it leads lower: to search with it held costs a hundred times as much as to look.
    """
    problem, gained = run.look.problem, True
    look = replace(last_look(problem, problem), tolerance=1.0, last=False)
    while gained:
        found = run.descent.finished(run.look)
        least = found.loss - problem.chance(found.residual)
        tried = (
            _held(replace(run.descent, point=point), look, k, float(point[k]), least)
            for point in _promising(problem, found, k)
        )
        lower = next((held for held in tried if held.loss < least), None)
        run.from_there(None if lower is None else lower.point)
        gained = lower is not None and run.descent.finished(run.look).loss < least


def _along_profile(run: Run, k: int, reach: float, width: float) -> None:
    descent, problem = run.descent, run.look.problem
    look = replace(last_look(problem, problem), tolerance=1.0, last=False)
    worth = problem.chance(descent.finished(run.look).residual)
    begun, best = descent.point[k], _held(descent, look, k, float(descent.point[k]))
    while reach >= 0.5 * width:
        places = np.clip(best.place + np.array([-reach, reach]), 0.0, 1.0)
        tried = [
            _held(replace(descent, point=best.point), look, k, place, best.loss - worth)
            for place in places.tolist()
            if place != best.place
        ]
        lowest = min(tried, key=lambda t: t.loss)
        if lowest.loss < best.loss - worth:
            best = lowest
        else:
            reach *= 0.5
    if best.place != begun:
        run.from_there(best.point)


@dataclass(frozen=True, eq=False)
class _Held:
    """Where a search ended with one parameter held."""

    place: float
    point: Array
    """(n_free,), the one that was held included."""
    loss: float


def _held(descent: Descent, look: Look, k: int, place: float, wanted: float = np.inf) -> _Held:
    """Where the other parameters settle with parameter `k` of the free ones held at `place` in the unit box, as long as
    slopes promise a loss below what is `wanted`.
    """
    free = [p.name for p in descent.space.parameters if not p.frozen]
    if len(free) == 1:
        return _Held(place, np.array([place]), np.inf)
    there = descent.space.from_unit(np.where(np.arange(len(free)) == k, place, descent.point))
    space = descent.space.freeze([free[k]], {free[k]: there[descent.space.index(free[k])]})
    others = replace(descent, space=space, search=None, watch=Watch())  # errors of a trial are no progress
    others.move(np.delete(descent.point, k))
    known = descent.search.jacobian if descent.search is not None else None
    if known is not None and known.shape == (look.problem.segments[-1].columns.stop, len(free)):
        others.take_up(np.delete(known, k, axis=1))  # those of a place near by, corrected by what steps show
    found = others.descend(look, confirm=False, wanted=wanted)
    return _Held(place, np.insert(others.point, k, place), found.loss)


def off_bounds(run: Run) -> None:
    """Searches again from the middle of the range of parameters that ended at a bound, and stays where it is lower.

    A body's mass and lever arm trade: the valley along which they do has an end at a bound of either, with a low ridge
    before the optimum. Not for parameters at zero, where structures end that the robot does not have, and only where
    the model replays the recordings to about their noise: elsewhere a bound is the least of what is wrong. Nor where feet
    touch: a hexapod has many at bounds until starts are corrected too, and each look took as long as eight rounds of slopes.
    """
    descent, look = run.descent, run.look
    found = descent.search
    if found is None or found.residual is None or not explained(found.residual) or carried(run.problem):
        return
    free = [p for p in descent.space.parameters if not p.frozen]
    low, high = found.point < EDGE, found.point > 1.0 - EDGE
    none = np.array([p.scale == "log" or p.lower == 0.0 for p in free])
    worth = look.problem.chance(found.residual) * len(free)
    for k in np.flatnonzero((low & ~none) | high)[:LOOKED_AT]:
        before = descent.point, descent.search, descent.near
        # First the others settle around the new place: all at once would slide back the way it came.
        descent.move(_held(descent, replace(look, tolerance=1.0, last=False), int(k), 0.5).point)
        if descent.descend(look).loss < found.loss - worth:
            return
        descent.point, descent.search, descent.near = before
