# SPDX-License-Identifier: Apache-2.0
"""Where candidates were simulated on the way of a search, and what they cost: a likelihood that needs no slopes."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import InPlaceOf, Simulator, Stretched
from trueup.noise import spread
from trueup.search.least_squares import LeastSquares
from trueup.search.robust import robust_losses


def stretched(simulator: Simulator) -> Stretched | None:
    """What predicts trials in stretches; None where they are replayed whole."""
    while isinstance(simulator, InPlaceOf):
        simulator = simulator.whole
    return simulator if isinstance(simulator, Stretched) else None


class Visited:
    """Candidates and their losses, where trials are predicted in stretches; of others nothing is kept."""

    def __init__(self, simulator: Simulator) -> None:
        self._kept = stretched(simulator) is not None
        self._values: list[Array] = []
        self._losses: list[Array] = []

    def add(self, values: Array, residuals: Array) -> None:
        """Candidates (b, n) with their residuals (b, m); those whose simulation failed are forgotten."""
        told = np.isfinite(residuals).all(axis=1) if self._kept else np.zeros(len(residuals), dtype=bool)
        if not told.any():
            return
        residuals = residuals[told]
        lowest = residuals[np.argmin(np.einsum("bm,bm->b", residuals, residuals))]
        self._values.append(np.array(values)[told])
        self._losses.append(robust_losses(residuals, LeastSquares.robust * max(float(spread(lowest)), 1.0)))

    def below(self, loss: float) -> Array:
        """(k, n) the candidates that cost no more."""
        losses = np.concatenate([np.zeros(0), *self._losses])
        return np.concatenate(self._values)[losses <= loss] if len(losses) else np.zeros((0, 0))
