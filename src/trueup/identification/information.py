# SPDX-License-Identifier: Apache-2.0
"""Information matrices of many motions, weighted and summed over the joints while they are computed, and determinants.

Columns are made by the loops of `blocks`, a tile of samples at a time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.compiled import njit
from trueup.cores import in_threads
from trueup.identification import blocks


def information(
    tree: blocks.Layout, acts: Mask, chosen: Integers, squared: Array, batch: Sequence[Array], threads: int = 1
) -> Array:
    """(B, c, c) sum_i squared[i] G_i of motions `batch` (q, qd, qdd, each (B, S, n)) for the `chosen` (c,) columns.

    `acts` (n, c): whether joint i depends on a chosen column. A short motion spends more on handling matrices than on its
    samples, so nothing is formed that is not needed.
    """
    n, p = len(acts), 10 * len(acts) + len(tree.kind)
    rows = [np.flatnonzero(acts[i]) for i in range(n)]
    width = np.array([-(-len(r) // blocks.TILE) * blocks.TILE for r in rows], dtype=np.int64)
    start = np.concatenate([[0], np.cumsum(width)[:-1]]).astype(np.int64)
    place = np.full((n, p), -1)
    for i in range(n):
        place[i, chosen[rows[i]]] = start[i] + np.arange(len(rows[i]))
    counts = np.array([len(r) for r in rows], dtype=np.int64)
    listed = np.concatenate(rows).astype(np.int64)
    out = np.zeros((len(batch[0]), len(chosen), len(chosen)))

    def some(part: slice) -> None:
        Z, packed = np.zeros(int(width.sum()) * blocks.LONG), np.zeros(int((width**2).sum()))
        q, qd, qdd = (x[part] for x in batch)
        _sums(tree, q, qd, qdd, place, start, width, counts, listed, squared, Z, packed, out[part])

    in_threads(some, len(out), threads)
    return out


def log_determinants(M: Array) -> Array:
    """(B,) natural logarithm of the determinants of symmetric M (B, c, c); -inf where one is not positive definite."""
    found = np.empty(len(M))
    _log_determinants(np.ascontiguousarray(M), found)
    return found


@njit(cache=True, nogil=True)
def _sums(
    tree: blocks.Layout, q: Array, qd: Array, qdd: Array, place: Integers, start: Integers, width: Integers,
    counts: Integers, listed: Integers, squared: Array, Z: Array, packed: Array, out: Array,
) -> None:  # fmt: skip
    for b in range(len(q)):
        packed[:] = 0.0
        blocks.gram(tree, q[b], qd[b], qdd[b], place, start, width, Z, packed)
        at, first = 0, 0
        for i in range(len(width)):
            for r in range(counts[i]):
                for s in range(r, counts[i]):
                    out[b, listed[first + r], listed[first + s]] += squared[i] * packed[at + r * width[i] + s]
            at += width[i] * width[i]
            first += counts[i]
        for r in range(out.shape[1]):
            for s in range(r):
                out[b, r, s] = out[b, s, r]


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _log_determinants(M: Array, out: Array) -> None:
    """By Cholesky of the matrices scaled to unit diagonals, row by row so that inner loops run along memory."""
    n = M.shape[1]
    L, scale = np.empty((n, n)), np.empty(n)
    for b in range(len(M)):
        total, sound = 0.0, True
        for i in range(n):
            if not M[b, i, i] > 0.0:
                sound = False
                break
            scale[i] = 1.0 / np.sqrt(M[b, i, i])
            total += np.log(M[b, i, i])
        for i in range(n if sound else 0):
            for j in range(i + 1):
                s = M[b, i, j] * scale[i] * scale[j]
                for k in range(j):
                    s -= L[i, k] * L[j, k]
                if i == j:
                    if not s > 1e-15:
                        sound = False
                        break
                    L[i, i] = np.sqrt(s)
                    total += np.log(s)
                else:
                    L[i, j] = s / L[j, j]
            if not sound:
                break
        out[b] = total if sound else -np.inf
