# SPDX-License-Identifier: Apache-2.0
"""Ratios of coupled drives, proposed all at once by the crossed inertia of their rotors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array, Integers
from trueup.identification.estimation.moments import moments_of, weighted_fit
from trueup.identification.rows import Rows

_LEAST = 0.03
"""A coupling below this is taken for none."""
_MOST = 2.0
_PASSES = 3


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
        moments = moments_of(crossed)
        values = moments.parameters(weighted_fit(moments, active, np.zeros(len(moments.scale)))[0])
        inertia = C.T @ (np.maximum(values[own], 1e-9)[:, None] * C)
        for size, (d, j) in zip(values[p:], pairs, strict=True):
            inertia[d, j] += size
            inertia[j, d] += size
        C = _taken_apart(inertia, pairs)
    C[np.abs(C) < _LEAST] = 0.0
    return C


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
