# SPDX-License-Identifier: Apache-2.0
"""Whether friction is another in one recording than in another, as of gears that warm up between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.evidence import Evidence, half_interval, jackknife
from trueup.identification.estimation.beside_choice import left_out_errors, solved, solved_without_each
from trueup.identification.estimation.modelled import Modelled, fitted_blocks
from trueup.identification.estimation.moments import moments_of
from trueup.identification.estimation.motion import Piece
from trueup.identification.estimation.pool import Pool
from trueup.identification.estimation.selection import compared

_FRICTION = ("viscous", "coulomb", "quadratic", "root", "asymmetric", "saturating", "hysteresis", "load")


def changed_friction(modelled: Modelled, margin: float) -> list[str]:
    """What is said where left-out blocks are predicted clearly better with friction of another size in each recording.

    A share of the friction that was chosen is added for each recording but the first, the same for all joints: gears of one
    arm warm up together. `margin` is in s, what is left out at the borders of blocks.
    """
    pool, _, _, (pieces, _, _, choice) = modelled
    fitted = [p for p in pieces if not p.held_out]
    names = list(dict.fromkeys(p.whole.name for p in fitted))
    if len(names) < 2:
        return []
    active, more = np.flatnonzero(choice.active), len(names) - 1
    every, friction = np.arange(len(active) + more), _of_friction(pool)
    moments = moments_of(fitted_blocks(fitted, margin)).only(active)
    # First beside the friction that all share, then beside that of the first recording, which is what shares are of.
    for columns in (every[:-more], every):
        chosen = np.zeros(pool.model.p)
        chosen[active] = solved(moments, choice, columns)[: len(active)]
        chosen[~friction] = 0.0
        made = [_with_share(p, active, chosen, names.index(p.whole.name) - 1, more) for p in fitted]
        moments = moments_of(fitted_blocks(made, margin))
    plain, other = left_out_errors(moments, choice, [every[:-more], every])
    evidence = compared(other, plain)
    if not evidence.holds:
        return []
    each = solved_without_each(moments, choice, every)[:, -more:]
    half = half_interval(len(each)) * jackknife(each)
    return _in_words(names, solved(moments, choice, every)[-more:], half, evidence)


def _of_friction(pool: Pool) -> Mask:
    """(p,) which columns are friction."""
    found = np.zeros(pool.model.p, dtype=bool)
    for name, columns in pool.groups.items():
        found[list(columns)] = name.split()[0] in _FRICTION
    return found


def _with_share(piece: Piece, active: Integers, chosen: Array, own: int, more: int) -> Piece:
    """A piece with the columns `active` alone, and behind them a share of the friction `chosen` (p,) for each recording."""
    columns, values = list[Integers](), list[Array]()
    for c, v in zip(piece.rows.columns, piece.rows.values, strict=True):
        share = np.zeros((more, v.shape[1]))
        if own >= 0:
            share[own] = chosen[c] @ v
        kept = np.isin(c, active)
        columns.append(np.append(np.searchsorted(active, c[kept]), len(active) + np.arange(more)))
        values.append(np.concatenate([v[kept], share]))
    shrink = np.append(np.broadcast_to(piece.rows.shrink, piece.rows.p)[active], np.zeros(more))
    rows = replace(piece.rows, columns=tuple(columns), values=tuple(values), p=len(shrink), shrink=shrink)
    return replace(piece, rows=rows)


def _in_words(names: Sequence[str], shares: Array, half: Array, evidence: Evidence) -> list[str]:
    """Shares (K - 1,) by which friction is larger than in the first recording, and half their intervals."""
    sure = [
        f"in '{name}' {100.0 * share:+.2g} +- {100.0 * wide:.1g} %"
        for name, share, wide in zip(names[1:], shares, half, strict=True)
        if abs(share) > wide
    ]
    if not sure:
        return []
    return [
        f"friction changed from recording to recording, against '{names[0]}' {', '.join(sure)} (errors on stretches that "
        f"were left out are {evidence.in_words()}), as of gears that warm up: the model has what lies between. Warm the arm "
        "up before it is recorded, or identify what was recorded as warm as the arm will be"
    ]
