# SPDX-License-Identifier: Apache-2.0
"""Faster walks in a simulator: CMA-ES over disturbed runs, and the winners looked at again in fresh ones."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from trueup.arrays import Array
from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.engines.simulator import Simulator
from trueup.evaluation.evaluator import Evaluator, Here
from trueup.loop.correction import Correction
from trueup.parameters import ParameterSpace
from trueup.search.cma_es import CmaEs
from trueup.tasks.task import simulated_scores
from trueup.tasks.walking import Walk, fell


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
class Scene:
    """In which walks are searched."""

    simulator: Simulator
    walk: Walk
    models: Array
    """(p, n) of the simulator's parameters: each walk is run with each, and judged by all."""
    correction: Correction | None = None
    """Of the scores, by what the robot showed, over the unit box of all of the walk's parameters."""
    evaluator: Evaluator = field(default_factory=Here)
    """Where generations are simulated."""

    def scores(self, walk: Walk, candidates: Array) -> Array:
        """(b,) expected losses of candidates (b, m), a deviation added of what is not sure on the robot."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a candidate all of whose runs failed has none
            losses = np.nanmean(simulated_scores(walk, self.simulator, self.models, candidates, self.evaluator), axis=0)
        if self.correction is None:
            return losses
        return np.sum(self.correction(whole(candidates), losses, np.zeros(len(losses))), axis=0)


def whole(values: Array) -> Array:
    """Values (b, m) of all of the walk's parameters in their unit box, whichever are free."""
    low, high = np.array([(p.lower, p.upper) for p in PARAMETERS.parameters]).T
    return (np.atleast_2d(values) - low) / (high - low)


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
    scene: Scene, start: Array, effort: Effort, seed: int, *, space: ParameterSpace | None = None,
    wide: Mapping[str, float] = MappingProxyType({}), told: Callable[[int, float], None] | None = None,
) -> Found:  # fmt: skip
    """The way from `start` to walks that a simulator thinks are better, among the free parameters of `space`.

    Each generation meets disturbances of its own. What is shown are the centres of generations, and not their best
    candidates: the best of many noisy scores is mostly a lucky one. All along the way, since the simulator does not know
    how far it is right; the paper too took from each generation to the robot. Parameters named by `wide` begin with so
    many times the deviation. `told` hears each generation's number and middle score.
    """
    box = (space or scene.walk.parameters).with_nominal(start)
    at = np.clip(box.to_unit(box.nominal), 0.0, 1.0)
    factors = np.array([wide.get(p.name, 1.0) for p in box.parameters if not p.frozen])

    def seen(unit: Array) -> Array:
        return np.clip(at + factors * (unit - at), 0.0, 1.0)

    search = CmaEs(
        at, seed=seed, sigma=effort.sigma, population=effort.population, restarts=0,
        max_evaluations=effort.population * effort.generations,
    )  # fmt: skip
    centres: list[Array] = []
    history: list[float] = []
    while not search.done:
        asked = search.ask()
        losses = scene.scores(scene.walk.made_anew(seed * 1000 + len(history)), box.from_unit(seen(asked)))
        search.tell(asked, losses)
        centres.append(search.centre)
        history.append(-float(np.nanmedian(losses)))
        if told is not None:
            told(len(history), history[-1])
    last = len(centres) - 1
    places = sorted({round(last * (k + 1) / effort.shown) for k in range(effort.shown)})
    candidates = box.from_unit(seen(np.array([centres[k] for k in places])))
    return Found(promised(scene, scene.walk.made_anew(seed * 1000 + 999), candidates, effort.fresh), np.array(history))


def promised(scene: Scene, walk: Walk, candidates: Array, runs: int) -> tuple[Promise, ...]:
    """Candidates (b, m) in so many fresh runs each, spread over the scene's models."""
    again = replace(walk, runs=max(1, round(runs / len(scene.models))))
    rows = [np.hstack([np.tile(m, (len(candidates), 1)), candidates]) for m in scene.models]
    done = scene.simulator.rollout(again.trials, np.concatenate(rows), again.controllers)
    each = -again.score(done).reshape(len(rows), -1), np.mean([fell(r) for r in done], axis=0).reshape(len(rows), -1)
    scores, falls = np.nanmean(each, axis=1)
    return tuple(Promise(c, float(s), float(f)) for c, s, f in zip(candidates, scores, falls, strict=True))
