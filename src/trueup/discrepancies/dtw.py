# SPDX-License-Identifier: Apache-2.0
"""Dynamic time warping of two paths within a band: its cost, and the matched points, in memory that hardly grows.

D(i, j) = c(i, j) + min(D(i-1, j), D(i, j-1), D(i-1, j-1)) (H. Sakoe and S. Chiba, IEEE Trans. ASSP 26(1), 1978). The cells of
one antidiagonal i + j = k depend on the two before it only, so they are computed together, as vectors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array, Integers
from trueup.compiled import njit
from trueup.errors import RecordingError
from trueup.rounding import ROUNDED

# Inputs are checked to be finite; infinity, which the kernels use, stays what it is.
_FAST = {"nnan", "nsz"}


def dtw(a: ArrayLike, b: ArrayLike, *, band: float = 0.1, squared: bool = False) -> float:
    """The least accumulated cost of matching a (n, d) with b (m, d), each begun and ended together.

    c(i, j) is the Euclidean distance, or its square. `band`: by how much two matched points may differ in their place,
    i / (n-1) and j / (m-1); 1.0 allows everything (O(n m) time), memory is O(n). Raises RecordingError for paths that are
    empty, not finite, or of different dimensions.
    """
    first, second = _checked(a, b)
    low, high = _band(first.shape[1], second.shape[1], band)
    return float(_total(first, second, low, high, squared, 0, np.empty((0, 0, 0))))


def dtw_path(a: ArrayLike, b: ArrayLike, *, band: float = 0.1, squared: bool = False) -> tuple[float, Integers]:
    """As `dtw`, with the matched pairs (K, 2) of indices into a and b, from (0, 0) to (n-1, m-1).

    Two antidiagonals are kept in every sqrt(n + m); between them the path is traced back in the cells that it can reach,
    computed again: O(w sqrt(n + m)) memory for a band of w cells, and hardly more time than the cost alone.
    """
    first, second = _checked(a, b)
    low, high = _band(first.shape[1], second.shape[1], band)
    every = max(8, int(np.sqrt(len(low))))
    kept = np.full((len(low) // every, 2, int((high - low).max()) + 1), np.inf)
    cost = float(_total(first, second, low, high, squared, every, kept))
    return cost, _trace(first, second, low, high, squared, every, kept)[::-1]


def _checked(a: ArrayLike, b: ArrayLike) -> tuple[Array, Array]:
    """(d, n) and (d, m); the second one reversed in time, so that an antidiagonal reads both forward."""
    paths = []
    for name, given in (("first", a), ("second", b)):
        path = np.asarray(given, dtype=np.float64)
        path = path[:, None] if path.ndim == 1 else path
        if path.ndim != 2 or path.size == 0:
            raise RecordingError(f"the {name} path has shape {path.shape}; it must be (points, dimensions), not empty")
        bad = np.flatnonzero(~np.isfinite(path).all(axis=1))
        if bad.size:
            raise RecordingError(
                f"point {bad[0]} of the {name} path is {path[bad[0]]}: leave out what was not measured"
            )
        paths.append(path)
    if paths[0].shape[1] != paths[1].shape[1]:
        raise RecordingError(
            f"the paths have {paths[0].shape[1]} and {paths[1].shape[1]} dimensions: nothing to compare"
        )
    return np.ascontiguousarray(paths[0].T), np.ascontiguousarray(paths[1].T[:, ::-1])


def _band(n: int, m: int, band: float) -> tuple[Integers, Integers]:
    """(n + m - 1,) first and last i of each antidiagonal; none where it has no cell in the band."""
    if not band >= 0.0:
        raise RecordingError(f"band is {band}; it is a share of the path, from 0 to 1")
    k = np.arange(n + m - 1)
    low, high = np.maximum(0, k - m + 1), np.minimum(n - 1, k)
    if min(n, m) > 1 and band < 1.0:
        slope = (m - 1) / (n - 1)
        # Narrower than this, paths of different lengths would have no way through.
        width = max(band * (m - 1), 0.5 * (1.0 + slope) if n != m else 0.0)
        low = np.maximum(low, np.ceil((k - width) / (1.0 + slope) - ROUNDED).astype(np.int64))
        high = np.minimum(high, np.floor((k + width) / (1.0 + slope) + ROUNDED).astype(np.int64))
    return low, high


# The loops are functions of their own on slices that start at 0: only so does the compiler turn them into vectors.


@njit(cache=True, fastmath=_FAST)
def _distances(a: Array, b: Array, first: int, offset: int, squared: bool, out: Array) -> None:
    for d in range(len(a)):
        x, y = a[d, first : first + len(out)], b[d, offset : offset + len(out)]
        if d == 0:
            for t in range(len(out)):
                out[t] = (x[t] - y[t]) * (x[t] - y[t])
        else:
            for t in range(len(out)):
                out[t] += (x[t] - y[t]) * (x[t] - y[t])
    if not squared:
        for t in range(len(out)):
            out[t] = np.sqrt(out[t])


@njit(cache=True, fastmath=_FAST)
def _accumulate(beside: Array, below: Array, diagonal: Array, cost: Array, out: Array) -> None:
    for t in range(len(out)):
        least = beside[t] if beside[t] < below[t] else below[t]
        least = least if least < diagonal[t] else diagonal[t]
        out[t] = cost[t] + least


@njit(cache=True)
def _advance(
    a: Array, b: Array, k: int, low: int, high: int, squared: bool, cost: Array, two: Array, one: Array, now: Array,
    shift: int,
) -> None:  # fmt: skip
    """Antidiagonal k, from i = low to high, out of the one and two before; D(i, .) is at index i + shift."""
    count = high - low + 1
    if count > 0:
        _distances(a, b, low, b.shape[1] - 1 - k + low, squared, cost[:count])
        at = low + shift
        _accumulate(one[at : at + count], one[at - 1 : at - 1 + count], two[at - 1 : at - 1 + count], cost[:count],
                    now[at : at + count])  # fmt: skip
    # The next antidiagonals look one cell beyond this one, and must not find an older one there.
    now[low - 1 + shift] = np.inf
    now[high + 1 + shift] = np.inf


@njit(cache=True)
def _total(a: Array, b: Array, low: Integers, high: Integers, squared: bool, every: int, kept: Array) -> float:
    """D(n-1, m-1); into `kept` goes the last of each `every` antidiagonals with the one before it."""
    n = a.shape[1]
    two, one, now = np.full(n + 2, np.inf), np.full(n + 2, np.inf), np.full(n + 2, np.inf)
    cost = np.empty(n)
    two[0] = 0.0  # before the first cell
    for k in range(len(low)):
        _advance(a, b, k, low[k], high[k], squared, cost, two, one, now, 1)
        two, one, now = one, now, two
        if k == 0:
            now[0] = np.inf
        if every > 0 and (k + 1) % every == 0:
            c = (k + 1) // every - 1
            for back, row in ((0, two), (1, one)):
                first = low[k - 1 + back]
                for i in range(first, high[k - 1 + back] + 1):
                    kept[c, back, i - first] = row[i + 1]
    return float(one[n])


@njit(cache=True)
def _block(
    a: Array, b: Array, low: Integers, high: Integers, squared: bool, every: int, kept: Array, end: int, last: int
) -> tuple[Array, int]:  # fmt: skip
    """(rows, cells) of D below cell (end, last - end), back to the antidiagonals kept before it, and their number k0.

    Row r is antidiagonal k0 - 1 + r; i is at column i - (end - last + k0 - 1) + 1.
    """
    c = last // every - 1 if last % every != every - 1 else (last + 1) // every - 2
    k0 = (c + 1) * every - 1
    rows = last - k0 + 2
    shift = rows - end  # so that the first cell that the path can reach is at column 1
    table = np.full((rows, rows + 2), np.inf)
    if k0 < 0:
        table[0, shift - 1] = 0.0  # before the first cell
    else:
        for back in range(2):
            first = low[k0 - 1 + back]
            for i in range(max(first, 1 - shift), min(high[k0 - 1 + back], end) + 1):
                table[back, i + shift] = kept[c, back, i - first]
    cost = np.empty(rows)
    for r in range(2, rows):
        k = k0 - 1 + r
        first, final = max(low[k], end - (last - k)), min(high[k], end)
        if final >= first:
            _advance(a, b, k, first, final, squared, cost, table[r - 2], table[r - 1], table[r], shift)
    return table, k0


@njit(cache=True)
def _trace(a: Array, b: Array, low: Integers, high: Integers, squared: bool, every: int, kept: Array) -> Integers:
    """(K, 2) matched pairs, the last first; of equal ways the diagonal one."""
    pairs = np.empty((len(low), 2), np.int64)
    i, k = a.shape[1] - 1, len(low) - 1
    count = 0
    while True:
        table, k0 = _block(a, b, low, high, squared, every, kept, i, k)
        shift = k - k0 + 2 - i
        while k > k0:
            pairs[count, 0], pairs[count, 1] = i, k - i
            count += 1
            if k == 0:
                return pairs[:count]
            row, column = k - k0 + 1, i + shift
            diagonal, below, beside = table[row - 2, column - 1], table[row - 1, column - 1], table[row - 1, column]
            if diagonal <= below and diagonal <= beside:
                i, k = i - 1, k - 2
            elif below <= beside:
                i, k = i - 1, k - 1
            else:
                k -= 1
