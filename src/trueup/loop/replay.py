# SPDX-License-Identifier: Apache-2.0
"""Does a simulator replay recordings that it was not fitted to? The error of the main channel, in its own unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.discrepancies.discrepancy import Discrepancy
from trueup.discrepancies.weighted import Weighted
from trueup.errors import TrueupError
from trueup.loop.problem import Problem
from trueup.recording import Recording
from trueup.simulators.simulator import Simulator

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReplayError:
    """Root mean square of simulated minus measured, pooled; NaN where it cannot be simulated."""

    shipped: float
    calibrated: float
    unit: str


def replay_error(
    simulator: Simulator, values: Array, recordings: Sequence[Recording], *, discrepancy: Discrepancy | None = None,
    channels: Sequence[str] | None = None,
) -> ReplayError:  # fmt: skip
    """How well the simulator with `values` (n,) replays `recordings`, and how well as it came.

    NaN where the recordings hold nothing that it reproduces: a simulator may be good for scores only.
    """
    try:
        seen = sorted({c for r in recordings for c in simulator.observable(r)})
        measure = discrepancy or Weighted.estimated(recordings, seen)
        problem = Problem(simulator, recordings, measure, channels)
        unit = problem.main[1]
        shipped = Problem(simulator.shipped(), recordings, measure, channels)
        return ReplayError(
            _pooled(shipped, np.zeros((1, 0))), _pooled(problem, np.atleast_2d(values)), unit,
        )  # fmt: skip
    except (TrueupError, IndexError):
        return ReplayError(float("nan"), float("nan"), "")


def _pooled(problem: Problem, values: Array) -> float:
    residual = problem.residuals(values)[0]
    return problem.rmse(residual) if np.isfinite(residual).all() else float("nan")
