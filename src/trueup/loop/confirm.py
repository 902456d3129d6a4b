# SPDX-License-Identifier: Apache-2.0
"""Motions that hold: a search whose seeming winners are replayed under noise and at finer steps, the sturdiest first.

A motion with many contacts may succeed once by luck of a simulator's rounding, and never again. What counts is that it
succeeds when its start and its commands are a little off, whatever the integration step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array, Mask
from trueup.chance import Buffeting, CommandNoise, Disturbance, Push, StartScatter
from trueup.engines.simulator import Simulator
from trueup.errors import CalibrationError
from trueup.evaluation.evaluator import Evaluator, Here
from trueup.search.cma_es import CmaEs
from trueup.search.search import Search
from trueup.tasks.task import DoneOrNot, judgement
from trueup.trial import STEP, Trial

NOISE: tuple[Disturbance, ...] = (StartScatter("position", 0.01), CommandNoise(0.01))
"""Twice the step of a small servo's encoder (0.3 degrees), in where joints start and in what they are told."""
STEPS = (2.0 * STEP, STEP, 0.5 * STEP)
"""s: a search's step and finer ones."""
_LEVELS = (2.0, 4.0, 8.0)  # times the noise, by which what holds is compared


@dataclass(frozen=True, eq=False)
class Winner:
    """A candidate that succeeded again and again."""

    values: Array
    """(m,) of the task's parameters."""
    loss: float
    shares: tuple[float, ...]
    """Of its replays under noise that succeeded, at each step."""
    margin: float
    """Share of replays that succeeded under two, four and eight times the noise."""


@dataclass(frozen=True, eq=False)
class Hunt:
    """What came of a search for candidates that hold."""

    winners: tuple[Winner, ...]
    """The largest margin first."""
    simulations: int
    """In all, replays included."""
    doubted: int
    """Candidates that succeeded once and did not hold."""
    ended: str
    best: Array
    """(m,) of the lowest loss, whether it succeeded or not."""


def hunt(
    task: DoneOrNot, simulator: Simulator, rng: np.random.Generator, search: Search | None = None, *,
    model: Array | None = None, wanted: int = 3, apart: float = 0.1, simulations: int = 6400,
    noise: Sequence[Disturbance] = NOISE, replays: int = 6, steps: Sequence[float] = STEPS,
    rough: Sequence[Disturbance] = (), watch: Callable[[int, float, int], None] | None = None,
    evaluator: Evaluator | None = None,
) -> Hunt:  # fmt: skip
    """Searches until `wanted` candidates hold that are `apart` in some coordinate of the unit box, or simulations run out.

    `search` is CMA-ES by default: 30 generations of 32 from the nominal values, then again from there with twice as many
    (IPOP). Of each generation the best candidate that succeeds, far enough from those that hold, is replayed (see `holds`).
    `rough` is what happens to all candidates of a generation alike while they are searched, other in each: feedback can earn
    nothing where nothing disturbs. `model` (n,) are values of the simulator's parameters (None: the nominal ones). `watch`
    sees simulations so far, the generation's lowest loss and the number of winners. `evaluator` says where generations are
    simulated (None: here). Raises CalibrationError where no run of a generation has a score.
    """
    space, values = task.parameters, simulator.parameters.nominal if model is None else np.asarray(model)
    search = search or CmaEs(
        space.to_unit(space.nominal), seed=int(rng.integers(2**31)), sigma=0.25, population=32, restarts=20, generations=30,
        max_evaluations=simulations, guess=True,
    )  # fmt: skip
    held: list[tuple[Array, float, tuple[float, ...]]] = []
    count = doubted = 0
    while not search.done and len(held) < wanted and count < simulations:
        asked = search.ask()
        tried = space.from_unit(asked)
        trials = _disturbed(task, rough, rng, alike=True)
        losses, done = _judged(task, simulator, _rows(values, tried), trials, evaluator or Here())
        search.tell(asked, losses)
        count += len(asked) * len(task.trials)
        far = np.array([all(np.abs(u - space.to_unit(h[0])).max() >= apart for h in held) for u in asked])
        likely = np.flatnonzero(done & far)
        if len(likely):
            k = likely[np.argmin(losses[likely])]
            shares, spent = holds(
                task, simulator, tried[k], rng, model=values, noise=noise, replays=replays, steps=steps
            )
            count += spent
            if len(shares) == len(steps):
                held.append((tried[k], float(losses[k]), shares))
            else:
                doubted += 1
        if watch is not None:
            watch(count, float(np.nanmin(losses)), len(held))
    margins, spent = margin(task, simulator, [h[0] for h in held], rng, model=values, noise=noise, replays=replays)
    found = [Winner(*h, float(m)) for h, m in zip(held, margins, strict=True)]
    ended = search.done or (f"{wanted} found" if len(held) >= wanted else f"stopped after {count} simulations")
    best = space.from_unit(search.best[0])
    return Hunt(tuple(sorted(found, key=lambda w: (-w.margin, w.loss))), count + spent, doubted, ended, best)


def steadiness(
    task: DoneOrNot, simulator: Simulator, models: Array, candidates: Array, rng: np.random.Generator
) -> Array:
    """(c,) share of six replays of each candidate (c, m) under noise that succeed, over models (p, n) of the simulator."""
    good = [_replayed(task, simulator, list(candidates), rng, model, NOISE, 6) for model in np.atleast_2d(models)]
    return np.mean(good, axis=(0, 2))


def _judged(
    task: DoneOrNot, simulator: Simulator, rows: Array, trials: Sequence[Trial], evaluator: Evaluator
) -> tuple[Array, Mask]:
    """(b,) losses, NaN where a simulation failed, and which rows succeeded. Raises CalibrationError where all failed."""
    found = evaluator.evaluate(judgement(task, simulator, trials), rows)
    losses, done = found.values.T
    if not np.isfinite(losses).any():
        why = next(iter(found.failures.values()), "the task's score is not finite for all")
        raise CalibrationError(
            f"task '{task.name}': none of {len(rows)} candidates could be simulated at a step of "
            f"{1e3 * simulator.step:.3g} ms: {why}. Try a shorter step (simulator.at_step)"
        )
    return losses, (done == 1.0) & np.isfinite(losses)


def holds(
    task: DoneOrNot, simulator: Simulator, candidate: Array, rng: np.random.Generator, *, model: Array | None = None,
    noise: Sequence[Disturbance] = NOISE, replays: int = 6, steps: Sequence[float] = STEPS,
) -> tuple[tuple[float, ...], int]:  # fmt: skip
    """Shares of replays under noise that succeed, step by step as long as all but one do, and how many were simulated.

    There are as many shares as `steps` where the candidate (m,) holds at all of them.
    """
    shares: list[float] = []
    for number, step in enumerate(steps, 1):
        good = _replayed(task, simulator.at_step(step), [candidate], rng, model, noise, replays)[0]
        if good.sum() < replays - 1:
            return tuple(shares), number * replays * len(task.trials)
        shares.append(float(good.mean()))
    return tuple(shares), len(steps) * replays * len(task.trials)


def margin(
    task: DoneOrNot, simulator: Simulator, candidates: Sequence[Array], rng: np.random.Generator, *,
    model: Array | None = None, noise: Sequence[Disturbance] = NOISE, replays: int = 6,
) -> tuple[Array, int]:  # fmt: skip
    """(c,) share of replays of each candidate that succeed under two, four and eight times the noise; simulations spent."""
    if not len(candidates):
        return np.zeros(0), 0
    good = [
        _replayed(task, simulator, candidates, rng, model, [_scaled(d, level) for d in noise], replays)
        for level in _LEVELS
    ]
    return np.mean(good, axis=(0, 2)), len(_LEVELS) * replays * len(candidates) * len(task.trials)


def _replayed(
    task: DoneOrNot, simulator: Simulator, candidates: Sequence[Array], rng: np.random.Generator, model: Array | None,
    noise: Sequence[Disturbance], replays: int,
) -> Mask:  # fmt: skip
    """(c, replays) which replays succeeded; every one of them meets noise of its own."""
    values = simulator.parameters.nominal if model is None else model
    trials = _disturbed(task, noise, rng)
    rows = _rows(values, np.repeat(np.atleast_2d(candidates), replays, axis=0))
    return task.succeeded(simulator.rollout(trials, rows, task.controllers)).reshape(len(candidates), replays)


def _disturbed(
    task: DoneOrNot, noise: Sequence[Disturbance], rng: np.random.Generator, *, alike: bool = False
) -> list[Trial]:
    """The task's trials with noise beside what disturbs them anyway."""
    trials = [replace(t, disturbances=(*t.disturbances, *noise)) for t in task.trials]
    return [t.seeded(rng, alike=alike) if t.disturbances or t.sensing else t for t in trials]


def _rows(model: Array, candidates: Array) -> Array:
    return np.concatenate([np.tile(model, (len(candidates), 1)), candidates], axis=1)


def _scaled(disturbance: Disturbance, level: float) -> Disturbance:
    match disturbance:
        case Push(force=(low, high)):
            return replace(disturbance, force=(level * low, level * high))
        case Buffeting(force=force):
            return replace(disturbance, force=level * force)
        case _:
            return replace(disturbance, deviation=level * disturbance.deviation)
