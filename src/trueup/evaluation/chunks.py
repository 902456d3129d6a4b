# SPDX-License-Identifier: Apache-2.0
"""Rows shared out in chunks: how large, how long they may take, and what becomes of those that were lost.

Without a word of what computes them: the same rules serve a cluster and the plan of one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np


@dataclass(frozen=True)
class Chunk:
    """Rows from `start` to before `stop`."""

    start: int
    stop: int
    losses: int = 0
    """How often they were lost in chunks as small."""

    def __len__(self) -> int:
        return self.stop - self.start

    @property
    def alone(self) -> bool:
        """Whether it is a single row that was lost alone."""
        return len(self) == 1 and self.losses > 0


@dataclass
class Pace:
    """What chunks of one kind of work took: seconds = fixed + each * rows / threads."""

    grace: float = 5.0
    """Seconds that a chunk may take beside its work."""
    patience: float = 3.0
    """Times the expected time, after which it counts as hung."""
    sizes: list[float] = field(default_factory=list)
    """Rows a thread."""
    seconds: list[float] = field(default_factory=list)

    def took(self, rows: int, threads: int, seconds: float) -> None:
        """One more chunk."""
        self.sizes.append(rows / threads)
        self.seconds.append(seconds)

    def fitted(self) -> tuple[float, float]:
        """`fixed` and `each`, by least squares, neither below 0; (0, 0) where nothing is known."""
        if not self.sizes:
            return 0.0, 0.0
        sizes, seconds = np.array(self.sizes), np.array(self.seconds)
        through_zero = float(seconds @ sizes / (sizes @ sizes))
        if np.ptp(sizes) == 0.0:
            return 0.0, through_zero
        each, fixed = np.polyfit(sizes, seconds, 1).tolist()
        if fixed < 0.0:
            return 0.0, through_zero
        return (fixed, each) if each > 0.0 else (float(seconds.mean()), 0.0)

    def limit(self, chunk: Chunk, threads: int) -> float:
        """After how many seconds a chunk counts as hung; endless while nothing is known.

        Several times what the slowest chunk took, more rows in proportion: any single row may have taken all of it. Twice as
        long after each loss: the cluster may have become slower.
        """
        rows, seen = len(chunk) / threads, zip(self.sizes, self.seconds, strict=True)
        slowest = max((s * max(1.0, rows / n) for n, s in seen), default=math.inf)
        return (self.grace + self.patience * slowest) * 2.0**chunk.losses

    def most(self, threads: int, between: float) -> int:
        """Rows of a chunk where a worker is lost every `between` s on average: the best interval between checkpoints.

        J. W. Young, "A first order approximation to the optimum checkpoint interval", Communications of the ACM 17(9), 1974.
        """
        fixed, each = self.fitted()
        if not each or math.isinf(between):
            return 1 << 62
        lasting = math.sqrt(2.0 * max(fixed, each / threads) * between)
        return max(1, int(threads * max(lasting - fixed, 0.0) / each))


@dataclass
class Hazard:
    """How often workers are lost."""

    worked: float = 0.0
    """s that all workers worked."""
    losses: int = 0

    @property
    def between(self) -> float:
        """Seconds of one worker's work between two losses; endless where there was none."""
        return self.worked / self.losses if self.losses else math.inf


class Chunks:
    """The rows of one evaluation: not yet handed out, under way, scored or given up.

    Each worker gets its share at once. With few workers and a part of each chunk's time that does not depend on its size
    (controllers in Python) equal shares are within a few percent of the best: C. P. Kruskal and A. Weiss, "Allocating
    independent subtasks on parallel processors", IEEE Transactions on Software Engineering 11(10), 1985. What is lost is
    handed out again in smaller chunks, after all else, until the row that does it is alone.
    """

    def __init__(self, rows: int, pace: Pace, hazard: Hazard) -> None:
        self.rows, self.pace, self.hazard = rows, pace, hazard
        self._fresh, self._again = 0, list[Chunk]()
        self._settled: set[int] = set()
        self.given_up: dict[int, str] = {}

    @property
    def scored(self) -> int:
        """Rows that are done."""
        return len(self._settled) - len(self.given_up)

    @property
    def settled(self) -> bool:
        """Whether every row is done or given up."""
        return len(self._settled) == self.rows

    def take(self, threads: int, whole: int, *, risky: bool = True) -> Chunk | None:
        """The next chunk for a worker with so many of the `whole` threads; None where nothing is left for it.

        Without `risky`, nothing that was lost alone.
        """
        most = self.pace.most(threads, self.hazard.between)
        if self._fresh < self.rows:
            count = min(most, max(1, math.ceil(self.rows * threads / max(whole, threads))))
            chunk = Chunk(self._fresh, min(self.rows, self._fresh + count))
            self._fresh = chunk.stop
            return chunk
        for k, chunk in enumerate(self._again):
            if risky or not chunk.alone:
                del self._again[k]
                return chunk
        return None

    def settle(self, chunk: Chunk) -> None:
        """A chunk came back."""
        self._settled.update(range(chunk.start, chunk.stop))

    def lost(self, chunk: Chunk, why: str) -> None:
        """A chunk did not come back: again, in pieces, after what was lost less often; a row that is alone is given up."""
        alone = 3  # times that a single row may be lost before it is given up
        if len(chunk) > 1:
            size = 1 if chunk.losses else math.isqrt(len(chunk))
            edges = [*range(chunk.start, chunk.stop, size), chunk.stop]
            self._put_back(Chunk(a, b, int(b - a > 1)) for a, b in pairwise(edges))
        elif chunk.losses + 1 < alone:
            self._put_back([replace(chunk, losses=chunk.losses + 1)])
        else:
            self._give_up(chunk, why)

    def returned(self, chunk: Chunk) -> None:
        """A chunk was never begun."""
        self._put_back([chunk])

    def abandon(self, why: str) -> None:
        """Gives up what was lost alone, where it cannot be tried again without harm."""
        for chunk in [c for c in self._again if c.alone]:
            self._again.remove(chunk)
            self._give_up(chunk, why)

    def _give_up(self, chunk: Chunk, why: str) -> None:
        self.given_up[chunk.start] = why
        self._settled.add(chunk.start)

    def _put_back(self, chunks: Iterable[Chunk]) -> None:
        self._again = sorted([*self._again, *chunks], key=lambda c: (c.alone, c.losses, c.start))
