# SPDX-License-Identifier: Apache-2.0
"""What is foretold of a run that was left out, to be looked at."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from trueup.arrays import Array
from trueup.grounding.comparison import MOST, Score, chained, folds_by_run
from trueup.grounding.learners import Learner
from trueup.grounding.rows import Rows
from trueup.grounding.views import fitted
from trueup.trial import SETTLE

_SHOWN = 4
"""Chains of a second that are shown."""


@dataclass(frozen=True, eq=False)
class Foretold:
    """n frames of k joints, in the unit of the recordings."""

    run: str
    time: Array
    """(n,) s from the first frame shown; what is foretold begins anew at the measured value every `SETTLE` s."""
    command: Array
    """(n, k) commands, one frame before."""
    measured: Array
    foretold: Array
    """(n, k) positions."""

    def plain(self) -> dict[str, object]:
        """As lists, with the seconds after which it begins anew."""
        arrays = {name: getattr(self, name).tolist() for name in ("time", "command", "measured", "foretold")}
        return {"run": self.run, "ahead": SETTLE, **arrays}


def foretold(learner: Learner, rows: Rows, view: str, taken: Score, seed: int) -> Foretold:
    """The liveliest seconds of the run that is foretold as well as half of those left out are, from all others.

    `taken` is the learner's score on them.
    """
    folds = folds_by_run(rows)
    k = int(np.argsort(taken.ahead, kind="stable")[len(folds) // 2])
    kept = np.setdiff1d(np.arange(len(rows.X)), folds[k])
    model = fitted(learner, rows.where(kept).thinned(MOST), np.random.default_rng([seed, k]), view)
    part = rows.where(folds[k])
    said, each = chained(model, part), max(round(SETTLE / rows.inputs.period), 1)
    first, last = _liveliest(part, _SHOWN * each, each)
    shown = slice(first, last)
    asked = part.X[shown, rows.inputs.command_columns]
    time = rows.inputs.period * np.arange(last - first, dtype=np.float64)
    return Foretold(rows.names[part.run[first]], time, asked, part.Y[shown], said[shown])


def _liveliest(rows: Rows, count: int, each: int) -> tuple[int, int]:
    """The first and behind the last of at most `count` frames, one following the other, in which outputs go farthest."""
    breaks = np.flatnonzero((np.diff(rows.run) != 0) | (np.diff(rows.frame) != 1)) + 1
    edges = np.concatenate([[0], breaks, [len(rows.X)]])
    found = []
    for first, last in pairwise(edges.tolist()):
        for begin in range(first, max(last - count, first) + 1, each):
            end = min(begin + count, last)
            found.append((float(np.sum(np.ptp(rows.Y[begin:end], axis=0) / rows.spread)), -begin, end))
    _, begin, end = max(found)
    return -begin, end
