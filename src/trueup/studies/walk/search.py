# SPDX-License-Identifier: Apache-2.0
"""Faster walks in a simulator: CMA-ES over disturbed runs, and the winners looked at again in fresh ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.engines.simulator import Simulator
from trueup.parameters import ParameterSpace
from trueup.search.cma_es import CmaEs
from trueup.tasks.task import simulated_scores
from trueup.tasks.walking import Walk, fell

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Effort:
    """How long a search takes; the paper's is 150 candidates a generation, 7 runs each."""

    population: int = 150
    generations: int = 6
    sigma: float = 0.05
    """Of the box, at the start."""
    shown: int = 6
    """Walks that come of it."""
    fresh: int = 24
    """Runs for each of them."""


@dataclass(frozen=True, eq=False)
class Promise:
    """A candidate and what a simulator says of it."""

    values: Array
    """(m,)"""
    score: float
    """What fresh runs make good on average, falls taken off, in the unit of the task."""
    falls: float
    """Share of fresh runs that fell."""


@dataclass(frozen=True, eq=False)
class Found:
    """What a search found on its way."""

    path: tuple[Promise, ...]
    """Centres of generations, evenly spaced: from near the start, gentle, to the last, bold."""
    history: Array
    """(generations,) the middle candidate's score of each."""


def searched(
    simulator: Simulator, walk: Walk, start: Array, effort: Effort, seed: int, *,
    space: ParameterSpace | None = None, told: Callable[[int, float], None] | None = None,
) -> Found:  # fmt: skip
    """The way from `start` to walks that a simulator thinks are better, among the free parameters of `space`.

    Each generation meets disturbances of its own. What is shown are the centres of generations, and not their best
    candidates: the best of many noisy scores is mostly a lucky one. All along the way, since the simulator does not know
    how far it is right; the paper too took from each generation to the robot. `told` hears each generation's number and
    middle score.
    """
    box = (space or walk.parameters).with_nominal(start)
    search = CmaEs(
        box.to_unit(box.nominal), seed=seed, sigma=effort.sigma, population=effort.population, restarts=0,
        max_evaluations=effort.population * effort.generations,
    )  # fmt: skip
    centres: list[Array] = []
    history: list[float] = []
    while not search.done:
        asked = search.ask()
        anew = walk.made_anew(seed * 1000 + len(history))
        losses = simulated_scores(anew, simulator, simulator.parameters.nominal, box.from_unit(asked))[0]
        search.tell(asked, losses)
        centres.append(search.centre)
        history.append(-float(np.nanmedian(losses)))
        if told is not None:
            told(len(history), history[-1])
    last = len(centres) - 1
    places = sorted({round(last * (k + 1) / effort.shown) for k in range(effort.shown)})
    candidates = box.from_unit(np.array([centres[k] for k in places]))
    return Found(promised(simulator, walk.made_anew(seed * 1000 + 999), candidates, effort.fresh), np.array(history))


def promised(simulator: Simulator, walk: Walk, candidates: Array, runs: int) -> tuple[Promise, ...]:
    """Candidates (b, m) in so many fresh runs each."""
    again = replace(walk, runs=runs)
    model = np.tile(simulator.parameters.nominal, (len(candidates), 1))
    done = simulator.rollout(again.trials, np.hstack([model, candidates]), again.controllers)
    scores, falls = -again.score(done), np.mean([fell(r) for r in done], axis=0)
    return tuple(Promise(c, float(s), float(f)) for c, s, f in zip(candidates, scores, falls, strict=True))
