# SPDX-License-Identifier: Apache-2.0
"""How far a driven path is from a simulated one, whenever each point was passed: by dynamic time warping.

The loss of the Stanley study, its eq. (8), L = MSE(DTW(x1, x2), DTW(y1, y2)), can be read in three ways; `READINGS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueup.arrays import Array, Mask
from trueup.compiled import njit
from trueup.discrepancies.discrepancy import measured_at
from trueup.discrepancies.dtw import dtw, dtw_path
from trueup.engines.simulator import Rollout
from trueup.errors import RecordingError, unknown_name
from trueup.recording import Recording
from trueup.rounding import NEGLIGIBLE
from trueup.samples import between
from trueup.trial import Trial

READINGS: Mapping[str, str] = MappingProxyType(
    {
        "joint": "R1: x and y are warped together by Euclidean distance; mean squared distance of matched points [m^2]",
        "separate": "R2: x and y are warped each on its own by absolute difference; half the sum of the mean squared "
        "differences [m^2]; the letter of eq. (8), blind to a corner cut that each coordinate can warp away",
        "accumulated": "R3: accumulated Euclidean distance of the joint warping [m]; grows with the number of points, "
        "so only paths of the same spacing compare",
    }
)
"""Name -> what it is; 'joint' is the recommended one."""


def path_loss(
    real: ArrayLike, simulated: ArrayLike, *, reading: str = "joint", spacing: float = 0.1, band: float = 0.1
) -> float:
    """How far a simulated path (m, 2) is from a real one (n, 2), both in m, by one of the READINGS.

    Both are resampled every `spacing` m first (0: as they are), so that neither pauses nor the rate of recording count.
    Raises UnknownNameError for another reading and RecordingError for a path that is empty or not finite.
    """
    p, q = (_prepared(path, spacing) for path in (real, simulated))
    if _known(reading) == "accumulated":
        return dtw(p, q, band=band)
    return float(_squares(p, q, reading, band).sum())


def mean_distance(real: ArrayLike, simulated: ArrayLike, *, spacing: float = 0.1, band: float = 0.1) -> float:
    """Mean distance of matched points in m: the loss that a person can picture. Raises as `path_loss`."""
    p, q = (_prepared(path, spacing) for path in (real, simulated))
    cost, pairs = dtw_path(p, q, band=band)
    return cost / len(pairs)


def resample_by_arc(points: ArrayLike, spacing: float) -> Array:
    """(K, d) points on the polyline (n, d) at equal distances of about `spacing` m, both ends included.

    Points within half a spacing of the last one kept are passed over first: noise while standing is no path.
    Raises RecordingError where `spacing` is not positive or the points are not finite.
    """
    given = np.ascontiguousarray(points, dtype=np.float64)
    if given.ndim != 2 or not len(given) or not np.isfinite(given).all():
        raise RecordingError(
            f"a path of shape {given.shape} with missing points cannot be resampled; it must be (n, d)"
        )
    if not spacing > 0.0:
        raise RecordingError(f"spacing is {spacing} m; it must be positive")
    kept = given[_apart(given, 0.5 * spacing)]
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(kept, axis=0), axis=1))])
    places = np.linspace(0.0, arc[-1], max(2, round(arc[-1] / spacing) + 1))
    return between(places, arc, kept)


class PathShape:
    """A Discrepancy: the mean of its squared residuals over the resampled real path is `path_loss` / `unit`^2.

    Each point of the real path has a residual in x and one in y, from the points matched with it, so that least squares
    can follow them; other channels than 'position' count nothing.
    """

    def __init__(self, *, reading: str = "joint", spacing: float = 0.1, band: float = 0.1, unit: float = 0.01) -> None:
        """`unit`: what counts as one unit of residual, in m. Raises UnknownNameError for another reading."""
        self._reading, self._spacing, self._band, self._unit = _known(reading), spacing, band, unit

    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        """(k,) see Discrepancy."""
        return np.full(len(labels), self._unit)

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        """See Discrepancy. Raises RecordingError where the position has no two coordinates."""
        parts = []
        for name, values in simulated.channels.items():
            observed = simulated.trial.observed[name]
            part = np.zeros((len(values), len(observed.time), len(observed.labels)))
            if name == "position":
                columns = _plane(observed.labels)
                measured = measured_at(real, name, observed.labels, observed.time)[:, columns]
                part[:, :, columns] = self._of_paths(measured, values[:, :, columns])
            parts.append(part.reshape(len(values), -1))
        return np.concatenate(parts, axis=1)

    def compared(self, real: Recording, trial: Trial) -> Mask:
        """See Masked."""
        parts = []
        for name, o in trial.observed.items():
            part = np.zeros((len(o.time), len(o.labels)), dtype=bool)
            if name == "position":
                columns = _plane(o.labels)
                _, rows = self._points(measured_at(real, name, o.labels, o.time)[:, columns])
                part[rows[:, None], columns] = True
            parts.append(part.ravel())
        return np.concatenate(parts)

    def losses(self, real: Array, simulated: Array) -> Array:
        """(b,) `path_loss` of simulated paths (b, T, 2) from a real one (n, 2); NaN where one is not finite."""
        losses = np.full(len(simulated), np.nan)
        for row, path in enumerate(simulated):
            if np.isfinite(path).all():
                losses[row] = path_loss(real, path, reading=self._reading, spacing=self._spacing, band=self._band)
        return losses

    def _points(self, measured: Array) -> tuple[Array, NDArray[np.intp]]:
        """(K, 2) points of the real path, and in which of the T rows of `measured` (T, 2) their residuals stand."""
        p, samples = _prepared(measured[np.isfinite(measured).all(axis=1)], self._spacing), len(measured)
        if len(p) > samples:  # a coarse recording of a long path
            p = p[np.linspace(0, len(p) - 1, samples).round().astype(int)]
        return p, np.linspace(0, samples - 1, len(p)).round().astype(int)

    def _of_paths(self, measured: Array, simulated: Array) -> Array:
        """(b, T, 2) with the residuals of the K points of the real path spread over T rows, nothing in between."""
        p, rows = self._points(measured)
        found = np.zeros(simulated.shape)
        for row, path in enumerate(simulated):
            if not np.isfinite(path).all():
                found[row] = np.nan
                continue
            signed = _squares(p, _prepared(path, self._spacing), self._reading, self._band, signed=True)
            found[row, rows] = np.sign(signed) * np.sqrt(np.abs(signed) * len(p)) / self._unit
        return found


def _squares(p: Array, q: Array, reading: str, band: float, *, signed: bool = False) -> Array:
    """(n, 2) what each point of p adds to the loss in x and in y; `signed`: with the sign of the mean difference."""
    found = np.zeros(p.shape)
    together = None if reading == "separate" else dtw_path(p, q, band=band)[1]
    for axis in range(p.shape[1]):
        pairs = dtw_path(p[:, axis], q[:, axis], band=band)[1] if together is None else together
        i, j = pairs.T
        difference = q[j] - p[i]
        if reading == "accumulated":  # |d| = (dx^2 + dy^2) / |d|
            share = 1.0 / np.maximum(np.linalg.norm(difference, axis=1), NEGLIGIBLE)
        else:
            share = np.full(len(pairs), (0.5 if reading == "separate" else 1.0) / len(pairs))
        found[:, axis] = np.bincount(i, difference[:, axis] ** 2 * share, len(p))
        if signed:
            found[:, axis] *= np.sign(np.bincount(i, difference[:, axis], len(p)))
    return found


def _prepared(path: ArrayLike, spacing: float) -> Array:
    return resample_by_arc(path, spacing) if spacing else np.asarray(path, dtype=np.float64)


def _known(reading: str) -> str:
    if reading not in READINGS:
        raise unknown_name("reading", reading, READINGS, "those of eq. (8)")
    return reading


def _plane(labels: tuple[str, ...]) -> list[int]:
    if "x" in labels and "y" in labels:
        return [labels.index("x"), labels.index("y")]
    if len(labels) < 2:
        raise RecordingError(f"a path needs two coordinates; the position has {', '.join(labels)}")
    return [0, 1]


@njit(cache=True)
def _apart(points: Array, least: float) -> Mask:
    """(n,) True for points at least `least` from the last one kept; the first and the last always."""
    kept = np.zeros(len(points), np.bool_)
    kept[0] = kept[-1] = True
    last = 0
    for i in range(1, len(points)):
        square = 0.0
        for d in range(points.shape[1]):
            square += (points[i, d] - points[last, d]) ** 2
        if square >= least * least:
            kept[i] = True
            last = i
    return kept
