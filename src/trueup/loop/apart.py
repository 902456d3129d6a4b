# SPDX-License-Identifier: Apache-2.0
"""Signals that have parameters of their own are searched side by side, each by its own least squares, in the same rows.

A joint that is replayed alone feels its own drive and nothing of the others: five drives of eight parameters each are five
small problems, and none has to take short steps because another's valley bends. What signals share stays as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.loop.descent import HELD, Descent, Look
from trueup.loop.elsewhere import losses_at
from trueup.loop.problem import Problem
from trueup.loop.segment import labelled
from trueup.loop.watch import Watch
from trueup.parameters import ParameterSpace
from trueup.search.least_squares import LeastSquares
from trueup.search.robust import robust_losses

GLANCE = 2.5  # s: the least of each recording that a first look takes
_MOVED = 0.2  # of the box: parameters are moved so far to see what they change, as a limit does nothing until it is met


@dataclass(frozen=True)
class Part:
    """One signal: the residuals of a label, and the free parameters that change it and nothing else."""

    residuals: NDArray[np.intp]
    columns: NDArray[np.intp]


def apart(
    problem: Problem, space: ParameterSpace, starts: Sequence[Array], robust: float, tolerance: float = 1e-3
) -> Array:
    """(n_free,) the best that least squares come to from any of `starts` (n_free,), signal by signal; parameters that several
    signals share as in the first of them. A search ends with steps that lower its loss by less than the share `tolerance`.
    """
    return lowest_places(problem, space, starts, robust, 1, tolerance)[0]


def lowest_places(
    problem: Problem, space: ParameterSpace, starts: Sequence[Array], robust: float, count: int, tolerance: float = 1e-3
) -> list[Array]:
    """The `count` lowest places that least squares come to, each (n_free,): of every signal the lowest in the first of them,
    the next in the second, and so on. Otherwise see `apart`.
    """
    seen = problem.residuals(space.from_unit(np.stack(starts)))
    good = [start for start, residual in zip(starts, seen, strict=True) if np.isfinite(residual).all()]
    parts = parts_of(problem, space, good[:2])  # where a search begins, what a parameter does may not be seen
    lanes = [[_search(space, start, part, robust, tolerance) for part in parts] for start in good]
    if not (parts and lanes):
        return [starts[0]]
    while under_way := [lane for lane in lanes if not all(search.done for search in lane)]:
        asked = [[None if search.done else search.ask() for search in lane] for lane in under_way]
        rows = [_together(starts[0], parts, lane, asks) for lane, asks in zip(under_way, asked, strict=True)]
        residuals = np.split(
            problem.residuals(space.from_unit(np.concatenate(rows))), np.cumsum([len(r) for r in rows])
        )
        for lane, asks, seen in zip(under_way, asked, residuals, strict=False):
            for search, part, points in zip(lane, parts, asks, strict=True):
                if points is not None:
                    search.tell(points, seen[: len(points), part.residuals])
    return _lowest(problem, space, starts[0], parts, lanes)[:count]


def _lowest(
    problem: Problem,
    space: ParameterSpace,
    shared: Array,
    parts: Sequence[Part],
    lanes: Sequence[Sequence[LeastSquares]],
) -> list[Array]:
    """As many places as there are lanes, of every signal the lowest first."""
    ends = np.concatenate([_together(shared, parts, lane, [None] * len(parts)) for lane in lanes])
    residuals, places = problem.residuals(space.from_unit(ends)), np.repeat(shared[None], len(lanes), axis=0)
    for k, part in enumerate(parts):
        losses = robust_losses(residuals[:, part.residuals], min(lane[k].delta for lane in lanes))
        order = np.argsort(np.where(np.isfinite(losses), losses, np.inf), kind="stable")
        places[:, part.columns] = ends[np.ix_(order, part.columns)]
    return list(places)


def _together(
    shared: Array, parts: Sequence[Part], searches: Sequence[LeastSquares], asked: Sequence[Array | None]
) -> Array:
    """(b, n_free) rows that hold a candidate of each search; those that ask for none, or for fewer, stay where they are."""
    count = max([len(points) for points in asked if points is not None], default=1)
    rows = np.repeat(shared[None], count, axis=0)
    for part, search, points in zip(parts, searches, asked, strict=True):
        rows[:, part.columns] = search.best[0]
        if points is not None:
            rows[: len(points), part.columns] = points
    return rows


def _search(space: ParameterSpace, start: Array, part: Part, robust: float, tolerance: float) -> LeastSquares:
    free = [p for p in space.parameters if not p.frozen]
    ranges = np.array([free[k].log_range for k in part.columns])
    return LeastSquares(start[part.columns], ranges, robust=robust, least_damping=HELD, confirm=False,
                        tolerance=tolerance, reuse=0)  # fmt: skip


def parts_of(problem: Problem, space: ParameterSpace, starts: Sequence[Array]) -> list[Part]:
    """The signals that have parameters of their own, seen from any of the starts: those that change a signal by more than all
    others together, as blocks must for a search block by block to converge (D. Feingold and R. Varga, Block diagonally
    dominant matrices, Pacific J. Math. 12, 1962). An armature is felt by other joints, too, but little.
    """
    names, label = labelled(problem.segments)
    changed = np.zeros((int(space.free.sum()), len(names)))
    for start in starts:
        moved = start + np.diag(np.where(start > 0.5, -_MOVED, _MOVED))
        residuals = problem.residuals(space.from_unit(np.concatenate([start[None], moved])))
        squares = (residuals[1:] - residuals[0]) ** 2
        changed += np.sqrt(np.stack([squares[:, label == k].sum(axis=1) for k in range(len(names))], axis=1))
    changed = np.nan_to_num(changed)
    own = changed > 0.5 * changed.sum(axis=1, keepdims=True)
    columns = [np.flatnonzero(own[:, k]) for k in range(len(names))]
    return [Part(np.flatnonzero(label == k), columns[k]) for k in range(len(names)) if len(columns[k])]


def confirmed(exact: Problem, space: ParameterSpace, start: Array, point: Array, robust: float) -> bool:
    """Whether the simulator itself, in a glance at each recording, comes to no lower place from the start than `point` is.

    Joints that saturate, have play or share a delay may have their least loss elsewhere when each is replayed alone.
    """
    glance = exact.shortened(GLANCE)
    own = Descent(space, start, Watch(), robust)
    own.descend(Look("glance", glance, glance, 30.0, 15), nudge=LeastSquares.nudge)
    here, there = losses_at(exact, space, np.stack([point, own.point]))
    return bool(here <= there)
