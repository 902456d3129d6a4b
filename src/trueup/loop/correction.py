# SPDX-License-Identifier: Apache-2.0
"""What the robot's own scores say of the simulator's: how far these are off, where, and how sure that is.

A Gaussian process over the task's parameters whose mean is the simulated score: A. Wilson, A. Fern and P. Tadepalli, Using
trajectory data to improve Bayesian optimization for reinforcement learning, JMLR 15, 2014; A. Marco et al., Virtual vs.
real, ICRA 2017.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import Simulator
from trueup.loop.gaussian_process import GaussianProcess
from trueup.tasks.task import Task, simulated_scores


@dataclass(frozen=True, eq=False)
class Correction:
    """Robot's score = simulated score + a Gaussian process; of positive scores, their logarithms."""

    process: GaussianProcess
    logs: bool

    @classmethod
    def of(
        cls, task: Task, simulator: Simulator, models: Array, units: Array, scores: Sequence[Array],
        fell: Sequence[bool] | None = None,
    ) -> Correction | None:  # fmt: skip
        """From what the robot showed with settings (r, m) of the unit box: scores of their runs, NaN where one has none.

        The simulated score is the mean over `models` (p, n). Settings with which the robot `fell` so that the task has no
        score for it count as the worst score of all. None where no score is known.
        """
        tried, down = np.atleast_2d(units), list(fell or [False] * len(scores))
        known = [np.asarray(s, dtype=np.float64)[np.isfinite(s)] for s in scores]
        if not any(len(s) for s in known):
            return None
        simulated = _mean(simulated_scores(task, simulator, models, task.parameters.from_unit(tried)))
        worst = float(np.nanmax([*(s.max() for s in known if len(s)), *simulated]))
        known = [np.append(s, worst) if d and not len(s) else s for s, d in zip(known, down, strict=True)]
        rows = [k for k, s in enumerate(known) if len(s) and np.isfinite(simulated[k])]
        if not rows:
            return None
        measured, counts = np.array([[known[k].mean(), len(known[k])] for k in rows]).T
        return cls.between(tried[rows], measured, simulated[rows], counts)

    @classmethod
    def between(cls, units: Array, measured: Array, simulated: Array, counts: Array | None = None) -> Correction:
        """From scores (r,) on the robot, means of `counts` runs, and those in the simulator, all of them finite."""
        logs = bool((measured > 0.0).all() and (simulated > 0.0).all())
        wrong = np.log(measured / simulated) if logs else measured - simulated
        return cls(GaussianProcess.of(units, wrong, counts), logs)

    def __call__(self, units: Array, means: Array, spreads: Array) -> tuple[Array, Array]:
        """(b,), (b,) what to expect on the robot, and how sure that is, of simulated means and spreads at (b, m)."""
        wrong, unsure = self.process(units)
        if not self.logs:
            return means + wrong, np.hypot(spreads, unsure)
        expected = np.where(means > 0.0, means * np.exp(np.minimum(wrong, 50.0)), means)
        return expected, np.hypot(spreads * expected / np.where(means == 0.0, 1.0, means), unsure * np.abs(expected))


def _mean(scores: Array) -> Array:
    """(b,) of scores (p, b), those that there are; NaN where there is none."""
    known = np.isfinite(scores)
    total = np.where(known, scores, 0.0).sum(axis=0)
    return np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)
