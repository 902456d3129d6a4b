# SPDX-License-Identifier: Apache-2.0
"""Which combinations of a model's parameters its torques can tell: rank, groups and their readable names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from trueup.errors import ModelError

Array = NDArray[np.float64]

_SMALL = 1e-4  # a column of which less than this is left outside the others says nothing of its own
_CLEAR = 1e2  # the smallest fall between pivots that settles a rank


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """r independent columns and the groups they stand for: Y @ parameters == Y[:, independent] @ grouping @ parameters."""

    columns: tuple[str, ...]
    """Names of all p parameters."""
    independent: NDArray[np.int64]
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
    scale = np.linalg.norm(stacked, axis=0)
    seen = np.flatnonzero(scale > 0.1 * _SMALL * scale.max())
    wish = np.zeros(p) if preference is None else np.asarray(preference, dtype=float)
    order = np.array(sorted(seen.tolist(), key=lambda k: (-wish[k], k)))
    R = np.asarray(np.linalg.qr(stacked[:, order] / scale[order], mode="r"))
    rank, least, most = _rank(R)
    kept = _greedy(R, np.sqrt(least * max(most, 1e-2 * np.finfo(float).eps)))
    if len(kept) != rank:
        raise ModelError(f"{rank} columns are independent, but {len(kept)} in the preferred order: choose another one")
    rest = np.setdiff1d(np.arange(len(order)), kept)
    share = np.linalg.lstsq(R[:, kept], R[:, rest], rcond=None)[0]
    share[np.abs(share) < max(1e-9, 1e2 * most)] = 0.0
    chosen, gone = order[kept], order[rest]
    grouping = np.zeros((rank, p))
    grouping[np.arange(rank), chosen] = 1.0
    grouping[:, gone] = share * scale[gone] / scale[chosen][:, None]
    whole = np.abs(np.abs(grouping) - 1.0) < max(1e-9, 1e2 * most)
    grouping[whole] = np.sign(grouping[whole])
    by_column = np.argsort(chosen)
    return BaseParameters(columns, chosen[by_column], grouping[by_column], least / max(most, np.finfo(float).eps))


def _rank(R: Array) -> tuple[int, float, float]:
    """Rank, the smallest pivot that counts and the largest that does not, by rank-revealing QR.

    Rounded angles in a model file (1.5708 for a right angle) leave pivots of their error and of its square; so the rank
    is where pivots first fall off, not where they reach the precision of numbers.
    """
    pivots = np.abs(np.diag(scipy.linalg.qr(R, mode="r", pivoting=True)[0]))
    pivots = np.append(pivots[pivots > 0.0], np.finfo(float).eps * 1e-2)
    rank = int(np.argmax(pivots < _SMALL))
    if pivots[rank - 1] < _CLEAR * pivots[rank]:
        raise ModelError(
            f"how many parameters this model's torques can tell is not clear: pivots fall from {pivots[rank - 1]:.1e} only "
            f"to {pivots[rank]:.1e}. Are angles in the model file rounded to few digits, or links nearly aligned?"
        )
    return rank, float(pivots[rank - 1]), float(pivots[rank])


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
