# SPDX-License-Identifier: Apache-2.0
"""Which combinations of a model's parameters its torques can tell: rank, groups and their readable names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.errors import ModelError

Array = NDArray[np.float64]


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

    def reduce(self, regressor: Array) -> Array:
        """(..., r) the independent columns of a regressor (..., p)."""
        return regressor[..., self.independent]


def _readable(row: Array, first: int, columns: tuple[str, ...]) -> str:
    order = [first, *(int(k) for k in np.flatnonzero(row) if k != first)]
    text = ""
    for k in order:
        size = abs(row[k])
        number = "" if abs(size - 1.0) < 1e-9 else f"{size:.3f} "
        text += (" - " if row[k] < 0 else " + ") + number + columns[k]
    return text[3:] if text.startswith(" + ") else text[1:].replace("- ", "-", 1)


def base_parameters(stacked: Array, columns: tuple[str, ...], preference: Array | None = None) -> BaseParameters:
    """The groups of a regressor (N, p) from random states, which must excite everything.

    A column stays if it is independent of all that are preferred to it (`preference` (p,), higher first; ties: earlier
    columns first), so each group is named by its preferred parameter. Raises ModelError where the rank is not clear.
    """
    p = stacked.shape[1]
    scale = np.linalg.norm(stacked, axis=0)
    seen = np.flatnonzero(scale > 1e-9 * scale.max())
    wish = np.zeros(p) if preference is None else np.asarray(preference, dtype=float)
    order = sorted(seen.tolist(), key=lambda k: (-wish[k], k))
    triangle = np.asarray(np.linalg.qr(stacked[:, order] / scale[order], mode="r"))
    kept, dropped, sizes, R = _greedy(triangle)
    gap = min(sizes) / max([*dropped.values(), np.finfo(float).eps])
    if gap < 1e4:
        raise ModelError(
            f"the rank of this model is not clear: pivots {min(sizes):.1e} and {max(dropped.values()):.1e}"
        )
    chosen = np.array([order[k] for k in kept])
    rest = np.array([order[k] for k in dropped], dtype=int)
    grouping = np.zeros((len(chosen), p))
    grouping[np.arange(len(chosen)), chosen] = 1.0
    if len(rest):
        share = np.linalg.lstsq(R[:, kept], R[:, list(dropped)], rcond=None)[0]
        grouping[:, rest] = share * scale[rest] / scale[chosen][:, None]
    grouping[np.abs(grouping) < 1e-9] = 0.0
    by_column = np.argsort(chosen)
    return BaseParameters(columns, chosen[by_column], grouping[by_column], gap)


def _greedy(R: Array) -> tuple[list[int], dict[int, float], list[float], Array]:
    """Columns of R in order, each kept if a tenth-power of its length is left outside those kept before."""
    kept: list[int] = []
    dropped: dict[int, float] = {}
    sizes: list[float] = []
    basis = np.zeros((R.shape[0], 0))
    for k in range(R.shape[1]):
        left = R[:, k] - basis @ (basis.T @ R[:, k])
        left -= basis @ (basis.T @ left)
        size = float(np.linalg.norm(left))
        if size > 1e-7:
            kept.append(k)
            sizes.append(size)
            basis = np.column_stack([basis, left / size])
        else:
            dropped[k] = size
    return kept, dropped, sizes, R
