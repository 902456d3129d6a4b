# SPDX-License-Identifier: Apache-2.0
"""CMA-ES for cheap losses of many parameters: a whole generation in a few matrix products, no bookkeeping beside it.

N. Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv 1604.00772, with its negative weights; equation numbers are
of that text. Where a loss takes 0.1 ms, the bookkeeping of a full-featured package takes ten times as long as that.
"""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.rounding import TINY
from trueup.search.search import SearchState, same_search


class Evolution:
    """Asks for generations of candidates; the box is mirrored at its walls, so that no candidate is ever moved or lost."""

    def __init__(
        self, start: Array, *, seed: int, sigma: float = 0.3, population: int | None = None, most: int = 20000
    ) -> None:
        """`most` evaluations; it ends when 40 generations differ by less than 1e-5 times 1 + |loss| in their best."""
        self._mean = np.clip(np.asarray(start, dtype=np.float64), 0.0, 1.0)
        n = len(self._mean)
        self._seed, self._sigma, self._most, self._tolerance = seed, sigma, most, 1e-5
        self._rng = np.random.default_rng(seed)
        self._count = population or 4 + int(3 * np.log(n)) + 4
        self._constants()
        self._C, self._B, self._D = np.eye(n), np.eye(n), np.ones(n)
        self._pc, self._ps, self._z = np.zeros(n), np.zeros(n), np.zeros((0, n))
        self._generation, self._evaluations, self._stale, self._flat = 0, 0, 0, 40
        self._best, self._best_loss, self._recent, self._done = self._mean, np.inf, [], ""

    def ask(self) -> Array:
        """(population, n) in [0, 1]."""
        self._z = self._rng.standard_normal((self._count, len(self._mean)))
        return _mirrored(self._mean + self._sigma * self._steps())

    def tell(self, candidates: Array, losses: Array) -> None:
        """Losses (population,); NaN counts as worse than all others."""
        told = np.where(np.isfinite(losses), losses, np.inf)
        order = np.argsort(told, kind="stable")
        self._evaluations += len(told)
        self._generation += 1
        if told[order[0]] < self._best_loss:
            self._best, self._best_loss = np.array(candidates[order[0]]), float(told[order[0]])
        self._recent = [*self._recent, float(told[order[0]])][-self._flat :]
        if np.isfinite(told).any():
            self._move(self._steps()[order])
        self._check()

    @property
    def done(self) -> str:
        """Why the search has ended, or ''."""
        return self._done

    @property
    def best(self) -> tuple[Array, float]:
        """The best candidate and its loss."""
        return self._best, self._best_loss

    def state(self) -> SearchState:
        """Everything, generator included."""
        return {
            "seed": self._seed, "mean": self._mean.tolist(), "sigma": self._sigma, "C": self._C.tolist(),
            "B": self._B.tolist(), "D": self._D.tolist(), "pc": self._pc.tolist(), "ps": self._ps.tolist(),
            "counts": [self._generation, self._evaluations, self._stale], "best": self._best.tolist(),
            "recent": [x if np.isfinite(x) else None for x in [self._best_loss, *self._recent]], "done": self._done,
            "random": self._rng.bit_generator.state,
        }  # fmt: skip

    def resume(self, state: SearchState) -> None:
        """Goes on from `state`. Raises CalibrationError where it belongs to another search."""
        same_search(state["seed"] == self._seed and len(state["mean"]) == len(self._mean))
        self._mean, self._sigma, self._C = np.array(state["mean"]), float(state["sigma"]), np.array(state["C"])
        self._B, self._D = np.array(state["B"]), np.array(state["D"])
        self._pc, self._ps, self._best = (np.array(state[k]) for k in ("pc", "ps", "best"))
        self._generation, self._evaluations, self._stale = (int(x) for x in state["counts"])
        self._best_loss, *self._recent = [np.inf if x is None else float(x) for x in state["recent"]]
        self._done, self._rng.bit_generator.state = str(state["done"]), state["random"]

    def _constants(self) -> None:
        """Weights and rates, eqs. 49-58."""
        n, count = len(self._mean), self._count
        raw = np.log((count + 1) / 2) - np.log(np.arange(1, count + 1))
        good = raw > 0
        mu = raw[good].sum() ** 2 / (raw[good] ** 2).sum()
        mu_bad = raw[~good].sum() ** 2 / (raw[~good] ** 2).sum()
        self._cc = (4 + mu / n) / (n + 4 + 2 * mu / n)
        self._cs = (mu + 2) / (n + mu + 5)
        self._c1 = 2 / ((n + 1.3) ** 2 + mu)
        self._cmu = min(1 - self._c1, 2 * (0.25 + mu + 1 / mu - 2) / ((n + 2) ** 2 + mu))
        self._ds = 1 + 2 * max(0.0, np.sqrt((mu - 1) / (n + 1)) - 1) + self._cs
        least = min(1 + self._c1 / self._cmu, 1 + 2 * mu_bad / (mu + 2), (1 - self._c1 - self._cmu) / (n * self._cmu))
        self._weights = np.where(good, raw / raw[good].sum(), least * raw / np.abs(raw[~good]).sum())
        self._mu, self._good = mu, int(good.sum())
        self._length = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n))

    def _steps(self) -> Array:
        """(population, n) steps in units of sigma, eq. 39."""
        return (self._z * self._D) @ self._B.T

    def _move(self, y: Array) -> None:
        """Mean, step size and covariance from steps sorted by loss, eqs. 41-47."""
        n, w = len(self._mean), self._weights
        shift = w[: self._good] @ y[: self._good]
        self._mean = _mirrored(self._mean + self._sigma * shift) if self._generation % 50 == 0 else (
            self._mean + self._sigma * shift
        )  # fmt: skip
        whitened = ((shift @ self._B) / self._D) @ self._B.T
        self._ps = (1 - self._cs) * self._ps + np.sqrt(self._cs * (2 - self._cs) * self._mu) * whitened
        size = float(np.linalg.norm(self._ps))
        slow = size / np.sqrt(1 - (1 - self._cs) ** (2 * self._generation)) < (1.4 + 2 / (n + 1)) * self._length
        self._pc = (1 - self._cc) * self._pc + slow * np.sqrt(self._cc * (2 - self._cc) * self._mu) * shift
        lengths = (((y @ self._B) / self._D) ** 2).sum(axis=1)
        weights = np.where(w >= 0, w, w * n / np.maximum(lengths, TINY))
        keep = 1 - self._c1 - self._cmu * w.sum() + (0 if slow else self._c1 * self._cc * (2 - self._cc))
        self._C = keep * self._C + self._c1 * np.outer(self._pc, self._pc) + self._cmu * (y.T * weights) @ y
        self._sigma *= float(np.exp(min(1.0, self._cs / self._ds * (size / self._length - 1))))
        self._stale += 1
        if self._stale * (self._c1 + self._cmu) * n * 10 >= 1:
            self._stale = 0
            self._C = 0.5 * (self._C + self._C.T)
            values, self._B = np.linalg.eigh(self._C)
            self._D = np.sqrt(np.maximum(values, 1e-20))

    def _check(self) -> None:
        flat = len(self._recent) == self._flat and np.ptp(self._recent) < self._tolerance * (1.0 + abs(self._best_loss))
        if self._evaluations >= self._most:
            self._done = f"stopped after {self._most} evaluations; more may help"
        elif flat or self._sigma * float(self._D.max()) < 1e-7:
            self._done = "converged: the generations no longer differ"


def _mirrored(points: Array) -> Array:
    """Points folded into the box, as a ray of light between two mirrors."""
    return 1.0 - np.abs(1.0 - np.mod(points, 2.0))
