# SPDX-License-Identifier: Apache-2.0
"""Which runs tell the most about the simulator's parameters: greedy D-optimal choice from simulated sensitivities.

A. C. Atkinson, A. N. Donev, R. D. Tobias, "Optimum Experimental Designs, with SAS", 2007, chapters 11 and 12.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import Rollout, Simulator
from trueup.errors import CalibrationError
from trueup.loop.belief import Belief
from trueup.loop.optimize import TrustRegion
from trueup.loop.worth import MOVED
from trueup.recording import is_command
from trueup.rounding import NEGLIGIBLE, ROUNDED
from trueup.tasks.task import Task


@dataclass(frozen=True, eq=False)
class Choice:
    """Which settings to run, best first, and what each adds."""

    rows: tuple[int, ...]
    gains: tuple[float, ...]
    """By how much each lowers the logarithm of the volume of what remains unsure; half of it in nats."""


def most_telling(
    task: Task, simulator: Simulator, belief: Belief, settings: Array, count: int, *, noise: float = 0.02,
    known: Sequence[int] = (),
) -> Choice:  # fmt: skip
    """Chooses `count` of the settings (s, m) whose trials tell most about the simulator's unsure parameters.

    `noise` is that of the measurements, as a share of each observed column's range; `known` rows have been run already.
    The same settings are not chosen twice. Raises CalibrationError where nothing can be simulated or is unsure.
    """
    if not len(belief.unsure):
        raise CalibrationError("no parameter of the simulator is unsure, so no run can tell anything about one")
    information = [_information(task, simulator, belief, row, noise) for row in np.atleast_2d(settings)]
    now = np.linalg.inv(belief.covariance + NEGLIGIBLE * np.eye(len(belief.unsure)))
    now = now + sum((information[k] for k in known), np.zeros_like(now))
    chosen: list[int] = []
    gains: list[float] = []
    for _ in range(min(count, len(information) - len(known))):
        before = np.linalg.slogdet(now)[1]
        found = [
            -np.inf if k in chosen or k in known else np.linalg.slogdet(now + extra)[1] - before
            for k, extra in enumerate(information)
        ]
        best = int(np.argmax(found))
        chosen.append(best)
        gains.append(float(found[best]))
        now = now + information[best]
    return Choice(tuple(chosen), tuple(gains))


def spread_settings(region: TrustRegion, count: int, rng: np.random.Generator) -> Array:
    """(count, m) points of a trust region in the unit box: its centre, then one in each slice of every axis."""
    m = len(region.centre)
    slices = np.stack([rng.permutation(count) for _ in range(m)], axis=1) if m else np.zeros((count, 0))
    points = region.outside((slices + rng.uniform(size=slices.shape)) / count)
    points[0] = region.centre
    return points


def _information(task: Task, simulator: Simulator, belief: Belief, setting: Array, noise: float) -> Array:
    """(f, f) information of the task's trials with one setting (m,); parameters in the unit box."""
    rows = np.concatenate([belief.values[None], belief.moved(MOVED)])
    tiled = np.concatenate([rows, np.repeat(setting[None], len(rows), axis=0)], axis=1)
    total = np.zeros((len(rows) - 1, len(rows) - 1))
    for rollout in simulator.rollout(task.trials, tiled, task.controllers):
        if rollout.failures:
            return np.zeros_like(total)  # a run that the simulator cannot finish is no experiment to plan on
        total += _information_in(rollout.held(), noise)
    return total


def _information_in(rollout: Rollout, noise: float) -> Array:
    most = 400  # samples of a channel that are looked at; more tell the same
    rows = next(iter(rollout.channels.values())).shape[0]
    total = np.zeros((rows - 1, rows - 1))
    for name, values in rollout.channels.items():
        if is_command(name):
            continue
        some = values[:, :: max(1, values.shape[1] // most)]
        span = np.ptp(some[0], axis=0)
        good = span > ROUNDED
        slopes = ((some[1:] - some[0]) / MOVED)[:, :, good] / (noise * span[good])
        flat = np.nan_to_num(slopes.reshape(rows - 1, -1))
        # Model errors last: the samples of a whole run are worth about as much as a hundredth of them would be.
        total += flat @ flat.T * (0.01 if some.shape[1] > 100 else 1.0 / max(1, some.shape[1]))
    return total
