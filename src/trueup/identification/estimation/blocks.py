# SPDX-License-Identifier: Apache-2.0
"""What is left out together when a model is judged: stretches of time, with those of all logs that repeat their motion.

What a model misses (ripple of gears, cables, friction of another form) comes again with the motion: a stretch whose repeat
was fitted is foretold by whatever explains that, and says nothing of other motion (D. Roberts et al., Ecography 40, 2017).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.evidence import FEWEST_PARTS
from trueup.identification.rows import Rows
from trueup.rounding import TINY
from trueup.samples import between

FINER = 4
"""Stretches of a block, where what matters may hold of a part of it: a motion that repeats another, a load taken up."""
_SAME = 0.1
"""Of the root mean square size of its motion: a stretch that is off another by less repeats it. Repeats of simulated and real
arms are within 0.02, chance leaves 0.5 or more."""
_INSTANTS = 32
"""Of a stretch, at which it is compared."""


def numbered(rows: Sequence[Rows], count: int, positions: Sequence[Array] = ()) -> list[Integers]:
    """(S,) the number of the block of each sample of several recordings, about `count` blocks of equal duration.

    Blocks rather than scattered samples, so that what is left out is not next to what was fitted. Where `positions` (S, n)
    are given, what repeats a motion is in the block of the first that shows it, and blocks are fewer, not shorter: in short
    ones neighbours foretell one another. Where too little motion differs, or less than the largest part is repeated, which
    gives little away, repeats count as motion of their own.
    """
    spans = np.array([float(r.time[-1] - r.time[0]) for r in rows])
    cuts = [FINER * max(1, round(count * float(s) / max(float(spans.sum()), TINY))) for s in spans]
    edges = [np.linspace(r.time[0], r.time[-1], k + 1) for r, k in zip(rows, cuts, strict=True)]
    again = _repeats(rows, edges, positions) if positions else {}
    if len(again) * FEWEST_PARTS < sum(cuts) or sum(cuts) - len(again) < FEWEST_PARTS:
        again = {}
    fresh, blocks, found = sum(cuts) - len(again), 0, list[Integers]()
    parts = max(count * fresh / sum(cuts), min(FEWEST_PARTS, count))
    for k, (r, edge, cut) in enumerate(zip(rows, edges, cuts, strict=True)):
        new = [(k, i) not in again for i in range(cut)]
        share = min(sum(new), max(1, round(parts * sum(new) / fresh)))
        number = blocks + (np.cumsum(new) - 1) * share // max(sum(new), 1)
        at = np.clip(np.searchsorted(edge, r.time, side="right") - 1, 0, cut - 1)
        found.append(number[at])
        for i in np.flatnonzero(~np.array(new)).tolist():
            of, shift = again[k, i]
            then = np.searchsorted(rows[of].time, r.time[at == i] - shift)
            found[k][at == i] = found[of][np.minimum(then, rows[of].length - 1)]
        blocks += share
    return found


def blocks_of(rows: Sequence[Rows], numbers: Sequence[Integers], margin: float) -> list[Rows]:
    """The blocks (one Rows each) of `numbered` samples, without `margin` s at both ends of each stretch of one."""
    clear = [_clear(r.time, own, margin) for r, own in zip(rows, numbers, strict=True)]
    found = []
    for k in range(max((int(own.max()) for own in numbers if len(own)), default=-1) + 1):
        inside = [(own == k) & free for own, free in zip(numbers, clear, strict=True)]
        parts = [r.part(at) for r, at in zip(rows, inside, strict=True) if at.any()]
        if sum(part.length for part in parts) > 1:
            found.append(parts[0] if len(parts) == 1 else _joined(parts))
    return found


def _joined(parts: Sequence[Rows]) -> Rows:
    values = tuple(np.concatenate(each, axis=1) for each in zip(*(p.values for p in parts), strict=True))
    torque, time = (np.concatenate(each) for each in ([p.torque for p in parts], [p.time for p in parts]))
    return replace(parts[0], values=values, torque=torque, time=time)


def _clear(time: Array, numbers: Integers, margin: float) -> Mask:
    """(S,) whether samples are `margin` s from where another block begins and from both ends, or half of its stretch."""
    change = np.flatnonzero(np.diff(numbers))
    borders = np.concatenate([time[:1], 0.5 * (time[change] + time[change + 1]), time[-1:]])
    after = np.clip(np.searchsorted(borders, time, side="right"), 1, len(borders) - 1)
    start, stop = borders[after - 1], borders[after]
    return np.minimum(time - start, stop - time) >= np.minimum(margin, 0.25 * (stop - start))


def _repeats(
    rows: Sequence[Rows], edges: Sequence[Array], positions: Sequence[Array]
) -> dict[tuple[int, int], tuple[int, float]]:
    """For stretches (recording, number) that repeat a motion: of which recording, and how many s they come later.

    Stretches are compared with all that was measured before they begin, at any shift in time.
    """
    cuts = [len(e) - 1 for e in edges]
    step = sum(float(e[-1] - e[0]) for e in edges) / (_INSTANTS * sum(cuts))
    grids = [np.arange(r.time[0], r.time[-1] + 0.5 * step, step) for r in rows]
    length, found = (
        min(len(g) // cut for g, cut in zip(grids, cuts, strict=True)),
        dict[tuple[int, int], tuple[int, float]](),
    )
    if length < 2:
        return found
    seen = []
    for grid, r, q in zip(grids, rows, positions, strict=True):
        even = between(grid, r.time, q)
        seen.append(np.lib.stride_tricks.sliding_window_view(even, length, axis=0).reshape(len(even) - length + 1, -1))
    for k, (grid, edge) in enumerate(zip(grids, edges, strict=True)):
        for i, start in enumerate(np.searchsorted(grid, edge[:-1] - 0.5 * step).tolist()):
            own = seen[k][min(start, len(seen[k]) - 1)]
            least = _SAME**2 * float(np.sum(np.var(own.reshape(-1, length), axis=1))) * length
            for of in range(k + 1):
                before = seen[of] if of < k else seen[of][: max(start - length + 1, 0)]
                off = np.sum((before - own) ** 2, axis=1)
                if len(off) and off.min() < least:
                    least, shift = float(off.min()), float(grid[start] - grids[of][int(off.argmin())])
                    found[k, i] = (of, shift)
    return found
