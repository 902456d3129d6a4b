# SPDX-License-Identifier: Apache-2.0
"""Where a learned model may be asked: as far from its rows as runs that were left out were from the others, no farther.

A distance is Mahalanobis', the leverage of a row up to a constant (Belsley, Kuh and Welsch, Regression Diagnostics, 1980,
chapter 2). One frame far away is nothing; how many there are in a row at most is seen in each of the recorded runs, left
out in turn, and what a further such run may show follows from these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.errors import counted
from trueup.grounding.comparison import folds_by_run
from trueup.grounding.linear import RESOLUTION
from trueup.grounding.rows import Rows
from trueup.rounding import ROUNDED

_REFUSED = 0.01  # of what is like the recorded: of frames, which lie further than what is called far; of runs


@dataclass(frozen=True, eq=False)
class Block:
    """Inputs that belong together (commands, positions, a sensor), and how far from their rows they may be."""

    name: str
    columns: Integers
    centre: Array
    whiten: Array
    """(m, r): offsets from the centre times this have unit covariance."""
    limit: float
    """Distance beyond which a frame is far: as for one in a hundred frames of runs left out."""
    patience: int
    """Frames in a row that may be far."""
    scale: Array
    """(m,) standard deviations."""
    low: Array
    high: Array
    """(m,) the range of each input in what was learned."""

    def distance(self, X: Array) -> Array:
        """(n,) in standard deviations."""
        return np.linalg.norm((X[:, self.columns] - self.centre) @ self.whiten, axis=1)


@dataclass(frozen=True, eq=False)
class Domain:
    """The blocks of all inputs."""

    names: tuple[str, ...]
    """(d,) of the inputs."""
    blocks: tuple[Block, ...]

    def far(self, X: Array) -> Mask:
        """(n, blocks) which frames are far in which block."""
        return np.stack([b.distance(X) > b.limit for b in self.blocks], axis=1)

    @property
    def patience(self) -> Integers:
        """(blocks,) frames in a row that may be far."""
        return np.array([b.patience for b in self.blocks])

    def reason(self, x: Array, block: int, frames: int) -> str:
        """Why a run is refused, with the input of its present frame (d,) that is farthest off, in units of its range."""
        b = self.blocks[block]
        own = x[b.columns]
        beyond = np.maximum(b.low - own, own - b.high) / np.maximum(b.high - b.low, b.scale)
        outside = float(beyond.max()) > 0.0
        offset = own - b.centre
        # Its share of the squared distance, where no input by itself is strange.
        worst = int(np.argmax(beyond if outside else offset * (b.whiten @ (offset @ b.whiten))))
        column = int(b.columns[worst])
        return (
            f"'{b.name}' was outside of what was learned for {counted(frames, 'frame')} in a row (at most {b.patience}); "
            f"{'farthest is' if outside else 'each input is within its range, and together they are strange, most of all'} "
            f"{self.names[column]} = {x[column]:.4g}, learned from {b.low[worst]:.4g} to {b.high[worst]:.4g}"
        )


def domain_of(rows: Rows) -> Domain:
    """The domain of rows, its limits from left-out runs."""
    folds = folds_by_run(rows)
    blocks = rows.inputs.blocks
    share = _REFUSED / len(blocks)  # Bonferroni
    return Domain(rows.inputs.names, tuple(_block(n, c, rows, folds, share) for n, c in blocks.items()))


def _block(name: str, columns: Integers, rows: Rows, folds: Sequence[Integers], refused: float) -> Block:
    V = rows.X[:, columns]
    distance = np.empty(len(V))
    for left_out in folds:
        kept = np.delete(V, left_out, axis=0)
        centre, whiten, _ = _shape(kept)
        distance[left_out] = np.linalg.norm((V[left_out] - centre) @ whiten, axis=1)
    limit = float(np.quantile(distance, 1.0 - _REFUSED))
    longest = [_longest(distance[rows.run == run] > limit) for run in np.unique(rows.run)]
    centre, whiten, scale = _shape(V)
    return Block(name, columns, centre, whiten, limit, _exceeded(longest, refused), scale, V.min(axis=0), V.max(axis=0))


def _exceeded(lengths: Sequence[int], share: float) -> int:
    """What a further one of these lengths exceeds with a probability of `share`, were they exponential.

    The mean of R lengths is chi-squared with 2 R degrees of freedom, so a further one over it is F-distributed with 2 and
    2 R (G. Hahn and W. Meeker, Statistical Intervals, 1991, section 4.7): P(x > t) = (1 + t / (R mean))^-R.
    """
    R, mean = len(lengths), max(float(np.mean(lengths)), 1.0)
    return int(np.ceil(R * mean * (share ** (-1.0 / R) - 1.0)))


def _shape(V: Array) -> tuple[Array, Array, Array]:
    """Centre (m,), whitening (m, r) and standard deviations (m,) of rows (n, m)."""
    centre, scale = V.mean(axis=0), V.std(axis=0)
    scale = np.maximum(scale, max(RESOLUTION * float(scale.max()), ROUNDED))
    values, vectors = np.linalg.eigh((V - centre).T @ (V - centre) / len(V) / np.outer(scale, scale))
    return centre, vectors / np.sqrt(np.maximum(values, RESOLUTION**2)) / scale[:, None], scale


def _longest(far: Mask) -> int:
    """How many frames in a row are far at most."""
    edges = np.diff(np.concatenate([[0], far.astype(np.int64), [0]]))
    lengths = np.flatnonzero(edges < 0) - np.flatnonzero(edges > 0)
    return int(lengths.max(initial=0))
