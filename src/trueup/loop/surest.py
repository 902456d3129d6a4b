# SPDX-License-Identifier: Apache-2.0
"""Searches what works in most of the models that a calibration left possible, and says in which share of them it does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import Simulator
from trueup.parameters import ParameterSpace
from trueup.search.cma_es import CmaEs
from trueup.tasks.task import DoneOrNot, simulated

DOUBT = 0.05
"""Standard deviation of draws around models, in shares of each parameter's box: what a calibration leaves open."""
_NEAR, _FAR, _LATER = (
    0.08,
    0.15,
    0.06,
)  # first step in shares of the box: from a guess, from the task's own, in several models


@dataclass(frozen=True)
class Effort:
    """How much is searched."""

    population: int = 32
    generations: int = 24
    """At most, with the likeliest model alone; at most half as many follow with `models`."""
    models: int = 4
    confirmed: int = 12
    """Models that a winner is tried in."""
    fine: float = 0.002
    """s, the step at which it is."""
    sure: float = 0.9
    """Share of them in which a candidate has to succeed to be tried as it is."""


@dataclass(frozen=True, eq=False)
class Surest:
    """A candidate, and the share of models in which it succeeds, at a fine step."""

    values: Array
    """(m,) of the task's parameters."""
    share: float
    simulations: int


def surest(
    task: DoneOrNot, simulator: Simulator, models: Array, rng: np.random.Generator, *, doubt: float = DOUBT,
    begin: Array | None = None, effort: Effort | None = None, untried: bool = False,
) -> Surest:  # fmt: skip
    """The candidate that succeeds in most draws around models (k, n) of the simulator's parameters, the likeliest first.

    CMA-ES from `begin` (m,), or the task's nominal values, in the likeliest model, then in several drawn anew for each
    generation (common random numbers within it), until what it has come to succeeds in a dozen of them in a row. With
    `untried`, `begin` has not failed on the robot: it is kept where it succeeds in `Effort.sure` of the models.
    """
    given, space, count = effort or Effort(), task.parameters, 0

    def share(candidates: Array) -> Array:
        several = around(simulator.parameters, models, doubt, given.confirmed, rng)
        return simulated(task, simulator.at_step(given.fine), several, candidates)[1].mean(axis=0)

    def draw(number: int) -> Array:
        return around(simulator.parameters, models, doubt, number, rng)

    if untried and begin is not None:
        kept, count = float(share(begin[None])[0]), given.confirmed
        if kept >= given.sure:
            return Surest(begin, kept, count)
    if len(space) == 1:  # a look at all of it
        grid = space.from_unit(np.linspace(0.0, 1.0, 2 * given.population)[:, None])
        scores, _ = simulated(task, simulator, draw(2 * given.models), grid)
        best, more = grid[np.argsort(scores.mean(axis=0))[:3]], scores.size
    else:
        first = space.to_unit(space.nominal if begin is None else begin)
        sigma = _FAR if begin is None else _NEAR
        one, a = _descended(task, simulator, lambda: models[:1], first, sigma, given.generations, given, rng)
        later = given.generations // 2
        two, b = _descended(task, simulator, lambda: draw(given.models), one, _LATER, later, given, rng)
        best, more = space.from_unit(np.stack([two, one])), a + b
    shares = share(best)
    k = int(shares.argmax())
    return Surest(best[k], float(shares[k]), count + more + len(best) * given.confirmed)


def around(space: ParameterSpace, models: Array, doubt: float, count: int, rng: np.random.Generator) -> Array:
    """(count, n) drawn around each of the models (k, n) in turn, in the box; the first is the first as it is."""
    centres = np.clip(space.to_unit(models), 0.0, 1.0)[np.arange(count) % len(models)]
    drawn = centres + doubt * rng.standard_normal(centres.shape) * (np.arange(count) > 0)[:, None]
    return space.from_unit(np.clip(drawn, 0.0, 1.0))


def _descended(
    task: DoneOrNot, simulator: Simulator, draw: Callable[[], Array], begin: Array, sigma: float, generations: int,
    effort: Effort, rng: np.random.Generator,
) -> tuple[Array, int]:  # fmt: skip
    """The unit box's point to which CMA-ES comes by the mean score in the models drawn for each generation; simulations.

    It ends where the centre of the good candidates has succeeded in `effort.confirmed` models in a row (in one model:
    three times).
    """
    seed, count, held = int(rng.integers(2**31)), 0, 0
    search = CmaEs(begin, seed=seed, sigma=sigma, population=effort.population, restarts=0,
                   max_evaluations=effort.population * generations)  # fmt: skip
    recent: list[Array] = []
    while not search.done:
        asked, models = search.ask(), draw()
        # Where each generation meets other models, the luckiest score is not the best candidate: the mean of good ones is.
        centre = np.concatenate(recent).mean(axis=0) if recent else np.asarray(begin)
        tried = task.parameters.from_unit(np.concatenate([asked, centre[None]]))
        scores, done = simulated(task, simulator, models, tried)
        search.tell(asked, scores[:, :-1].mean(axis=0))
        count += scores.size
        held = held + len(models) if recent and done[:, -1].all() else 0
        if held >= (effort.confirmed if len(models) > 1 else 3):
            return centre, count
        recent = [*recent, asked[np.argsort(scores[:, :-1].mean(axis=0))[: len(asked) // 2]]][-3:]
    return np.concatenate(recent).mean(axis=0), count
