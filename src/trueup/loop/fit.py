# SPDX-License-Identifier: Apache-2.0
"""Finds the values that replay the recordings best: short and coarse first, then everything at the full step."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.errors import CalibrationError
from trueup.loop.descent import Checkpoint, Descent, Fit, Progress, Select, Stage, Watch, explained, last_look
from trueup.loop.problem import Problem
from trueup.parameters import ParameterSpace
from trueup.search.cma_es import CmaEs
from trueup.search.least_squares import LeastSquares
from trueup.search.robust import robust_losses

__all__ = ["SEARCHES", "Checkpoint", "Fit", "Progress", "Watch", "fit"]

Array = NDArray[np.float64]

SEARCHES = ("auto", "gradient", "cma-es", "hybrid")

_EVOLVING = "cma-es"  # the name of its stage
_SHORT = (2.5, 15.0)  # s: the first stage looks at the first quarter of the recordings, within these bounds
_BLIND = 5.0  # a slope that across the whole box changes the residuals by less than this many times what they are
_LOOKED_AT = 5  # parameters without much slope, at most: those with the least
_FEW = 8  # parameters: so few can be searched widely where slopes end far above the noise
_EDGE = 5e-3  # share of the box: whatever is closer to a bound is on it
_BETTER = 0.98  # a place elsewhere is worth going to if the loss falls at least to this share
_BEND = 10.0  # noise units from which losses grow linearly where places far apart are compared: one fall is not all
_COARSE = (2.5, 2.0, 1.5)  # factors on the integration step while far from the optimum; the first that is faithful
_FAITHFUL = 0.3  # share of the residuals at the start by which a coarser step may change them


def fit(
    problem: Problem, space: ParameterSpace, start: Array, watch: Watch, *, search: str = "auto", robust: float = 3.0,
    seed: int = 0, resume: dict[str, Any] | None = None, select: Select | None = None,
) -> Fit:  # fmt: skip
    """Values of the free parameters that minimise the robust discrepancy, starting from values (n,).

    `search`: 'gradient' (Gauss-Newton), 'cma-es', 'hybrid' (CMA-ES, then Gauss-Newton), or 'auto', which takes the
    gradient and, where no slope leads down, the hybrid. `select` is asked before the last stage which parameters to keep.
    Raises CalibrationError for other words.
    """
    if search not in SEARCHES:
        raise CalibrationError(f"search '{search}' is not one of: {', '.join(SEARCHES)}")
    point = np.clip(space.to_unit(start), 0.0, 1.0)
    coarse = _coarse(problem, space, point)
    stages = _stages(problem, coarse)
    evolved = resume["search"] if resume and resume["stage"] == _EVOLVING else None
    if evolved is not None:
        resume = None
    if evolved is not None or (search in ("cma-es", "hybrid") and not resume):
        point = _evolve(stages[0].problem, space, point, watch, seed, short=search != "cma-es", saved=evolved)
    begin, saved = _left(resume, stages)
    run = Descent(space, point, watch, robust)
    for k, stage in enumerate(stages[begin:], begin):
        whole = 0 < k == len(stages) - 1 and stages[k - 1].problem is coarse
        if whole and run.search is not None and select is not None:  # only all recordings tell what they support
            run.choose(stages[k - 1], select)
            select = None
        if k > begin and not np.isfinite(stage.problem.residuals(run.space.from_unit(run.point[None]))).all():
            # What replays with a coarser step may blow up with the real one: back to the start, without the coarser one.
            run.restart(np.clip(run.space.to_unit(start), 0.0, 1.0))
            stage = replace(stage, cheap=stage.problem)
        polish = saved is None and stage.cheap.simulator is not stage.problem.simulator
        nudge = 0.05 if k == begin and not resume else 0.0
        found = run.polish(stage) if polish else run.descend(stage, nudge=nudge, saved=saved)
        if search == "auto" and not resume and found.iteration == 0 and k == 0:
            # No slope leads down: the residuals are rough (contacts, falls). Look around first, then try slopes again.
            run.point = _evolve(stage.problem, space, point, watch, seed, short=True)
            run.descend(stage)
        elif search == "auto" and not resume:
            _look_wider(run, stage, stages[0].problem, seed, anywhere=k == 0)
        saved = None
    if select is not None and run.choose(stages[-1], select):
        run.descend(stages[-1])
    if search == "auto":
        _off_bounds(run, stages[-1])
    return run.finished(stages[-1])


def _left(resume: dict[str, Any] | None, stages: list[Stage]) -> tuple[int, dict[str, Any] | None]:
    """Which stage an interrupted search was in, and its state there."""
    if not resume:
        return 0, None
    names = [stage.name for stage in stages]
    return (names.index(resume["stage"]) if resume["stage"] in names else len(names) - 1), resume["search"]


def _off_bounds(run: Descent, stage: Stage) -> None:
    """Searches again from the middle of the range of parameters that ended at a bound, and stays where it is lower.

    A body's mass and lever arm trade: the valley along which they do has an end at a bound of either, with a low ridge
    before the optimum. Not for parameters at zero, where structures end that the robot does not have, and only where
    the model replays the recordings to about their noise: elsewhere a bound is the least of what is wrong.
    """
    found = run.search
    if found is None or found.residual is None or not explained(found.residual):
        return
    free = [p for p in run.space.parameters if not p.frozen]
    low, high = found.point < _EDGE, found.point > 1.0 - _EDGE
    none = np.array([p.scale == "log" or p.lower == 0.0 for p in free])
    worth = stage.problem.chance(found.residual) * len(free)
    for k in np.flatnonzero((low & ~none) | high)[:_LOOKED_AT]:
        before, name = (run.point, run.search, run.near), free[k].name
        middle = run.space.from_unit(np.where(np.arange(len(free)) == k, 0.5, run.point))[run.space.index(name)]
        # First the others settle around the new place: all at once would slide back the way it came.
        others = Descent(run.space.freeze([name], {name: middle}), np.delete(run.point, k), run.watch, run.robust)
        others.descend(replace(stage, tolerance=1.0), confirm=False)
        run.point = np.insert(others.point, k, 0.5)
        if run.descend(stage).loss < found.loss - worth:
            return
        run.point, run.search, run.near = before


def _stages(problem: Problem, coarse: Problem) -> list[Stage]:
    long = max(t.duration for t in problem.trials)
    stages: list[Stage] = []
    first = float(np.clip(long / 4.0, *_SHORT))
    if long > 2.0 * first:
        short = coarse.shortened(first)
        real = problem.shortened(first) if coarse is not problem else None
        stages.append(Stage("first seconds", short, short, 30.0, 15, real))
    if coarse is not problem:
        stages.append(Stage("all, coarse step", coarse, coarse, 5.0, 25, problem))
    return [*stages, last_look(problem, coarse)]


def _coarse(problem: Problem, space: ParameterSpace, point: Array) -> Problem:
    """The problem at the coarsest step that tells nearly the same residuals at the start."""
    values = space.from_unit(np.clip(point, 0.05, 0.95))
    fine = problem.start_residual(values)
    for factor in _COARSE:
        cheap = problem.at_step(problem.simulator.step * factor)
        rough = cheap.residuals(values[None])[0]
        if np.isfinite(rough).all() and np.linalg.norm(rough - fine) <= _FAITHFUL * np.linalg.norm(fine):
            return cheap
    return problem


def _evolve(
    problem: Problem, space: ParameterSpace, point: Array, watch: Watch, seed: int, *, short: bool,
    saved: dict[str, Any] | None = None,
) -> Array:  # fmt: skip
    most = 60 * (len(point) + 5) if short else 300 * (len(point) + 5)
    search = CmaEs(
        point, seed=seed, max_evaluations=most, restarts=0 if short else 1, tolerance=1e-2 if short else 1e-4
    )
    if saved is not None:
        search.resume(saved)
    while not search.done:
        candidates = search.ask()
        residuals = problem.residuals(space.from_unit(candidates))
        losses = robust_losses(residuals, _BEND)
        search.tell(candidates, losses)
        watch.save(_EVOLVING, space, search.state())
        k = int(np.nanargmin(losses)) if np.isfinite(losses).any() else 0
        watch.saw(_EVOLVING, problem, search.best[1], problem.rmse(np.nan_to_num(residuals[k])))
    return search.best[0]


def _look_wider(run: Descent, stage: Stage, first: Problem, seed: int, *, anywhere: bool) -> None:
    """Goes where slopes do not lead, if it is lower there: along single parameters, and `anywhere` if these are few."""
    found = run.search
    other = None if found is None else _elsewhere(stage.problem, run.space, found, first)
    if other is not None:
        run.point = other
        found = run.descend(stage)
    if not anywhere or found is None or len(run.point) > _FEW or explained(found.residual) or run.leads_on(stage):
        return
    other = _wide(stage.problem, run.space, found, run.watch, seed)
    if other is not None:
        run.point = other
        run.descend(stage)


def _wide(problem: Problem, space: ParameterSpace, last: LeastSquares, watch: Watch, seed: int) -> Array | None:
    """A better point wherever it is, if there is one: a foot that sticks has no slope towards the friction it slides with."""
    point = _evolve(problem, space, last.point, watch, seed, short=True)
    there, here = _losses(problem, space, np.stack([point, last.point]))
    return point if there < _BETTER * here else None


def _elsewhere(problem: Problem, space: ParameterSpace, last: LeastSquares, first: Problem) -> Array | None:
    """A better point along the axis of a parameter that has no slope where it is, or is at a bound, if there is one.

    The friction of a foot that sticks and the force limit of a drive that never saturates have none: slopes alone would
    leave them where they started, however wrong that is, or where one wrong step took them. Where the `first` stage costs
    far less it is looked at in the problem's place, which only judges what was found there.
    """
    if last.jacobian is None or last.residual is None:
        return None
    bound = (last.point < _EDGE) | (last.point > 1.0 - _EDGE)
    effect = np.sqrt(np.mean(last.jacobian**2, axis=0) / max(float(np.mean(last.residual**2)), 1e-300))
    weakest = np.argsort(np.where(bound, 0.0, effect))[:_LOOKED_AT]
    few = len(last.point) <= _FEW
    blind = weakest[(effect < (4.0 if few else 1.0) * _BLIND)[weakest] | bound[weakest]]
    if not len(blind):
        return None
    here = float(robust_losses(last.residual[None], _BEND)[0])
    if _simulated(first) > 0.5 * _simulated(problem):
        point, loss = _along(problem, space, last.point, blind)
        return point if loss < _BETTER * here else None
    point, loss = _along(first, space, last.point, blind)
    if loss >= _BETTER * _losses(first, space, last.point[None])[0]:
        return None
    return point if _losses(problem, space, point[None])[0] < _BETTER * here else None


def _along(problem: Problem, space: ParameterSpace, point: Array, columns: NDArray[np.intp]) -> tuple[Array, float]:
    """The lowest point on lines along some axes, and its loss."""

    def seen(columns: NDArray[np.intp], places: Array) -> tuple[Array, Array]:
        points = np.repeat(point[None], len(columns), axis=0)
        points[np.arange(len(points)), columns] = places
        return points, _losses(problem, space, points)

    # Ground friction counts in a narrow range only: above it a foot sticks, below it the robot slips away.
    places = np.linspace(0.05, 0.95, 28 if len(point) <= _FEW else 10)
    _, losses = seen(np.repeat(columns, len(places)), np.tile(places, len(columns)))
    column, place = divmod(int(np.argmin(losses)), len(places))
    # Where it has no slope on one side of a place and too much on the other, what is best lies between two places.
    closer = np.clip(places[place] + np.linspace(-1.0, 1.0, 11) * (places[1] - places[0]), 0.0, 1.0)
    points, losses = seen(np.full(len(closer), columns[column]), closer)
    best = int(np.argmin(losses))
    return points[best], float(losses[best])


def _losses(problem: Problem, space: ParameterSpace, points: Array) -> Array:
    """(b,) what points in the unit box cost; inf where the simulation fails."""
    losses = robust_losses(problem.residuals(space.from_unit(points)), _BEND)
    return np.where(np.isfinite(losses), losses, np.inf)


def _simulated(problem: Problem) -> float:
    """Number of steps that one candidate costs."""
    return sum(t.duration for t in problem.trials) / problem.simulator.step
