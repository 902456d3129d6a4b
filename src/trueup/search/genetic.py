# SPDX-License-Identifier: Apache-2.0
"""A genetic algorithm over the unit box: selection with elitism, recombination, mutation.

The scheme that excitation papers use (population 150, genes in [0, 1]) with D. E. Goldberg, "Genetic Algorithms in
Search, Optimization and Machine Learning", 1989; real genes are recombined by blending (L. Eshelman and J. Schaffer,
"Real-coded genetic algorithms and interval-schemata", 1993).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.search.search import SearchState, same_search


class Genetic:
    """Asks for one generation at a time; the fittest few of all generations always take part in the next.

    Needs no slopes and no order of magnitude of the losses, only which candidates are better.
    """

    def __init__(
        self, start: Array, *, seed: int, population: int = 150, generations: int = 150, elite: int = 5,
        crossover: float = 0.9, blend: float = 0.3, mutated: float | None = None, spread: tuple[float, float] = (0.2, 0.002),
    ) -> None:  # fmt: skip
        """`start` (n,) is one individual of the first generation, the others are random.

        `crossover`: share of children with two parents; `blend`: how far a child's gene may lie outside its parents',
        in their distances; `mutated`: share of genes that mutate (default 1.5 / n); `spread`: standard deviation of a
        mutation in the first and in the last generation.
        """
        self._start = np.clip(np.asarray(start, dtype=np.float64), 0.0, 1.0)
        self._seed, self._population, self._generations, self._elite = seed, population, generations, elite
        self._crossover, self._blend, self._spread = crossover, blend, spread
        self._mutated = min(1.0, 1.5 / len(self._start)) if mutated is None else mutated
        self._rng = np.random.default_rng(seed)
        self._pool = np.zeros((0, len(self._start)))  # (m, n) the living, best first
        self._losses = np.zeros(0)
        self._generation = 0

    def ask(self) -> Array:
        """(population, n) in [0, 1]."""
        if not len(self._pool):
            first = self._rng.uniform(size=(self._population, len(self._start)))
            first[0] = self._start
            return first
        mothers, fathers = (self._pool[self._winners()] for _ in range(2))
        return np.clip(self._mutants(self._children(mothers, fathers)), 0.0, 1.0)

    def tell(self, candidates: Array, losses: Array) -> None:
        """Losses (population,); NaN dies out first."""
        told = np.where(np.isfinite(losses), losses, np.inf)
        pool = np.concatenate([self._pool[: self._elite], np.array(candidates, dtype=np.float64)])
        known = np.concatenate([self._losses[: self._elite], told])
        order = np.argsort(known, kind="stable")[: self._population]
        self._pool, self._losses = pool[order], known[order]
        self._generation += 1

    @property
    def done(self) -> str:
        """Why the search has ended, or ''."""
        if self._generation >= self._generations:
            return f"stopped after {self._generations} generations; more may help"
        return ""

    @property
    def best(self) -> tuple[Array, float]:
        """The fittest so far and its loss."""
        if not len(self._pool) or not np.isfinite(self._losses[0]):
            return self._start, np.inf
        return self._pool[0], float(self._losses[0])

    def state(self) -> SearchState:
        """The living with their losses (infinite ones as null), and the generator."""
        return {
            "seed": self._seed, "n": len(self._start), "generation": self._generation, "pool": self._pool.tolist(),
            "losses": [float(x) if np.isfinite(x) else None for x in self._losses],
            "random": self._rng.bit_generator.state,
        }  # fmt: skip

    def resume(self, state: SearchState) -> None:
        """Goes on from `state`. Raises CalibrationError where it belongs to another search."""
        same_search(state["seed"] == self._seed and state["n"] == len(self._start))
        self._pool = np.asarray(state["pool"], dtype=np.float64).reshape(-1, len(self._start))
        self._losses = np.array([np.inf if x is None else x for x in state["losses"]])
        self._generation = int(state["generation"])
        self._rng.bit_generator.state = state["random"]

    def _winners(self) -> NDArray[np.intp]:
        """(population,) parents by tournaments of three; the pool is sorted, so the least index wins."""
        return self._rng.integers(len(self._pool), size=(self._population, 3)).min(axis=1)

    def _children(self, mothers: Array, fathers: Array) -> Array:
        low, distance = np.minimum(mothers, fathers), np.abs(mothers - fathers)
        wide = 1.0 + 2.0 * self._blend
        mixed = low + distance * (self._rng.uniform(size=mothers.shape) * wide - self._blend)
        # Half of the genes of a child are blended, the others come whole from one parent: good pairs stay together.
        whole = np.where(self._rng.uniform(size=mothers.shape) < 0.75, mothers, fathers)
        children = np.where(self._rng.uniform(size=mothers.shape) < 0.5, mixed, whole)
        single = self._rng.uniform(size=len(mothers)) >= self._crossover
        children[single] = mothers[single]
        return children

    def _mutants(self, children: Array) -> Array:
        first, last = self._spread
        done = min(1.0, self._generation / max(1, self._generations - 1))
        hit = self._rng.uniform(size=children.shape) < self._mutated
        return children + hit * self._rng.standard_normal(children.shape) * first * (last / first) ** done
