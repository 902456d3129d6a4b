# SPDX-License-Identifier: Apache-2.0
"""How often walks fall on the robot: ranked by doubtful simulators, read by the robot's own runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.engines.simulator import Rollout, Simulator
from trueup.evaluation.evaluator import Evaluator, Here
from trueup.studies.walk.odds import Odds
from trueup.tasks.task import simulated_scores
from trueup.tasks.walking import WalkFront


@dataclass(frozen=True, kw_only=True, eq=False)
class Falling(WalkFront):
    """The share of runs that fall, as a loss."""

    def score(self, rollouts: Sequence[Rollout]) -> Array:
        """(b,) shares."""
        return np.mean([self.risk(r) for r in rollouts], axis=0)


@dataclass(frozen=True, eq=False)
class Falls:
    """Signals are logarithms of the shares of falls in points of the doubt; `odds` say what they mean on the robot.

    A search pays for the signal, in few points, drawn anew for each generation and alike for all of its candidates: points
    differ more than walks do, which cancels in a ranking by what is linear in it. The price is what the falls that are
    expected cost more with each unit of the signal, where as many are expected as are allowed: a chance constraint with its
    multiplier at that place.
    """

    simulator: Simulator
    walk: Falling
    points: Array
    """(p, n) of the simulator's parameters."""
    chances: Array
    """(p,) of these."""
    odds: Odds
    fall: float
    """m/s that a fall costs."""
    allowed: float = 0.03
    """Share of runs that may fall."""
    few: int = 8
    """Points that a generation meets."""

    @property
    def price(self) -> float:
        """m/s for each unit of the signal."""
        return self.fall * self.allowed * (1.0 - self.allowed) * self.odds.slope

    def few_signals(self, candidates: Array, seed: int, evaluator: Evaluator) -> Array:
        """(b,) signals of candidates (b, m), by few points."""
        places = drawn(self.chances, self.few, np.random.default_rng([seed, self.few]))
        return _signals(self.simulator, replace(self.walk, seed=seed), self.points[places], candidates, evaluator)

    def cost(self, signals: Array) -> Array:
        """(b,) m/s of candidates (b,): what is expected at their mean, and the price of each unit beside it."""
        mean = signals.mean()
        return self.fall * self.odds(mean[None]) + self.price * (signals - mean)

    def signals(self, candidates: Array) -> Array:
        """(b,) signals of candidates (b, m), by all points."""
        return _signals(self.simulator, self.walk, self.points, candidates, Here(), self.chances)


def _signals(
    simulator: Simulator, walk: Falling, points: Array, candidates: Array, evaluator: Evaluator,
    chances: Array | None = None,
) -> Array:  # fmt: skip
    """A quarter of a fall in half a run is added to those that there were: shares of nothing have no logarithm."""
    shares = np.nan_to_num(simulated_scores(walk, simulator, points, candidates, evaluator), nan=1.0)
    mean = shares.mean(axis=0) if chances is None else chances @ shares
    return np.log((len(points) * mean + 0.25) / (len(points) + 0.5))


def drawn(chances: Array, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """(count,) of p by their chances, evenly spaced along their sum, so that each comes about as often as it should."""
    edges = (rng.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(chances), edges), len(chances) - 1)
