# SPDX-License-Identifier: Apache-2.0
"""Which combinations of a model's parameters its torques can tell: rank, groups and their readable names."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from trueup.arrays import Array, Integers
from trueup.errors import ModelError
from trueup.rounding import PRINTED, ROUNDED

_SMALL = 3e-3  # a column of which less than this is left outside the others says nothing that torque could tell
_CLEAR = 1e1  # the smallest fall between pivots that settles a rank


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """r independent columns and the groups they stand for: Y @ parameters == Y[:, independent] @ grouping @ parameters."""

    columns: tuple[str, ...]
    """Names of all p parameters."""
    independent: Integers
    """(r,) the columns that stay; each stands for its group."""
    grouping: Array
    """(r, p) coefficients of the groups; the independent columns have an identity."""
    gap: float
    """The smallest pivot that counts over the largest that does not: large means that the rank is certain."""

    @property
    def rank(self) -> int:
        """r, the number of combinations that can be identified."""
        return len(self.independent)

    @property
    def names(self) -> tuple[str, ...]:
        """Readable groups: 'I2zz + I2m + 0.49 m3 + 0.49 m4'."""
        return tuple(
            _readable(row, int(k), self.columns) for row, k in zip(self.grouping, self.independent, strict=True)
        )

    @property
    def unseen(self) -> tuple[str, ...]:
        """Names of the parameters that no torque depends on."""
        return tuple(
            name
            for name, used in zip(self.columns, (self.grouping != 0.0).any(axis=0).tolist(), strict=True)
            if not used
        )

    def of(self, parameters: Array) -> Array:
        """(..., r) base parameters of full ones (..., p)."""
        return np.asarray(parameters) @ self.grouping.T

    def full(self, base: ArrayLike, prior: ArrayLike) -> Array:
        """(p,) the parameters nearest to `prior` (p,) that have these base parameters (r,)."""
        G, start = self.grouping, np.asarray(prior, dtype=float)
        change = np.linalg.lstsq(G, np.asarray(base, dtype=float) - G @ start, rcond=None)[0]
        return start + np.asarray(change, dtype=np.float64)

    def reduce(self, regressor: Array) -> Array:
        """(..., r) the independent columns of a regressor (..., p)."""
        return regressor[..., self.independent]


def _readable(row: Array, first: int, columns: tuple[str, ...]) -> str:
    """The parameter that stands for the group, rotor inertias that add to it, then the others."""
    others = [int(k) for k in np.flatnonzero(row) if k != first]
    rotors = [k for k in others if row[k] == 1.0 and columns[k].endswith("m")]
    text = columns[first]
    for k in [*rotors, *(k for k in others if k not in rotors)]:
        size = abs(row[k])
        number = "" if size == 1.0 else f"{size:.3f} " if size >= 0.01 else f"{size:.2g} "
        text += (" - " if row[k] < 0 else " + ") + number + columns[k]
    return text


def base_parameters(stacked: Array, columns: tuple[str, ...], preference: ArrayLike | None = None) -> BaseParameters:
    """The groups of a regressor (N, p) from random states, which must excite everything.

    A column stays if it is independent of all that are preferred to it (`preference` (p,), higher first; ties: earlier
    columns first, so that a group is named by the link nearest to the base), and each other column is shared out among
    those that stay. Gautier, "Numerical calculation of the base inertial parameters of robots", J. Robotic Systems
    8(4), 1991. Raises ModelError where the rank is not clear.
    """
    p = stacked.shape[1]
    size = np.linalg.norm(stacked, axis=0)
    scale = _sizes(size, columns)
    seen = np.flatnonzero(size > ROUNDED * scale)
    wish = np.zeros(p) if preference is None else np.asarray(preference, dtype=float)
    order = np.array(sorted(seen.tolist(), key=lambda k: (-wish[k], k)))
    R = np.asarray(np.linalg.qr(stacked[:, order] / scale[order], mode="r"))
    rank, least, most = _rank(R)
    kept = _independent(R, rank, least, most)
    rest = np.setdiff1d(np.arange(len(order)), kept)
    share = np.linalg.lstsq(R[:, kept], R[:, rest], rcond=None)[0]
    # Coefficients this near to 0 or 1 are that, but for angles in the file.
    rounding = max(ROUNDED, min(100.0 * most, 1e-3))
    share[np.abs(share) < rounding] = 0.0
    chosen, gone = order[kept], order[rest]
    grouping = np.zeros((rank, p))
    grouping[np.arange(rank), chosen] = 1.0
    grouping[:, gone] = share * scale[gone] / scale[chosen][:, None]
    whole = np.abs(np.abs(grouping) - 1.0) < rounding
    grouping[whole] = np.sign(grouping[whole])
    by_column = np.argsort(chosen)
    return BaseParameters(columns, chosen[by_column], grouping[by_column], least / max(most, np.finfo(float).eps))


def _sizes(size: Array, columns: tuple[str, ...]) -> Array:
    """(p,) the largest column of each kind (masses, first moments, inertias, ...), told by the letters of its name.

    So a column that shows only because an axis is a hair off parallel stays as small as it is.
    """
    kinds = [(re.match(r"[A-Za-z]*", name) or [""])[0] for name in columns]
    largest = {
        kind: max(x for x, k in zip(size.tolist(), kinds, strict=True) if k == kind) for kind in dict.fromkeys(kinds)
    }
    return np.array([largest[kind] or 1.0 for kind in kinds])


def _rank(R: Array) -> tuple[int, float, float]:
    """Rank, the smallest pivot that counts and the largest that does not, by rank-revealing QR.

    Rounded angles in a model file (1.5708 for a right angle) and axes that a drawing puts a hair off parallel leave
    pivots of their error and of its square; so the rank is where pivots first fall off, not where they reach the precision
    of numbers.
    """
    pivots = np.abs(np.diag(scipy.linalg.qr(R, mode="r", pivoting=True)[0]))
    pivots = np.append(pivots[pivots > 0.0], np.finfo(float).eps / 100.0)
    # Below what numbers in a file are rounded to there is nothing to tell apart any more.
    falls = (pivots[1:] < _SMALL) & (pivots[:-1] >= _CLEAR * pivots[1:]) & (pivots[:-1] > PRINTED)
    rank = int(np.argmax(falls)) + 1
    if not falls.any():
        raise ModelError(
            "how many parameters this model's torques can tell is not clear: pivots fall gradually, from "
            f"{pivots[0]:.1e} to {pivots[-2]:.1e}. Are angles in the file rounded to few digits, or axes nearly aligned?"
        )
    return rank, float(pivots[rank - 1]), float(pivots[rank])


def _independent(R: Array, rank: int, least: float, most: float) -> list[int]:
    """`rank` columns of R, each independent of those preferred to it. Raises ModelError where that is not clear."""
    smallest = max(most, np.finfo(float).eps / 100.0)
    low, high = np.log(smallest), np.log(least)  # between pivots that count and those that do not
    kept: list[int] = []
    for _ in range(16):  # the higher the threshold, the fewer are kept
        middle = 0.5 * (low + high)
        kept = _greedy(R, float(np.exp(middle)))
        if len(kept) == rank:
            return kept
        low, high = (middle, high) if len(kept) > rank else (low, middle)
    raise ModelError(
        f"{rank} columns are independent, but {len(kept)} in the preferred order: choose another preference"
    )


def _greedy(R: Array, threshold: float) -> list[int]:
    """The columns of R, in order, of which more than `threshold` is left outside those kept before."""
    kept: list[int] = []
    basis = np.zeros((R.shape[0], R.shape[1]))
    for k in range(R.shape[1]):
        before = basis[:, : len(kept)]
        left = R[:, k] - before @ (before.T @ R[:, k])
        left -= before @ (before.T @ left)  # twice is enough
        if (size := np.linalg.norm(left)) > threshold:
            basis[:, len(kept)] = left / size
            kept.append(k)
    return kept
