# SPDX-License-Identifier: Apache-2.0
"""Searches a transition's motion in a simulator that is not quite known, and says how surely its winner stands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.loop.settle import settled
from trueup.search.cma_es import CmaEs
from trueup.studies.balance.calibration import STEP, simulator_of
from trueup.studies.balance.scenes import SCENES, transition
from trueup.tasks.task import judged
from trueup.tasks.transitions import Transition

Array = NDArray[np.float64]

CALIBRATED, RANDOM = 0.05, 0.2
"""Standard deviation in shares of each parameter's box of draws around models: what a calibration leaves open in all its
members, and what a model file does not know."""
_CONFIRMED = 12  # models that a winner is tried in
SURE = 0.9
"""Share of them in which a motion has to succeed to be tried as it is."""
_FINE = 0.002  # s, at which it is


@dataclass(frozen=True)
class Effort:
    """How much is searched."""

    population: int = 32
    generations: int = 24
    """With the model alone; half as many follow with `models`."""
    models: int = 4


@dataclass(frozen=True, eq=False)
class Found:
    """A motion, and the share of models in which it ends as wanted, at the fine step."""

    motion: Array
    share: float
    simulations: int


def task_of(scene: str, simulator: MujocoSimulator, values: Array) -> Transition:
    """The transition, begun as this robot rests with values (n,) of the simulator's parameters."""
    _, task = transition(scene, step=STEP)
    given, own = SCENES[scene], simulator.with_parameters(simulator.parameters.with_nominal(values))
    heights = np.linspace(*given.heights, 25).tolist()
    start = settled(own, task.motion.joints, task.motion.first, heights, pitch=given.pitch, name=scene)
    return replace(task, start=start)


def models_around(
    simulator: MujocoSimulator, models: Array, doubt: float, count: int, rng: np.random.Generator
) -> Array:
    """(count, n) drawn around each of the models (k, n) in turn, in the box; the first is the first as it is."""
    space = simulator.parameters
    centres = np.clip(space.to_unit(models), 0.0, 1.0)[np.arange(count) % len(models)]
    drawn = centres + doubt * rng.standard_normal(centres.shape) * (np.arange(count) > 0)[:, None]
    return space.from_unit(np.clip(drawn, 0.0, 1.0))


def searched(
    scene: str, models: Array, rng: np.random.Generator, *, doubt: float, begin: Array | None = None,
    effort: Effort | None = None, parameters: str = "wider", again: bool = False,
) -> Found:  # fmt: skip
    """The best motion in models (k, n), the likeliest first, from motion `begin` (m,) or from the scene's seeds.

    With `again`, `begin` has not failed yet: it is kept where it succeeds in nearly all models.
    """
    given, simulator = effort or Effort(), simulator_of(scene, parameters)
    task, count = task_of(scene, simulator, models[0]), 0
    space = task.parameters

    def share(motions: Array) -> Array:
        return success_shares(scene, task, models, motions, rng, doubt=doubt, parameters=parameters)

    def draw(number: int) -> Array:
        return models_around(simulator, models, doubt, number, rng)

    if again and begin is not None:
        kept, count = float(share(begin[None])[0]), _CONFIRMED
        if kept >= SURE:
            return Found(begin, kept, count)
    if len(space) == 1:  # only the time: a look at all of it
        grid = space.from_unit(np.linspace(0.0, 1.0, 2 * given.population)[:, None])
        scores, _ = judged(task, simulator, draw(2 * given.models), grid)
        best, more = grid[np.argsort(scores.mean(axis=0))[:3]], scores.size
    else:
        first = space.to_unit(space.nominal if begin is None else begin)
        sigma = 0.15 if begin is None else 0.08
        one, a = _descended(task, simulator, lambda: models[:1], first, sigma, given.generations, given, rng)
        two, b = _descended(
            task, simulator, lambda: draw(given.models), one, 0.06, given.generations // 2, given, rng
        )  # fmt: skip
        best, more = space.from_unit(np.stack([two, one])), a + b
    shares = share(best)
    k = int(shares.argmax())
    return Found(best[k], float(shares[k]), count + more + len(best) * _CONFIRMED)


def success_shares(
    scene: str, task: Transition, models: Array, motions: Array, rng: np.random.Generator, *, doubt: float,
    parameters: str = "wider",
) -> Array:  # fmt: skip
    """(b,) in which share of draws around the models each motion (b, m) ends as wanted, at the fine step."""
    simulator = simulator_of(scene, parameters, step=_FINE)
    several = models_around(simulator, models, doubt, _CONFIRMED, rng)
    rows = np.concatenate([np.repeat(several, len(motions), axis=0), np.tile(motions, (len(several), 1))], axis=1)
    done = simulator.rollout(task.trials, rows, task.controllers)
    return task.succeeded(done).reshape(len(several), len(motions)).mean(axis=0)


def _descended(
    task: Transition, simulator: MujocoSimulator, draw: Callable[[], Array], begin: Array, sigma: float, generations: int,
    effort: Effort, rng: np.random.Generator,
) -> tuple[Array, int]:  # fmt: skip
    """The unit box's point to which CMA-ES comes by the mean score in models drawn anew each time, and the simulations.

    It ends where the centre of the good candidates has succeeded in `_CONFIRMED` models in a row (in one model: three times).
    """
    seed, simulated, held = int(rng.integers(2**31)), 0, 0
    search = CmaEs(begin, seed=seed, sigma=sigma, population=effort.population, restarts=0,
                   max_evaluations=effort.population * generations)  # fmt: skip
    recent: list[Array] = []
    while not search.done:
        asked, models = search.ask(), draw()
        # Where each generation meets other models, the luckiest score is not the best candidate: the mean of good ones is.
        centre = np.concatenate(recent).mean(axis=0) if recent else np.asarray(begin)
        tried = task.parameters.from_unit(np.concatenate([asked, centre[None]]))
        scores, done = judged(task, simulator, models, tried)
        search.tell(asked, scores[:, :-1].mean(axis=0))
        simulated += scores.size
        held = held + len(models) if recent and done[:, -1].all() else 0
        if held >= (_CONFIRMED if len(models) > 1 else 3):
            return centre, simulated
        recent = [*recent, asked[np.argsort(scores[:, :-1].mean(axis=0))[: len(asked) // 2]]][-3:]
    return np.concatenate(recent).mean(axis=0), simulated
