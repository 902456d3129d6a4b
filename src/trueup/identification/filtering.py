# SPDX-License-Identifier: Apache-2.0
"""Zero-phase low-pass filters, derivatives and even instants: what turns a log into samples that can be compared."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from trueup.errors import IdentificationError

Array = NDArray[np.float64]

ORDER = 8
"""Of the filter as a whole: half of it runs forward, half of it backward."""
_NYQUIST = 0.8
"""The highest cut-off, as a share of half the rate."""
_PADDING = 3.0
"""Periods of the cut-off by which a signal is prolonged at both ends."""


@dataclass(frozen=True)
class Lowpass:
    """A Butterworth low-pass that shifts nothing in time, for signals at `rate` Hz; each way -3 dB at `cutoff` Hz."""

    rate: float
    cutoff: float
    order: int = ORDER

    def __post_init__(self) -> None:
        """Checks that the cut-off can be had at this rate."""
        if not 0.0 < self.cutoff < 0.5 * self.rate:
            raise IdentificationError(
                f"a cut-off of {self.cutoff:g} Hz cannot be had at {self.rate:g} samples per second; "
                f"it must lie between 0 and {0.5 * self.rate:g} Hz"
            )

    def __call__(self, values: ArrayLike, axis: int = 0) -> Array:
        """`values` filtered along `axis`, forward and backward. Raises IdentificationError for too few samples."""
        signal = np.asarray(values, dtype=np.float64)
        if signal.size == 0:
            return signal
        padding = min(int(_PADDING * self.rate / self.cutoff) + 1, signal.shape[axis] - 1)
        if signal.shape[axis] < 2 * ORDER:
            raise IdentificationError(
                f"{signal.shape[axis]} samples are too few to filter; at least {2 * ORDER} needed"
            )
        return np.asarray(sosfiltfilt(self._sections(), signal, axis=axis, padlen=padding))

    def _sections(self) -> Array:
        return np.asarray(butter(max(self.order // 2, 1), self.cutoff, fs=self.rate, output="sos"))


def derivative(values: Array, rate: float) -> Array:
    """(T, ...) rate of change of samples (T, ...) by central differences, second order at both ends too."""
    return np.asarray(np.gradient(values, 1.0 / rate, axis=0, edge_order=2))


def even(time: Array, values: Array, instants: Array) -> Array:
    """(N, k) values (T, k) at even instants (N,): a cubic spline through the samples, linear across gaps and noise."""
    steps = np.diff(time)
    if np.all(np.abs(steps - np.median(steps)) < 1e-3 * np.median(steps)) and len(time) == len(instants):
        return values
    if float(steps.max()) > 2.5 * float(np.median(steps)) or float(np.std(steps)) > 0.05 * float(np.median(steps)):
        return np.stack([np.interp(instants, time, column) for column in values.T], axis=1)
    return np.asarray(CubicSpline(time, values)(instants))


def grid(time: Array) -> tuple[Array, float]:
    """Even instants over the time (T,) of a log, and their rate in Hz: as many as the log has where it is even."""
    usual = float(np.median(np.diff(time)))
    mean = float((time[-1] - time[0]) / (len(time) - 1))
    step = mean if abs(mean / usual - 1.0) < 0.01 else usual
    rate = 1.0 / step
    # Rates are round numbers; 124.99998 Hz comes from printed time stamps.
    if abs(rate / round(rate) - 1.0) < 1e-4 and round(rate) > 0:
        rate = float(round(rate))
    count = math.floor((time[-1] - time[0]) * rate + 1e-3) + 1
    return time[0] + np.arange(count) / rate, rate


def decimated(rate: float, wanted: float) -> int:
    """Every how many-th sample to keep so that at least `wanted` Hz are left of `rate` Hz."""
    return max(1, math.floor(rate / wanted + 1e-9))


def highest_cutoff(rate: float) -> float:
    """The highest cut-off in Hz that makes sense at a rate in Hz."""
    return _NYQUIST * 0.5 * rate
