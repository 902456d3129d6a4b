# SPDX-License-Identifier: Apache-2.0
"""Signals that have parameters of their own are searched apart, each by its own least squares on its own residuals.

A joint that is replayed alone feels its own drive and nothing of the others: five drives of eight parameters each are five
small problems, and none has to take short steps because another's valley bends. What signals share either stays as it is, or
each has its word on it: with a delay held at none, drives make up for it by friction and stiffness several times too large,
from where no slope leads back. Each then searches a copy, and the copies agree on the mean that is weighted by what each
knows (consensus of S. Boyd et al., Foundations and Trends in Machine Learning 3(1), 2011, in one round).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.loop.descent import HELD, Descent, Look, Watch
from trueup.loop.elsewhere import losses_at
from trueup.loop.problem import Problem
from trueup.loop.segment import labelled
from trueup.parameters import ParameterSpace
from trueup.search.least_squares import LeastSquares
from trueup.search.robust import robust_losses

GLANCE = 2.5  # s: the least of each recording that a first look takes
_MOVED = (
    0.2  # share of the box by which parameters are moved to see what they change: a limit has no slope until it is met
)
_OTHERS = 0.01
"""Of what a parameter changes in one signal: what it may change in others and be called its own. A rotor's inertia makes the
dry friction of other joints softer or harder, by 1e-4 of what it does to its own joint.
"""
_HARDLY = 1e-6
"""Least damping once all data are in. What a joint feels that carries nothing has a scale by its rigid inertia alone:
stiffness, friction, damping and the rotor's inertia, held by `HELD`, stayed three times too large together.
"""
_VAGUE = 1.0  # curvature, in the unit box, that holds what no signal knows where it was


@dataclass(frozen=True)
class Part:
    """One signal: the residuals of a label, and the free parameters that change it and nothing else."""

    label: str
    """'' for all as one."""
    residuals: NDArray[np.intp]
    columns: NDArray[np.intp]
    shared: NDArray[np.intp]
    """Free parameters that change it and others."""


def apart(
    problem: Problem, space: ParameterSpace, starts: Sequence[Array], robust: float, tolerance: float = 1e-3, *,
    first: bool = False,
) -> Array:  # fmt: skip
    """(n_free,) the best that least squares come to from any of `starts` (n_free,), signal by signal; parameters that several
    signals share as in the first of them. A search ends with steps that lower its loss by less than the share `tolerance`.
    In a `first` look signals agree on what they share, and what they see weakly is held until all data are in.
    """
    seen = problem.residuals(space.from_unit(np.stack(starts)))
    good = [start for start, residual in zip(starts, seen, strict=True) if np.isfinite(residual).all()]
    if not good:
        return starts[0]
    chosen = []
    for part in parts_of(problem, space, good):
        columns = np.concatenate([part.columns, part.shared]) if first else part.columns
        own = _alone(problem, part.label)
        searches = [
            _searched(own, space, start, columns, robust, tolerance, HELD if first else _HARDLY) for start in good
        ]
        chosen.append((part, _lowest(searches)))
    best = _agreement(starts[0], chosen) if first else np.array(starts[0])
    for part, search in chosen:
        best[part.columns] = search.best[0][: len(part.columns)]
    return best


def _lowest(searches: Sequence[LeastSquares]) -> LeastSquares:
    """The search that has ended lowest, by a bend that is the same for all."""
    delta = min(search.delta for search in searches)
    ends = [
        np.inf if search.residual is None else robust_losses(search.residual[None], delta)[0] for search in searches
    ]
    return searches[int(np.argmin(ends))]


def _agreement(start: Array, searches: Sequence[tuple[Part, LeastSquares]]) -> Array:
    """(n_free,) `start` with the shared parameters where signals, whose searches have ended with slopes along their own and
    then along these, agree: at the mean weighted by what each knows of them, whatever its own are (Schur's complement).
    """
    known, pull = _VAGUE * np.eye(len(start)), _VAGUE * start
    for part, search in searches:
        if search.jacobian is None or search.residual is None:
            continue
        weights, count = search.weights(), len(part.columns)
        variance = max(float(np.mean(weights * search.residual**2)), 1.0)
        curvature = search.jacobian.T @ (search.jacobian * weights[:, None]) / variance
        own, across = curvature[:count, :count] + _VAGUE * np.eye(count), curvature[:count, count:]
        knowledge = curvature[count:, count:] - across.T @ np.linalg.solve(own, across)
        known[np.ix_(part.shared, part.shared)] += knowledge
        pull[part.shared] += knowledge @ search.best[0][count:]
    return np.clip(np.asarray(np.linalg.solve(known, pull), dtype=np.float64), 0.0, 1.0)


def _alone(problem: Problem, label: str) -> Problem:
    """The problem with nothing observed but one label."""
    kept = [
        (
            replace(
                trial, observed={n: replace(o, labels=(label,)) for n, o in trial.observed.items() if label in o.labels}
            ),
            k,
        )
        for trial, k in zip(problem.trials, problem.owners, strict=True)
    ]
    return problem.replayed_by(*zip(*((trial, k) for trial, k in kept if trial.observed), strict=True))


def _searched(
    problem: Problem, space: ParameterSpace, start: Array, columns: NDArray[np.intp], robust: float, tolerance: float,
    damping: float,
) -> LeastSquares:  # fmt: skip
    """Where least squares lead from a start along some columns, with slopes there."""
    free = [p for p in space.parameters if not p.frozen]
    ranges = [np.log(p.upper / p.lower) if p.scale == "log" else 0.0 for p in (free[k] for k in columns)]
    search = LeastSquares(start[columns], np.array(ranges), robust=robust, least_damping=damping, confirm=False,
                          tolerance=tolerance)  # fmt: skip
    while not search.done or search.jacobian is None:
        points = search.ask()
        rows = np.repeat(start[None], len(points), axis=0)
        rows[:, columns] = points
        search.tell(points, problem.residuals(space.from_unit(rows)))
    return search


def parts_of(problem: Problem, space: ParameterSpace, starts: Sequence[Array]) -> list[Part]:
    """The signals that have parameters of their own, seen from any of the starts."""
    names, label = labelled(problem.segments)
    changed = np.zeros((int(space.free.sum()), len(names)))
    for start in starts:
        moved = start + np.diag(np.where(start > 0.5, -_MOVED, _MOVED))
        residuals = problem.residuals(space.from_unit(np.concatenate([start[None], moved])))
        differs = np.nan_to_num(residuals[1:] - residuals[0], nan=np.inf)
        sizes = np.stack([np.linalg.norm(differs[:, label == k], axis=1) for k in range(len(names))], axis=1)
        changed = np.maximum(changed, sizes)
    counts = changed > _OTHERS * changed.max(axis=1, keepdims=True)
    own = counts & (counts.sum(axis=1) == 1)[:, None]
    rows = [(k, np.flatnonzero(own[:, k]), np.flatnonzero(counts[:, k] & ~own[:, k])) for k in range(len(names))]
    return [Part(names[k], np.flatnonzero(label == k), columns, shared) for k, columns, shared in rows if len(columns)]


def confirmed(exact: Problem, space: ParameterSpace, start: Array, point: Array, robust: float) -> bool:
    """Whether the simulator itself, in a glance at each recording, comes to no lower place from the start than `point` is.

    Joints that saturate, have play or share a delay may have their least loss elsewhere when each is replayed alone.
    """
    glance = exact.shortened(GLANCE)
    own = Descent(space, start, Watch(), robust)
    own.descend(Look("glance", glance, glance, 30.0, 15), nudge=0.05)
    here, there = losses_at(exact, space, np.stack([point, own.point]))
    return bool(here <= there)
