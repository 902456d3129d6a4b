# SPDX-License-Identifier: Apache-2.0
"""CMA-ES over the unit box, by pycma, with restarts: of growing population (IPOP), or small and large in turn (BIPOP).

N. Hansen, "The CMA Evolution Strategy: A Tutorial"; restarts: A. Auger and N. Hansen, IEEE CEC 2005, and N. Hansen, GECCO
2009 (workshop on black-box optimization benchmarking).
"""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.errors import unknown_name
from trueup.search.search import SearchState, same_search

REGIMES = ("ipop", "bipop")


class CmaEs:
    """Asks for generations of candidates; needs no slopes, only which candidates are better.

    Resuming replays the told losses with the same seed, so that a resumed search equals an uninterrupted one.
    """

    def __init__(
        self, start: Array, *, seed: int, sigma: float = 0.2, population: int | None = None, restarts: int = 1,
        max_evaluations: int = 4000, tolerance: float = 1e-4, regime: str = "ipop", generations: int | None = None,
        guess: bool = False,
    ) -> None:  # fmt: skip
        """A run ends when 12 generations differ by less than `tolerance`, or after `generations`.

        Then up to `restarts` others begin anywhere in the box, or at the start again where that is a good `guess`. 'ipop':
        each with twice the population. 'bipop': in turn so, and with a small population and step, whichever of the two has
        spent less so far. Raises UnknownNameError for another regime.
        """
        if regime not in REGIMES:
            raise unknown_name("regime", regime, REGIMES, "the restarts of CMA-ES")
        self._start = np.clip(np.asarray(start, dtype=np.float64), 0.02, 0.98)
        self._seed, self._sigma = seed, sigma
        self._population = population or 4 + int(3 * math.log(max(2, len(self._start)))) + 4
        self._restarts_left, self._max, self._tolerance = restarts, max_evaluations, tolerance
        self._regime, self._longest, self._guess = regime, generations, guess
        self._first, self._large = self._population, self._population
        self._spent = {"large": 0, "small": 0}
        self._now, self._most, self._begun = "large", math.inf, 0
        self._rng = np.random.default_rng(seed)
        self._told: list[list[float]] = []
        self._evaluations = 0
        self._best, self._best_loss = self._start, np.inf
        self._done = ""
        self._engine = self._new(self._start, sigma)
        self._asked = np.zeros((0, len(self._start)))

    def ask(self) -> Array:
        """(population, n) in [0, 1]."""
        self._asked = np.clip(np.array(self._engine.ask()), 0.0, 1.0)
        return self._asked[:, : len(self._start)]

    def tell(self, candidates: Array, losses: Array) -> None:
        """Losses (population,); NaN counts as worse than all others."""
        given = np.asarray(losses, dtype=np.float64)
        finite = given[np.isfinite(given)]
        worst = float(finite.max()) * 2.0 + 1.0 if len(finite) else 1e12
        filled = np.where(np.isfinite(given), given, worst)
        self._told.append([float(x) for x in filled])
        self._evaluations += len(filled)
        k = int(filled.argmin())
        if filled[k] < self._best_loss and np.isfinite(given[k]):
            self._best, self._best_loss = np.array(candidates[k]), float(filled[k])
        whole = [np.concatenate([c, a[len(c) :]]) for c, a in zip(candidates, self._asked, strict=True)]
        self._engine.tell(whole, filled.tolist())
        self._check()

    @property
    def done(self) -> str:
        """Why the search has ended, or ''."""
        return self._done

    @property
    def best(self) -> tuple[Array, float]:
        """The best candidate and its loss."""
        return self._best, self._best_loss

    @property
    def centre(self) -> Array:
        """(n,) the mean of the distribution: where losses are noisy, often better than the luckiest candidate."""
        return np.clip(np.asarray(self._engine.mean, dtype=np.float64), 0.0, 1.0)[: len(self._start)]

    def state(self) -> SearchState:
        """The seed and every loss told."""
        return {"seed": self._seed, "n": len(self._start), "told": self._told}

    def resume(self, state: SearchState) -> None:
        """Replays the told losses. Raises CalibrationError where the state belongs to another search."""
        same_search(state["seed"] == self._seed and state["n"] == len(self._start))
        for losses in state["told"]:
            self.tell(self.ask(), np.array(losses))

    def _new(self, start: Array, sigma: float) -> Any:
        # The engine has no single dimension: a second one without effect stands in.
        with warnings.catch_warnings():  # it tells everybody that it cannot plot, who did not ask
            warnings.simplefilter("ignore", UserWarning)
            import cma  # with all of matplotlib, where that is installed: half a second that few commands need

        return cma.CMAEvolutionStrategy(
            [*start.tolist(), *[0.5] * (2 - len(start))], sigma,
            {
                "bounds": [0.0, 1.0], "popsize": self._population, "verbose": -9, "seed": math.nan,
                "randn": lambda *shape: self._rng.standard_normal(shape), "tolfun": 0.0, "tolx": 1e-5,
                "maxfevals": self._max,
            },
        )  # fmt: skip

    def _check(self) -> None:
        run = self._told[self._begun :]
        spent = sum(map(len, run))
        recent = [min(t) for t in run[-12:]]
        flat = len(recent) == 12 and (max(recent) - min(recent)) < self._tolerance * abs(min(recent))
        if self._evaluations >= self._max:
            self._done = f"stopped after {self._max} evaluations; more may help"
        elif flat or len(run) == self._longest or spent >= self._most or self._engine.stop():
            if self._restarts_left <= 0:
                cut = not flat and len(run) == self._longest
                self._done = (
                    f"stopped after {len(run)} generations; more may help"
                    if cut
                    else "converged: the generations no longer differ"
                )
                return
            self._spent[self._now] += spent
            self._restart()

    def _restart(self) -> None:
        self._restarts_left -= 1
        self._begun = len(self._told)
        sigma = self._sigma
        self._now = "small" if self._regime == "bipop" and self._spent["small"] < self._spent["large"] else "large"
        if self._now == "large":
            self._large *= 2
            self._population, self._most = self._large, math.inf
        else:  # Hansen 2009, section 3: sizes and steps drawn towards small ones, half of the budget of the last large run
            share, narrow = self._rng.uniform(size=2)
            self._population = max(4, int(self._first * (0.5 * self._large / self._first) ** (share**2)))
            self._most, sigma = self._spent["large"] / 2, sigma * 10.0 ** (-2.0 * narrow)
        begun = self._start if self._guess else self._rng.uniform(0.05, 0.95, len(self._start))
        self._engine = self._new(begun, sigma)
