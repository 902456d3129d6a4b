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
from trueup.loop.descent import Descent, Look, explained, last_look
from trueup.loop.elsewhere import EDGE, LOOKED_AT
from trueup.loop.probe import ROUGH, unexplained
from trueup.loop.stages import Run
from trueup.parameters import Parameter


def profiles(run: Run) -> None:
    """Looks along the profile of each time that acts from one step to the next: a delay under drives that saturate.

    Slopes there are those of a stair's tread, and rates, limits and damping make up for the delay at which a search over a
    coarser step or a part of the recordings has ended. Not where so much was
    recorded that joints are searched alone: every place would cost the engine minutes.
    """
    if not run.looks or run.descent.search is None or run.coarse.approximate_part is not None:
        return
    for p in run.descent.space.parameters:
        if not p.frozen and p.unit == "s" and p.scale != "log" and len(run.descent.point) > 1:
            _along_profile(run, p)


def _along_profile(run: Run, p: Parameter) -> None:
    descent, problem = run.descent, run.look.problem
    width = problem.simulator.step / (p.upper - p.lower)
    k = [q.name for q in descent.space.parameters if not q.frozen].index(p.name)
    around = np.clip(descent.point + width * np.outer([1.0, -1.0], np.arange(len(descent.point)) == k), 0.0, 1.0)
    found = descent.finished(run.look)
    if unexplained(around, problem.residuals(descent.space.from_unit(around)), found.jacobian) < ROUGH:
        return
    look = replace(last_look(problem, problem), tolerance=1.0, last=False)
    worth = problem.chance(found.residual)
    begun, reach = descent.point[k], max(0.5 * descent.point[k], width)
    best = _held(descent, look, k, float(descent.point[k]))
    while reach >= 0.5 * width:
        places = np.clip(best.place + np.array([-reach, reach]), 0.0, 1.0)
        tried = [
            _held(replace(descent, point=best.point), look, k, place)
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


def _held(descent: Descent, look: Look, k: int, place: float) -> _Held:
    """Where the other parameters settle with parameter `k` of the free ones held at `place` in the unit box."""
    free = [p.name for p in descent.space.parameters if not p.frozen]
    if len(free) == 1:
        return _Held(place, np.array([place]), np.inf)
    there = descent.space.from_unit(np.where(np.arange(len(free)) == k, place, descent.point))
    space = descent.space.freeze([free[k]], {free[k]: there[descent.space.index(free[k])]})
    others = replace(descent, space=space, point=np.delete(descent.point, k), search=None)
    found = others.descend(look, confirm=False)
    return _Held(place, np.insert(others.point, k, place), found.loss)


def off_bounds(run: Run) -> None:
    """Searches again from the middle of the range of parameters that ended at a bound, and stays where it is lower.

    A body's mass and lever arm trade: the valley along which they do has an end at a bound of either, with a low ridge
    before the optimum. Not for parameters at zero, where structures end that the robot does not have, and only where
    the model replays the recordings to about their noise: elsewhere a bound is the least of what is wrong.
    """
    descent, look = run.descent, run.look
    found = descent.search
    if found is None or found.residual is None or not explained(found.residual):
        return
    free = [p for p in descent.space.parameters if not p.frozen]
    low, high = found.point < EDGE, found.point > 1.0 - EDGE
    none = np.array([p.scale == "log" or p.lower == 0.0 for p in free])
    worth = look.problem.chance(found.residual) * len(free)
    for k in np.flatnonzero((low & ~none) | high)[:LOOKED_AT]:
        before = descent.point, descent.search, descent.near
        # First the others settle around the new place: all at once would slide back the way it came.
        descent.point = _held(descent, replace(look, tolerance=1.0, last=False), int(k), 0.5).point
        if descent.descend(look).loss < found.loss - worth:
            return
        descent.point, descent.search, descent.near = before
