# SPDX-License-Identifier: Apache-2.0
"""What a unit of motor current is in torque, from runs with and without a payload that was weighed.

Currents alone tell a model only up to one factor for each drive. A known payload sets the scale: Gautier & Briot, "Global
identification of joint drive gains and dynamic parameters of robots", ASME J. Dyn. Sys. Meas. Control 136(5), 2014.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueup.errors import IdentificationError
from trueup.identification.estimation.moments import TINY
from trueup.identification.estimation.selection import BLOCKS
from trueup.identification.rows import Rows

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_PASSES = 4
_POOR = 0.2


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Gains (n,) in N m (N) per unit of what was logged, their standard deviations, and the parameters (p,) beside them."""

    gains: Array
    deviations: Array
    """From leaving out one stretch of time after the other."""
    parameters: Array
    """Of the arm without the payload, in SI units."""

    def poor(self) -> NDArray[np.int64]:
        """Joints whose gain is uncertain by more than a fifth: the payload hardly loads them in these runs."""
        return np.flatnonzero(~(self.deviations < _POOR * np.abs(self.gains)))


def drive_gains(
    free: Sequence[Rows], loaded: Sequence[Rows], payload: ArrayLike, columns: Sequence[int] | Integers, *, link: int = -1
) -> DriveGains:  # fmt: skip
    """Gains g with g_j current_j = regressor row j @ parameters (+ what the payload adds), by weighted least squares.

    `free`, `loaded`: runs without and with the payload, `torque` holding currents (S, n). `payload` (10,): its inertial
    parameters in the frame of link number `link` (the last). `columns`: independent columns of the model. Raises
    IdentificationError where a run is missing, the payload weighs nothing, or no gain comes out above zero.
    """
    known = np.asarray(payload, dtype=float)
    if not free or not loaded:
        raise IdentificationError("drive gains need runs without the payload and runs with it; one of them is missing")
    if known.shape != (10,) or not known[0] > 0.0:
        raise IdentificationError(
            f"the payload needs 10 inertial parameters with a mass above 0 kg; got {known.tolist()}"
        )
    n, act = len(free[0].values), np.asarray(columns, dtype=np.int64)
    body = np.arange(10) + 10 * (link % n)
    stretches = [*_stretches(free, None, body, act), *_stretches(loaded, known, body, act)]
    weights = _weights(stretches, n)
    found = _solved(stretches, weights, len(act))
    left = [_solved(stretches[:k] + stretches[k + 1 :], weights, len(act)) for k in range(len(stretches))]
    spread = np.array(left)[:, len(act) :] - found[len(act) :]
    K = len(stretches)
    gains, deviations = found[len(act) :], np.sqrt((K - 1) / K * np.sum(spread**2, axis=0))
    if not (gains > 0.0).all():
        joint = int(np.argmin(gains))
        raise IdentificationError(
            f"the gain of drive {joint + 1} comes out as {gains[joint]:.3g}, which no drive has: is its current logged with "
            "the other sign, or does the payload not load it in these runs? Stretch the arm out, move slowly and fast"
        )
    parameters = np.zeros(free[0].p)
    parameters[act] = found[: len(act)]
    return DriveGains(gains, deviations, parameters)


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Normal equations of a stretch of time, joint by joint, for parameters and gains."""

    gram: Array
    """(n, k + n, k + n)."""
    cross: Array
    """(n, k + n)."""
    square: Array
    """(n,)."""
    count: int


def _stretches(runs: Sequence[Rows], payload: Array | None, body: Integers, act: Integers) -> list[_Stretch]:
    edges = [(r, slice(*(r.length * np.array([i, i + 1]) // BLOCKS))) for r in runs for i in range(BLOCKS)]
    return [_stretch(r.part(part), payload, body, act) for r, part in edges]


def _stretch(rows: Rows, payload: Array | None, body: Integers, act: Integers) -> _Stretch:
    n, k = len(rows.values), len(act)
    place = np.full(rows.p, -1)
    place[act] = np.arange(k)
    gram, cross, square = np.zeros((n, k + n, k + n)), np.zeros((n, k + n)), np.zeros(n)
    for j, (c, v) in enumerate(zip(rows.columns, rows.values, strict=True)):
        own = place[c] >= 0
        at = np.append(place[c[own]], k + j)
        A = np.vstack([v[own], -rows.torque[:, j]])
        carried = np.isin(c, body)
        known = -payload[c[carried] - body[0]] @ v[carried] if payload is not None else np.zeros(rows.length)
        gram[j][np.ix_(at, at)] = A @ A.T
        cross[j, at] = A @ known
        square[j] = known @ known
    return _Stretch(gram, cross, square, rows.length)


def _solved(stretches: Sequence[_Stretch], weights: Array, k: int) -> Array:
    """(k + n,) parameters, then gains."""
    gram = np.einsum("j,jab->ab", weights, sum(s.gram for s in stretches))
    cross = weights @ sum(s.cross for s in stretches)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), TINY))
    solution = np.linalg.lstsq(gram * scale[:, None] * scale, cross * scale, rcond=1e-12)[0]
    return np.asarray(solution * scale, dtype=np.float64)


def _weights(stretches: Sequence[_Stretch], n: int) -> Array:
    """(n,) one over the error variance of each joint, found by repetition; the payload's known torque keeps the scale."""
    k = stretches[0].gram.shape[1] - n
    gram, cross = sum(s.gram for s in stretches), sum(s.cross for s in stretches)
    square, count = sum(s.square for s in stretches), sum(s.count for s in stretches)
    weights = 1.0 / np.maximum(np.einsum("jaa->j", np.asarray(gram)[:, k:, k:]), TINY)
    for _ in range(_PASSES):
        x = _solved(stretches, weights, k)
        errors = np.einsum("a,jab,b->j", x, gram, x) - 2.0 * np.asarray(cross) @ x + square
        weights = count / np.maximum(errors, 1e-12 * np.max(errors))
    return weights
