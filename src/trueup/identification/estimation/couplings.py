# SPDX-License-Identifier: Apache-2.0
"""Finds drives that turn with several joints, as in many wrists, in the recordings: nobody need know the gears' drawing.

Rotors propose ratios (`proposed_couplings`, all at once), and what is left out of the fit decides (`coupled`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.moments import RIDGE, Moments, blocks_of, moments_of, solve
from trueup.identification.estimation.motion import Motion
from trueup.identification.estimation.pieces import pieces_of
from trueup.identification.estimation.pool import pool_for
from trueup.identification.estimation.selection import Choice, evaluated, surely_smaller, weighed
from trueup.identification.estimation.torque_model import Rows
from trueup.identification.kinematic_tree import KinematicTree

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_LEAST = 0.03
"""A coupling below this is taken for none."""
_MOST = 2.0
_PASSES = 3
_COUPLED = 0.15
"""The least gain in the logarithm of the squared error for which a drive is taken to turn with two joints."""
_SURE = 2.0
"""Standard errors over the blocks by which that gain must exceed zero."""
_SAME = 0.02
"""The gain below which a ratio of one is kept."""
_WRIST = 5
_BASIC = 4
"""Groups of effects that a pool has first: rotors, offsets, viscous and Coulomb friction."""
_BLOCKS = 8


def proposed_couplings(
    rows_for: Callable[[Array], Sequence[Rows]], columns: Sequence[int] | Integers, rotors: Sequence[int] | Integers,
    pairs: Sequence[tuple[int, int]],
) -> Array:  # fmt: skip
    """(n, n) C with drive speeds = C @ joint speeds; `pairs` of (drive, an earlier joint) are those that may be coupled.

    Rotors of energy I_d (C qd)_d^2 / 2 give the joints the inertia C' diag(I) C, whose constant entries off the diagonal
    no rigid links with crossed axes can have. They are fitted as columns of their own, and C and I follow by taking that
    matrix apart from the last drive on. Friction of a drive that turns otherwise than thought disturbs this, so it is done
    again with the drives found. For parallel axes links look the same: leave such pairs out.

    `rows_for` gives the runs for drives C; `columns` are the independent columns, `rotors` (n,) those of rotor inertias.
    """
    plain = rows_for(np.eye(len(rotors)))
    n, p, own = len(rotors), plain[0].p, np.asarray(rotors, dtype=np.int64)
    active = np.concatenate([np.asarray(columns, dtype=np.int64), p + np.arange(len(pairs))])
    C = np.eye(n)
    for turn in range(_PASSES):
        rows = rows_for(C) if turn else plain
        crossed = [_crossed(r, source, own, pairs) for r, source in zip(rows, plain, strict=True)]
        values = weighted_fit(moments_of(crossed), active, np.ones(n))[0]
        inertia = C.T @ (np.maximum(values[own], 1e-9)[:, None] * C)
        for size, (d, j) in zip(values[p:], pairs, strict=True):
            inertia[d, j] += size
            inertia[j, d] += size
        C = _taken_apart(inertia, pairs)
    C[np.abs(C) < _LEAST] = 0.0
    return C


def coupled(
    motion: Motion, tree: KinematicTree, drives: Drives, cutoff: float, rng: np.random.Generator, hold_out: float
) -> tuple[Drives, tuple[str, ...]]:
    """Drives of the last three joints that turn with another of them, where that predicts far better, and notes.

    Joint angles and torques that a controller has decoupled already still show the friction and rotor of the drive that
    turns with two joints. Ratios of one and those that the rotors propose are tried, then made exact. Nothing is looked for
    where couplings are given or the log is of motors. The share held out is not looked at.
    """
    n, C = tree.n, drives.coupling
    if n < _WRIST or np.count_nonzero(C) > n or drives.motor_positions or drives.motor_torques:
        return drives, ()
    look = _Look(motion, tree, cutoff, rng, hold_out)
    pairs, notes = [(n - 2, n - 3), (n - 1, n - 2), (n - 1, n - 3)], []
    proposed = look.proposed(pairs)
    best = look.choice(C)
    while pairs:
        ratios = [(pair, r) for pair in pairs for r in {1.0, -1.0, float(proposed[pair])} - {0.0}]
        tried = [(look.loss(_with(C, pair, r)), pair, r) for pair, r in ratios]
        found, pair, ratio = min(tried)
        with_it = look.choice(_with(C, pair, ratio))
        if found > best.loss - _COUPLED or not surely_smaller(with_it.errors, best.errors, _SURE):
            break
        ratio = _exact(lambda r, C=C, pair=pair: look.loss(_with(C, pair, r)), ratio, found)
        notes.append(
            f"the drive of {tree.joints[pair[0]]} turns with {tree.joints[pair[1]]} too (ratio {ratio:.3g}): its "
            "friction and rotor were taken so; say what is true in a drives file, [[couplings]]"
        )
        best, C = with_it, _with(C, pair, ratio)
        pairs.remove(pair)
    return replace(drives, coupling=C) if notes else drives, tuple(notes)


@dataclass(frozen=True, eq=False)
class _Look:
    """A basic model of the arm (rotors, offsets, viscous and Coulomb friction) for any coupling of its drives."""

    motion: Motion
    tree: KinematicTree
    cutoff: float
    rng: np.random.Generator
    hold_out: float

    def rows(self, C: Array) -> tuple[Rows, NDArray[np.bool_]]:
        """The rows of the part that is fitted, and the columns that are independent."""
        n = self.tree.n
        pool = pool_for(self.tree, C, [self.motion], self.rng)
        model = pool.model.only(range(_BASIC * n))
        active = np.concatenate([pool.independent[: 11 * n], np.ones((_BASIC - 1) * n, dtype=bool)])
        return pieces_of(self.motion, model, self.cutoff, self.hold_out)[0].rows, active

    def loss(self, C: Array) -> float:
        """The loss on blocks that were left out."""
        return self.choice(C).loss

    def choice(self, C: Array) -> Choice:
        """The model with its errors on blocks that were left out."""
        rows, active = self.rows(C)
        moments = moments_of(blocks_of([rows], _BLOCKS, 1.0 / self.cutoff))
        choice, prior = Choice(active, 1.0, RIDGE, np.ones(self.tree.n)), np.zeros(len(active))
        return evaluated(moments, prior, weighed(moments, prior, choice))

    def proposed(self, pairs: Sequence[tuple[int, int]]) -> Array:
        """(n, n) what the rotors' crossed inertia says."""
        n = self.tree.n
        active = np.flatnonzero(self.rows(np.eye(n))[1])
        return proposed_couplings(lambda C: [self.rows(C)[0]], active, np.arange(10 * n, 11 * n), pairs)


def _with(C: Array, pair: tuple[int, int], ratio: float) -> Array:
    other = C.copy()
    other[pair] = ratio
    return other


def _exact(loss: Callable[[float], float], ratio: float, found: float) -> float:
    """The ratio with the least loss near one; one itself where that is as good: most gears are cut so."""
    step, best = 0.25, (found, ratio)
    for _ in range(4):
        best = min(best, *((loss(r), r) for r in (best[1] - step, best[1] + step)))
        step *= 0.5
    return ratio if abs(ratio) == 1.0 and best[0] > found - _SAME else best[1]


def _taken_apart(inertia: Array, pairs: Sequence[tuple[int, int]]) -> Array:
    """C, unit lower triangular with entries at `pairs` only, from C' diag(I) C."""
    C, rest = np.eye(len(inertia)), inertia.copy()
    for d in range(len(inertia) - 1, -1, -1):
        for k, j in pairs:
            if k == d:
                C[d, j] = np.clip(rest[d, j] / max(rest[d, d], 1e-9), -_MOST, _MOST)
        rest -= rest[d, d] * np.outer(C[d], C[d])
    return C


def _crossed(rows: Rows, plain: Rows, rotors: Integers, pairs: Sequence[tuple[int, int]]) -> Rows:
    """Rows with a column for each pair: the acceleration of the one on the other."""
    each = zip(plain.columns, plain.values, rotors, strict=True)
    acceleration = [v[int(np.flatnonzero(c == k)[0])] for c, v, k in each]
    columns, values = list(rows.columns), list(rows.values)
    for k, (d, j) in enumerate(pairs):
        for on, of in ((d, j), (j, d)):
            columns[on] = np.append(columns[on], rows.p + k)
            values[on] = np.vstack([values[on], acceleration[of]])
    shrink = np.append(np.broadcast_to(rows.shrink, rows.p), np.zeros(len(pairs)))
    return replace(rows, columns=tuple(columns), values=tuple(values), p=rows.p + len(pairs), shrink=shrink)


def weighted_fit(moments: Moments, active: Integers, start: Array, passes: int = 4) -> tuple[Array, Array]:
    """(p,) parameters by weighted least squares, and the joints' error variance (n,), found by repetition from `start`."""
    variance = start
    inverse = np.divide(1.0, moments.scale, out=np.zeros_like(moments.scale), where=moments.scale > 0.0)
    scaled = np.zeros(len(moments.scale))
    for _ in range(passes):
        gram, cross = (x.sum(axis=0) for x in moments.weighted(variance.min() / variance))
        scaled[active] = solve(gram[np.ix_(active, active)], cross[active], np.zeros(len(active)), RIDGE)
        variance = np.maximum(moments.errors(scaled).sum(axis=0) / moments.count.sum(), 1e-12 * variance.max())
    return scaled * inverse, variance
