# SPDX-License-Identifier: Apache-2.0
"""Whether a robot was the same all through a recording, or a load was taken up, a tool changed, a belt slipped.

One set of values cannot replay both parts of such a recording, and no residual says so: friction and gains take up what they
can of it. By the slopes where the fit ended each part is given values of its own, at every place where it may be cut, and
judged by stretches that these values did not see (a test of constancy: G. Chow, Econometrica 28, 1960, at an unknown place).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers
from trueup.evidence import FEWEST_PARTS, Evidence, explained
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.loop.segment import Segment, labelled
from trueup.loop.selection import compared
from trueup.samples import MOST
from trueup.verdicts import PRIOR

_STRETCHES = 4 * FEWEST_PARTS
"""A recording is cut into, of which each part has enough (`FEWEST_PARTS`)."""


@dataclass(frozen=True, eq=False)
class _Squares:
    """Sums over stretches (K,) of weighted residuals and their slopes."""

    curvature: Array
    """(K, n, n)."""
    slope: Array
    """(K, n)."""
    square: Array
    """(K,)."""

    def settled(self, stretches: Integers) -> Array:
        """(n,) the step to where these stretches are replayed best, by their slopes."""
        n = self.slope.shape[1]
        return -np.linalg.solve(
            self.curvature[stretches].sum(axis=0) + PRIOR * np.eye(n), self.slope[stretches].sum(axis=0)
        )

    def left_out(self, stretches: Integers) -> Array:
        """(len(stretches),) errors of each of these stretches, by values that all others of them settle at."""
        steps = [(k, self.settled(stretches[stretches != k])) for k in stretches]
        squares = [self.square[k] + 2.0 * self.slope[k] @ x + x @ self.curvature[k] @ x for k, x in steps]
        return np.sqrt(np.maximum(squares, 0.0))


def changes(problem: Problem, found: Fit) -> tuple[str, ...]:
    """A sentence for each recording within which the robot became another one, by its replays; none where these are noise."""
    if explained(found.residual) or problem.eliminated or not found.jacobian.size:
        return ()
    sentences = (_change(problem, found, k) for k in range(len(problem.recordings)))
    return tuple(said for said in sentences if said)


def _change(problem: Problem, found: Fit, recording: int) -> str:
    own = [s for s in problem.segments if s.recording == recording]
    if not own:
        return ""
    rows = np.concatenate([np.arange(s.columns.start, s.columns.stop) for s in own])
    times = np.concatenate([_times(problem, s) for s in own])
    edges = np.linspace(times.min(), times.max(), _STRETCHES + 1)
    which = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, _STRETCHES - 1)
    if len(np.unique(which)) < _STRETCHES:
        return ""
    root = np.sqrt(found.weights[rows])
    slopes, errors = found.jacobian[rows] * root[:, None], found.residual[rows] * root
    shown, cut, squares = _best_cut(slopes, errors, which)
    # Where a model has friction of another form, parts with other motion are replayed better by other values too, by less.
    if not shown.halves:
        return ""
    labels, numbers = labelled(problem.segments)
    names = _named(squares, cut, slopes, errors, which, labels, numbers[rows])
    return (
        f"within '{problem.recordings[recording].name}' the robot becomes another one about {edges[cut]:.4g} s: with values "
        f"of their own before and after, errors would be {100.0 * np.exp(-shown.gain):.0f} % of what they are (most at "
        f"{', '.join(names)}). Was a load taken up or put down, a tool changed, did something slip or get in the way? No "
        "values hold for both: make two logs of it, and calibrate with the one that is the robot"
    )


def _best_cut(slopes: Array, errors: Array, which: Integers) -> tuple[Evidence, int, _Squares]:
    """What is gained by values of their own before and after a stretch (with its number), where that is most."""
    parts = [(slopes[which == k], errors[which == k]) for k in range(_STRETCHES)]
    squares = _Squares(
        np.array([j.T @ j for j, _ in parts]),
        np.array([j.T @ r for j, r in parts]),
        np.array([r @ r for _, r in parts]),
    )
    every = np.arange(_STRETCHES)
    whole = squares.left_out(every)
    tried: list[tuple[float, int, Array]] = []
    for cut in range(FEWEST_PARTS, _STRETCHES - FEWEST_PARTS + 1):
        each = np.concatenate([squares.left_out(every[:cut]), squares.left_out(every[cut:])])
        tried.append((float(each @ each), cut, each))
    _, cut, each = min(tried, key=lambda t: t[0])
    return compared(whole, each), cut, squares


def _named(
    squares: _Squares, cut: int, slopes: Array, errors: Array, which: Integers, names: list[str], labels: Integers
) -> list[str]:
    """The labels that gain most of what the first of them does by values of their own before and after."""
    every = np.arange(_STRETCHES)
    steps = np.array([squares.settled(every[:cut]), squares.settled(every[cut:])])[(which >= cut).astype(int)]
    left = errors + np.einsum("mn,mn->m", slopes, steps)
    gains = np.bincount(labels, errors**2 - left**2, len(names))
    order = np.argsort(-gains).tolist()
    return [names[k] for k in order if gains[k] >= MOST * gains[order[0]]]


def _times(problem: Problem, segment: Segment) -> Array:
    """(count,) when each residual of a segment was measured, in s."""
    time = problem.trials[segment.trial].observed[segment.channel].time
    return np.broadcast_to(time[:, None], (segment.samples, len(segment.labels)))[segment.mask]
