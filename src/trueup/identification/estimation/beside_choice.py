# SPDX-License-Identifier: Apache-2.0
"""Further columns beside a model that was chosen without them: what a score test asks, on blocks that were left out.

C. R. Rao, "Large sample tests of statistical hypotheses", 1948.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array, Integers
from trueup.evidence import without_each
from trueup.identification.estimation.moments import RIDGE, Moments, solve
from trueup.identification.estimation.motion import Motion, Piece
from trueup.identification.estimation.pool import Pool
from trueup.identification.estimation.selection import Choice, cross_validated


def with_columns(pieces: Sequence[Piece], active: Integers, further: Callable[[Motion], Array]) -> list[Piece]:
    """Pieces with the columns `active` alone, and `further` ones (S, n, c) behind them."""
    made, known = list[Piece](), dict[int, Array]()
    for p in pieces:
        if id(p.whole) not in known:
            known[id(p.whole)] = p.passed(further(p.whole))
        more, columns, values = np.moveaxis(known[id(p.whole)][p.keep], 0, -1), list[Integers](), list[Array]()
        behind = len(active) + np.arange(more.shape[1])
        for c, v, own in zip(p.rows.columns, p.rows.values, more, strict=True):
            kept = np.isin(c, active)
            columns.append(np.append(np.searchsorted(active, c[kept]), behind))
            values.append(np.concatenate([v[kept], own]))
        shrink = np.append(np.broadcast_to(p.rows.shrink, p.rows.p)[active], np.zeros(len(behind)))
        rows = replace(p.rows, columns=tuple(columns), values=tuple(values), p=len(shrink), shrink=shrink)
        made.append(replace(p, rows=rows))
    return made


def links_of(pool: Pool, moments: Moments, choice: Choice) -> Array:
    """(n, 10) links of the model that was chosen; combinations, not bodies."""
    parameters = np.zeros(pool.model.p)
    active = np.flatnonzero(choice.active)
    parameters[active] = solved(moments, choice, active)
    return parameters[: 10 * pool.model.tree.n].reshape(-1, 10)


def solved(moments: Moments, choice: Choice, columns: Integers) -> Array:
    """(c,) parameters of a fit of some columns."""
    part = moments.only(columns)
    gram, cross = (x.sum(axis=0) for x in part.weighted(choice.weights))
    return part.parameters(solve(gram, cross, np.zeros(len(columns))))


def solved_without_each(moments: Moments, choice: Choice, columns: Integers) -> Array:
    """(K, c) parameters of a fit without one block each."""
    part = moments.only(columns)
    gram, cross = (without_each(x) for x in part.weighted(choice.weights))
    return np.array([part.parameters(x) for x in solve(gram, cross, np.zeros(len(columns)))])


def left_out_errors(moments: Moments, choice: Choice, columns: Sequence[Integers]) -> list[Array]:
    """(K, n) squared errors of blocks that were left out, of the model with each of these sets of columns."""
    every = np.arange(len(moments.scale))
    choices = [replace(choice, active=np.isin(every, c), strength=RIDGE) for c in columns]
    made = cross_validated(moments, np.zeros(len(every)), *choices)
    return [c.errors for c in made if c.errors is not None]
