# SPDX-License-Identifier: Apache-2.0
"""Whether a robot was the same all through a recording, and in all of them, or a load was taken up, a belt slipped.

One set of values cannot replay both parts of such a recording, and no residual says so: friction and gains take up what they
can of it. By the slopes where the fit ended each part is given values of its own, at every place where it may be cut, and
judged by stretches that these values did not see (a test of constancy: G. Chow, Econometrica 28, 1960, at an unknown place).
The same is asked of recordings: one, and those that are best replayed with it, against all others. Replays by these values
must show it too: slopes promise much where replays part on their own, as of a pole that goes over the top.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.calibration import Estimate
from trueup.evidence import FEWEST_PARTS, HALVED, Evidence, explained
from trueup.loop.descent import Fit
from trueup.loop.problem import Problem
from trueup.loop.segment import Segment, labelled
from trueup.loop.selection import compared
from trueup.rounding import ROUNDED
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

    @classmethod
    def of(cls, slopes: Array, errors: Array, which: Integers, count: int) -> _Squares:
        """Of slopes (m, n) and errors (m,), each in one of so many stretches (m,)."""
        parts = [(slopes[which == k], errors[which == k]) for k in range(count)]
        curvature, slope = np.array([j.T @ j for j, _ in parts]), np.array([j.T @ r for j, r in parts])
        return cls(curvature, slope, np.array([r @ r for _, r in parts]))

    def settled(self, stretches: Integers) -> Array:
        """(n,) the step to where these stretches are replayed best, by their slopes."""
        n = self.slope.shape[1]
        return -np.linalg.solve(
            self.curvature[stretches].sum(axis=0) + PRIOR * np.eye(n), self.slope[stretches].sum(axis=0)
        )

    def least(self, stretches: Integers) -> float:
        """The sum of squares that these stretches keep where they settle, with what that place costs."""
        return float(self.square[stretches].sum() + self.slope[stretches].sum(axis=0) @ self.settled(stretches))

    def left_out(self, stretches: Integers) -> Array:
        """(len(stretches),) errors of each of these stretches, by values that all others of them settle at."""
        steps = [(k, self.settled(stretches[stretches != k])) for k in stretches]
        squares = [self.square[k] + 2.0 * self.slope[k] @ x + x @ self.curvature[k] @ x for k, x in steps]
        return np.sqrt(np.maximum(squares, 0.0))


def changes(problem: Problem, found: Fit) -> tuple[str, ...]:
    """A sentence for each recording within which the robot became another one, by its replays, and one for recordings in
    which it was another one than in the others; none where replays leave noise.
    """
    if explained(found.residual) or problem.eliminated or not found.jacobian.size:
        return ()
    sentences = [_change(problem, found, k) for k in range(len(problem.recordings))]
    return tuple(said for said in (*sentences, _apart(problem, found)) if said)


def of_several(estimates: Sequence[Estimate], said: Sequence[str]) -> tuple[Estimate, ...]:
    """Estimates by recordings of which it is `said` that they are not of one robot (see `changes`): none is its own."""
    if not said:
        return tuple(estimates)
    note = "replays all of them best, yet the recordings are not of one and the same robot"
    return tuple(replace(e, verdict="effective", note=note) if e.verdict == "identified" else e for e in estimates)


def _change(problem: Problem, found: Fit, recording: int) -> str:
    rows, which, edges = _in_stretches(problem, recording, _STRETCHES)
    if not len(rows):
        return ""
    root = np.sqrt(found.weights[rows])
    slopes, errors = found.jacobian[rows] * root[:, None], found.residual[rows] * root
    shown, cut, squares = _best_cut(slopes, errors, which)
    # Where a model has friction of another form, parts with other motion are replayed better by other values too, by less.
    if not shown.halves:
        return ""
    own_values = squares.settled(np.arange(cut)), squares.settled(np.arange(cut, _STRETCHES))
    if not replayed_too(problem, found, own_values, which >= cut, rows):
        return ""
    labels, numbers = labelled(problem.segments)
    names = _named(own_values, which >= cut, slopes, errors, labels, numbers[rows])
    return (
        f"within '{problem.recordings[recording].name}' the robot becomes another one about {edges[cut]:.4g} s: with values "
        f"of their own before and after, errors would be {100.0 * np.exp(-shown.gain):.0f} % of what they are (most at "
        f"{', '.join(names)}). Was a load taken up or put down, a tool changed, did something slip or get in the way? No "
        "values hold for both: make two logs of it, and calibrate with the one that is the robot"
    )


def _apart(problem: Problem, found: Fit) -> str:
    """A sentence on recordings that are as of another robot than the others; '' where values of their own gain little."""
    parts = {k: _in_stretches(problem, k, FEWEST_PARTS) for k in range(len(problem.recordings))}
    laid = {k: (rows, which) for k, (rows, which, _) in parts.items() if len(rows)}
    if len(laid) < 2:
        return ""
    rows = np.concatenate([own for own, _ in laid.values()])
    which = np.concatenate([FEWEST_PARTS * i + part for i, (_, part) in enumerate(laid.values())])
    root = np.sqrt(found.weights[rows])
    slopes, errors = found.jacobian[rows] * root[:, None], found.residual[rows] * root
    squares = _Squares.of(slopes, errors, which, FEWEST_PARTS * len(laid))
    fewer = _grown(squares, len(laid))
    here, there = (_stretches(group) for group in (fewer, [i for i in range(len(laid)) if i not in fewer]))
    shown = compared(
        squares.left_out(np.concatenate([here, there])),
        np.concatenate([squares.left_out(here), squares.left_out(there)]),
    )
    if not shown.halves:
        return ""
    own, others = (squares.settled(here), squares.settled(there)), ~np.isin(which, here)
    if not replayed_too(problem, found, own, others, rows):
        return ""
    labels, numbers = labelled(problem.segments)
    most = ", ".join(_named(own, others, slopes, errors, labels, numbers[rows]))
    names = [problem.recordings[k].name for k in laid]
    of = " and ".join(f"'{names[i]}'" for i in fewer)
    return (
        f"in {of} the robot is another one than in the other recordings: with values of its own for either, errors would be "
        f"{100.0 * np.exp(-shown.gain):.0f} % of what they are (most at {most}). Did it carry a load there, or another tool? "
        "No values hold for both, nor do their intervals: calibrate with those recordings that are the robot"
    )


def _in_stretches(problem: Problem, recording: int, count: int) -> tuple[Integers, Integers, Array]:
    """The rows (m,) of a recording, in which of so many stretches of its time each is, and where these begin and end in s
    (count + 1,); no rows where a stretch has none.
    """
    own = [s for s in problem.segments if s.recording == recording]
    nothing = np.zeros(0, dtype=np.intp)
    if not own:
        return nothing, nothing, np.zeros(0)
    times = np.concatenate([_times(problem, s) for s in own])
    edges = np.linspace(times.min(), times.max(), count + 1)
    which = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, count - 1)
    if len(np.unique(which)) < count:
        return nothing, nothing, edges
    return np.concatenate([np.arange(s.columns.start, s.columns.stop) for s in own]), which, edges


def _grown(squares: _Squares, count: int) -> list[int]:
    """Which of so many recordings keep least, beside all others, with values of their own: one, and all that join it."""

    def kept(group: list[int]) -> float:
        return sum(squares.least(_stretches(g)) for g in (group, [i for i in range(count) if i not in group]))

    group = min(([i] for i in range(count)), key=kept)
    while len(group) < count - 1:
        more = min(([*group, i] for i in range(count) if i not in group), key=kept)
        if kept(more) >= kept(group):
            break
        group = more
    return sorted(group if 2 * len(group) <= count else [i for i in range(count) if i not in group])


def _stretches(recordings: Sequence[int]) -> Integers:
    """The stretches of recordings, FEWEST_PARTS of each."""
    return (FEWEST_PARTS * np.asarray(recordings)[:, None] + np.arange(FEWEST_PARTS)).reshape(-1)


def _best_cut(slopes: Array, errors: Array, which: Integers) -> tuple[Evidence, int, _Squares]:
    """What is gained by values of their own before and after a stretch (with its number), where that is most."""
    squares = _Squares.of(slopes, errors, which, _STRETCHES)
    every = np.arange(_STRETCHES)
    whole = squares.left_out(every)
    tried: list[tuple[float, int, Array]] = []
    for cut in range(FEWEST_PARTS, _STRETCHES - FEWEST_PARTS + 1):
        each = np.concatenate([squares.left_out(every[:cut]), squares.left_out(every[cut:])])
        tried.append((float(each @ each), cut, each))
    _, cut, each = min(tried, key=lambda t: t[0])
    return compared(whole, each), cut, squares


def replayed_too(problem: Problem, found: Fit, steps: tuple[Array, Array], second: Mask, rows: Integers) -> bool:
    """Whether errors at rows (m,) fall by at least half of what slopes foretell where two kinds of these take steps (n,) from
    the fit of their own: the ratio by which trust regions judge a model (J. Nocedal, S. Wright, Numerical Optimization, 4.1).
    """
    places = found.space.from_unit(np.clip(found.unit + np.array(steps), 0.0, 1.0))
    first, last = problem.residuals(places)[:, rows]
    old, slopes = found.residual[rows], found.jacobian[rows]
    foretold = old + np.einsum("mn,mn->m", slopes, np.array(steps)[second.astype(int)])
    here, there, promised = (
        float(np.linalg.norm(each * np.sqrt(found.weights[rows])))
        for each in (old, np.where(second, last, first), foretold)
    )
    # Of a log without noise any values are far off, and values of their own are the same.
    differ = bool(np.abs(np.subtract(*steps)).max() > ROUNDED)
    return differ and here - there > HALVED * (here - promised)


def _named(
    values: tuple[Array, Array], second: Mask, slopes: Array, errors: Array, names: list[str], labels: Integers
) -> list[str]:
    """The labels that gain most of what the first of them does by values (n,) of their own for two kinds of rows (m,)."""
    steps = np.array(values)[second.astype(int)]
    left = errors + np.einsum("mn,mn->m", slopes, steps)
    gains = np.bincount(labels, errors**2 - left**2, len(names))
    order = np.argsort(-gains).tolist()
    return [names[k] for k in order if gains[k] >= MOST * gains[order[0]]]


def _times(problem: Problem, segment: Segment) -> Array:
    """(count,) when each residual of a segment was measured, in s."""
    time = problem.trials[segment.trial].observed[segment.channel].time
    return np.broadcast_to(time[:, None], (segment.samples, len(segment.labels)))[segment.mask]
