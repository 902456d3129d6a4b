# SPDX-License-Identifier: Apache-2.0
"""Finds the values that replay the recordings best: short and coarse first, then everything at the full step."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.calibration import TracePoint
from trueup.errors import CalibrationError
from trueup.loop.problem import Problem
from trueup.parameters import ParameterSpace
from trueup.search.cma_es import CmaEs
from trueup.search.least_squares import LeastSquares
from trueup.search.robust import robust_losses

Array = NDArray[np.float64]

SEARCHES = ("auto", "gradient", "cma-es", "hybrid")
Progress = Callable[[TracePoint], None]
Checkpoint = Callable[[dict[str, Any]], None]

_SHORT = (2.5, 15.0)  # s: the first stage looks at the first quarter of the recordings, within these bounds
_HELD = 3e-3  # least damping of the first looks: what is weakly seen must not wander off before all data are in
_BLIND = 1.0  # rms change of the residuals across the whole box, in noise units: a slope below tells nothing
_BETTER = 0.98  # a place elsewhere is worth going to if the loss falls at least to this share
_BEND = (
    10.0  # noise units from which losses grow linearly where places far apart are compared: one fall must not hide all
)
_COARSE = 2.5  # factor on the integration step while far from the optimum


@dataclass
class Fit:
    """Where a search ended, with the slopes there."""

    space: ParameterSpace
    unit: Array
    """(n_free,) in the unit box."""
    residual: Array
    """(m,) at the optimum, full step."""
    jacobian: Array
    """(m, n_free) d residual / d unit."""
    weights: Array
    """(m,) robust weights."""
    ended: str
    loss: float = 0.0
    bend: float = np.inf
    """Residuals far beyond it count as outliers."""
    scatter: Array | None = None
    """(n_free, n_free) mean square by which the place changes that slopes point to, from one side of the optimum to the
    other (see `probe.py`)."""

    @property
    def values(self) -> Array:
        """(n,) all values, frozen ones included."""
        return self.space.from_unit(self.unit)


@dataclass
class Watch:
    """Counts, times and reports what a search does, and saves it."""

    progress: Progress | None = None
    checkpoint: Checkpoint | None = None
    began: float = field(default_factory=time.perf_counter)
    trace: list[TracePoint] = field(default_factory=list)

    def saw(self, stage: str, problem: Problem, loss: float, rmse: float) -> None:
        """One more point of the search trace."""
        point = TracePoint(stage, problem.evaluations, float(loss), float(rmse), time.perf_counter() - self.began)
        self.trace.append(point)
        if self.progress is not None:
            self.progress(point)

    def save(self, stage: str, space: ParameterSpace, state: dict[str, Any]) -> None:
        """Hands the state of the search to the checkpoint."""
        if self.checkpoint is not None:
            frozen = [p.name for p in space.parameters if p.frozen]
            self.checkpoint({"stage": stage, "frozen": frozen, "search": state})


def fit(
    problem: Problem, space: ParameterSpace, start: Array, watch: Watch, *, search: str = "auto", robust: float = 3.0,
    seed: int = 0, resume: dict[str, Any] | None = None,
) -> Fit:  # fmt: skip
    """Values of the free parameters that minimise the robust discrepancy, starting from values (n,).

    `search`: 'gradient' (Gauss-Newton), 'cma-es', 'hybrid' (CMA-ES, then Gauss-Newton), or 'auto', which takes the
    gradient and, where no slope leads down, the hybrid. Raises CalibrationError for other words.
    """
    if search not in SEARCHES:
        raise CalibrationError(f"search '{search}' is not one of: {', '.join(SEARCHES)}")
    point = np.clip(space.to_unit(start), 0.0, 1.0)
    coarse = _coarse(problem, space, point)
    stages = _stages(problem, coarse)
    begin, saved = 0, None
    if resume:
        names = [name for name, *_ in stages]
        begin = names.index(resume["stage"]) if resume.get("stage") in names else len(names) - 1
        saved = resume["search"]
    elif search in ("cma-es", "hybrid"):
        point = _evolve(stages[0][1], space, point, watch, seed, short=search == "hybrid")
    last: LeastSquares | None = None
    for name, stage, cheap, tolerance, most in stages[begin:]:
        nudge = 0.05 if last is None and not resume else 0.0
        last = _descend(name, stage, cheap, space, point, watch, robust, tolerance, most, saved, nudge, last)
        if search == "auto" and last.iteration == 0 and not resume and name == stages[0][0]:
            # No slope leads down: the residuals are rough (contacts, falls). Look around first, then try slopes again.
            point = _evolve(stage, space, point, watch, seed, short=True)
            last = _descend(name, stage, cheap, space, point, watch, robust, tolerance, most, None, 0.0, last)
        elif search == "auto" and not resume and (other := _elsewhere(stage, space, last)) is not None:
            last = _descend(name, stage, cheap, space, other, watch, robust, tolerance, most, None, 0.0, last)
        point, saved = last.point, None
    if last is None:
        raise CalibrationError("nothing was searched")
    return _finished(problem, coarse, space, last)


def _stages(problem: Problem, coarse: Problem) -> list[tuple[str, Problem, Problem, float, int]]:
    """Name, the problem to solve, the cheaper one for its slopes, tolerance and most iterations.

    Tolerances are in units of what chance alone gives: a first look may end early, the last must not.
    """
    long = max(t.duration for t in problem.trials)
    stages: list[tuple[str, Problem, Problem, float, int]] = []
    first = float(np.clip(long / 4.0, *_SHORT))
    if long > 2.0 * first:
        short = coarse.shortened(first)
        stages.append(("first seconds", short, short, 30.0, 15))
    if coarse is not problem:
        stages.append(("all, coarse step", coarse, coarse, 5.0, 25))
    stages.append(("all, full step", problem, coarse, 0.05, 20))
    return stages


def _coarse(problem: Problem, space: ParameterSpace, point: Array) -> Problem:
    """The problem at a coarser step, if that tells nearly the same residuals at the start."""
    cheap = problem.at_step(problem.simulator.step * _COARSE)
    values = space.from_unit(np.clip(point, 0.05, 0.95))
    fine = problem.start_residual(values)
    rough = cheap.residuals(values[None])[0]
    if not np.isfinite(rough).all() or np.linalg.norm(rough - fine) > 0.3 * np.linalg.norm(fine):
        return problem
    return cheap


def _descend(
    name: str, stage: Problem, cheap: Problem, space: ParameterSpace, point: Array, watch: Watch, robust: float,
    tolerance: float, most: int, saved: dict[str, Any] | None, nudge: float,
    before: LeastSquares | None,
) -> LeastSquares:  # fmt: skip
    free = [p for p in space.parameters if not p.frozen]
    ranges = np.array([np.log(p.upper / p.lower) if p.scale == "log" else 0.0 for p in free])
    held = 1e-9 if tolerance < 1.0 else _HELD
    search = LeastSquares(point, ranges, least_damping=held, share=2e-3 if tolerance < 1.0 else 3e-2,
                          robust=robust, tolerance=tolerance, max_iterations=most, nudge=nudge,
                          confirm=tolerance < 1.0,
                          difference=LeastSquares.difference if before is None else before.careful_difference(),
                          worth=lambda residual: stage.chance(residual) * len(free))  # fmt: skip
    if saved is not None:
        search.resume(saved)
    while not search.done:
        candidates = search.ask()
        residuals = _columns(stage, cheap, space, candidates) if search.jacobian is None else None
        if residuals is None:
            residuals = stage.residuals(space.from_unit(candidates))
        search.tell(candidates, residuals)
        if search.jacobian is not None and search.residual is not None:
            watch.saw(name, stage, search.loss, stage.rmse(search.residual))
        else:
            watch.save(name, space, search.state())
    return search


def _columns(stage: Problem, cheap: Problem, space: ParameterSpace, candidates: Array) -> Array:
    """Residuals at the point and around it; the differences come from the cheaper problem, the level from the stage."""
    residuals = cheap.residuals(space.from_unit(candidates))
    if cheap.simulator is not stage.simulator:
        level = stage.residuals(space.from_unit(candidates[:1]))[0]
        residuals += level - residuals[0]
    return residuals


def _evolve(problem: Problem, space: ParameterSpace, point: Array, watch: Watch, seed: int, *, short: bool) -> Array:
    most = 60 * (len(point) + 5) if short else 300 * (len(point) + 5)
    search = CmaEs(
        point, seed=seed, max_evaluations=most, restarts=0 if short else 1, tolerance=1e-2 if short else 1e-4
    )
    while not search.done:
        candidates = search.ask()
        residuals = problem.residuals(space.from_unit(candidates))
        losses = robust_losses(residuals, _BEND)
        search.tell(candidates, losses)
        k = int(np.nanargmin(losses)) if np.isfinite(losses).any() else 0
        watch.saw("cma-es", problem, search.best[1], problem.rmse(np.nan_to_num(residuals[k])))
    return search.best[0]


def _elsewhere(problem: Problem, space: ParameterSpace, last: LeastSquares) -> Array | None:
    """A better point along the axis of a parameter that has no slope where it is, if there is one.

    The friction of a foot that sticks and the force limit of a drive that never saturates have none: slopes alone would
    leave them where they started, however wrong that is.
    """
    if last.jacobian is None or last.residual is None:
        return None
    blind = np.flatnonzero(np.sqrt(np.mean(last.jacobian**2, axis=0)) < _BLIND)
    places = np.linspace(0.05, 0.95, 10)
    points = np.repeat(last.point[None], len(blind) * len(places), axis=0)
    points[np.arange(len(points)), np.repeat(blind, len(places))] = np.tile(places, len(blind))
    if not len(points):
        return None
    losses = robust_losses(problem.residuals(space.from_unit(points)), _BEND)
    best = int(np.argmin(np.where(np.isfinite(losses), losses, np.inf)))
    return points[best] if losses[best] < _BETTER * robust_losses(last.residual[None], _BEND)[0] else None


def _finished(problem: Problem, coarse: Problem, space: ParameterSpace, search: LeastSquares) -> Fit:
    if search.jacobian is None or search.residual is None:
        candidates = search.ask()
        search.tell(candidates, _columns(problem, coarse, space, candidates))
    if search.jacobian is None or search.residual is None:
        raise CalibrationError("the search ended without slopes")
    return Fit(
        space, search.point, search.residual, search.jacobian, search.weights(), search.done, search.loss, search.delta
    )
