# SPDX-License-Identifier: Apache-2.0
"""Gram matrices of many motions at once, one for each joint, and the determinant of their weighted sum."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueup.identification import blocks

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def structured_grams(
    tree: blocks.Layout, q: Array, qd: Array, qdd: Array, lengths: Ints, chosen: Ints, acts: NDArray[np.bool_],
    threads: int = 1,
) -> Array:  # fmt: skip
    """(B, n, c, c) from motions (B, S, n): joint i multiplies only the columns (of the c `chosen`) that act on it.

    q in rad, qd in rad/s, qdd in rad/s^2 (or m); `lengths` (B,) samples count of each individual; `chosen` (c,) of the
    layout's p columns; `acts` (n, c) whether joint i depends on a chosen column; `threads` share the individuals.
    """
    B, _, n = q.shape
    rows = [np.flatnonzero(acts[i]) for i in range(n)]
    width = np.array([-(-len(r) // blocks.TILE) * blocks.TILE for r in rows])
    start = np.concatenate([[0], np.cumsum(width)[:-1]])
    place = np.full((n, 10 * n + len(tree.kind)), -1)
    for i in range(n):
        place[i, chosen[rows[i]]] = start[i] + np.arange(len(rows[i]))
    out = np.zeros((B, n, len(chosen), len(chosen)))

    def some(individuals: Ints) -> None:
        Z, packed = np.zeros(int(width.sum()) * blocks.LONG), np.zeros(int((width**2).sum()))
        for b in individuals:
            Z[:], packed[:] = 0.0, 0.0
            m = int(lengths[b])
            blocks.gram(tree, q[b, :m], qd[b, :m], qdd[b, :m], place, start, width, Z, packed)
            _unpack(packed, width, rows, out[b])

    shares = np.array_split(np.arange(B), max(1, min(threads, B)))
    if len(shares) == 1:
        some(shares[0])
    else:
        with ThreadPoolExecutor(len(shares)) as pool:
            list(pool.map(some, shares))
    return out


def _unpack(packed: Array, width: Ints, rows: list[Ints], out: Array) -> None:
    """Each joint's upper tiles into its full, symmetric matrix out[i] (c, c)."""
    at = 0
    for i, w in enumerate(width.tolist()):
        upper = np.triu(packed[at : at + w * w].reshape(w, w)[: len(rows[i]), : len(rows[i])])
        out[i][np.ix_(rows[i], rows[i])] = upper + np.triu(upper, 1).T
        at += w * w


def log_determinant(grams: Array, weights: ArrayLike) -> Array:
    """(...) log10 det of sum_i weights[i]^2 grams[..., i, :, :]; -inf where it is singular.

    Eq. 9 of the local identification paper with weights tau_nom / max(tau_nom); usual practice divides by tau_nom.
    """
    squared = np.asarray(weights, dtype=float) ** 2
    sign, value = np.linalg.slogdet(np.einsum("i,...ijk->...jk", squared, grams))
    return np.where(sign > 0, value / np.log(10.0), -np.inf)
