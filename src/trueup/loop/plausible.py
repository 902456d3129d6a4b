# SPDX-License-Identifier: Apache-2.0
"""Samples of what a calibration leaves open, less those that what the robot has shown already rules out."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import Simulator
from trueup.tasks.task import Task, simulated_scores


def plausible(
    task: Task, simulator: Simulator, models: Array, tried: Array, measured: Array, count: int, *, within: float = 1.5
) -> Array:
    """(count, n) of the samples `models` (p, n): the first ones that foretell the robot's scores within a factor.

    `tried` (c, m) are settings of the controller that the robot was run with, `measured` (c,) its scores, positive; NaN
    ones are left out. A replay of commands says little about how close a closed loop is to its limit; these runs do, and
    a sample in which the robot would long have lost its path only makes the search timid. The factor is `within`, or a
    half more than that of the first model where even that one is further off. Too few: the next best fill up.
    """
    known = np.isfinite(measured)
    if not known.any() or len(models) <= count:
        return models[:count]
    scores = simulated_scores(task, simulator, models, np.atleast_2d(tried)[known])
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.abs(np.log(scores / np.asarray(measured)[known])).mean(axis=1)
    apart = np.where(np.isfinite(apart), apart, np.inf)
    limit = max(np.log(within), 1.5 * apart[0] if np.isfinite(apart[0]) else 0.0)
    good = np.flatnonzero(apart <= limit)[:count]
    rest = [k for k in np.argsort(apart, kind="stable") if k not in good][: count - len(good)]
    return models[np.concatenate([good, np.array(rest, dtype=np.intp)])]
