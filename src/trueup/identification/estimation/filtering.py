# SPDX-License-Identifier: Apache-2.0
"""Zero-phase low-pass filters, derivatives, even instants: what turns a log into samples that can be compared."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array
from trueup.errors import IdentificationError
from trueup.instant import usual_step
from trueup.rounding import PRINTED, whole_steps
from trueup.samples import between

ORDER = 8
"""Of the filter as a whole: half of it runs forward, half of it backward."""
_NYQUIST = 0.8
"""The highest cut-off, as a share of half the rate."""


@dataclass(frozen=True)
class Lowpass:
    """A Butterworth low-pass that shifts nothing in time, for signals at `rate` Hz; each way -3 dB at `cutoff` Hz."""

    rate: float
    cutoff: float

    def __post_init__(self) -> None:
        """Checks that the cut-off can be had at this rate."""
        if not 0.0 < self.cutoff < 0.5 * self.rate:
            raise IdentificationError(
                f"a cut-off of {self.cutoff:g} Hz cannot be had at {self.rate:g} samples per second; "
                f"it must lie between 0 and {0.5 * self.rate:g} Hz"
            )

    def __call__(self, values: ArrayLike, axis: int = 0) -> Array:
        """`values` filtered along `axis`, forward and backward. Raises IdentificationError for too few samples."""
        from scipy.signal import butter, sos2zpk, sosfiltfilt  # half a second to load

        signal = np.asarray(values, dtype=np.float64)
        if signal.size == 0:
            return signal
        samples = signal.shape[axis]
        if samples < 2 * ORDER:
            raise IdentificationError(f"{samples} samples are too few to filter; at least {2 * ORDER} needed")
        sections = butter(ORDER // 2, self.cutoff, fs=self.rate, output="sos")
        # Prolonged at both ends until the filter has forgotten where it began.
        poles = np.asarray(sos2zpk(sections)[1], dtype=np.complex128)
        lasting = math.log(PRINTED) / math.log(float(np.abs(poles).max()))
        padding = min(math.ceil(lasting), samples - 1)
        return np.ascontiguousarray(sosfiltfilt(sections, signal, axis=axis, padlen=padding))


def derivative(values: Array, rate: float) -> Array:
    """(T, ...) rate of change of samples (T, ...) by central differences, second order at both ends too."""
    return np.asarray(np.gradient(values, 1.0 / rate, axis=0, edge_order=2))


def even(time: Array, values: Array, instants: Array) -> Array:
    """(N, k) values (T, k) at even instants (N,), linear between samples; as they are where they are even already."""
    if len(time) == len(instants) and np.all(np.abs(time - instants) < 1e-3 * usual_step(time)):
        return values
    return between(instants, time, values)


def moved(values: Array, by: float) -> Array:
    """(T, ...) even samples (T, ...) that oversample what they hold, read `by` samples later; between them too.

    Lagrange's polynomial through the six neighbours; beyond the ends the first and last value hold.
    """
    whole = math.floor(by)
    reach, x, nodes = abs(whole) + 3, by - whole + 2.0, range(6)
    padded = np.pad(values, [(reach, reach), *[(0, 0)] * (values.ndim - 1)], mode="edge")
    result = np.zeros(values.shape)
    for i in nodes:
        weight = math.prod((x - k) / (i - k) for k in nodes if k != i)
        first = reach + whole - 2 + i
        result += weight * padded[first : first + len(values)]
    return result


def stretches(time: Array) -> list[slice]:
    """Where instants (T,) go on evenly: the samples between two gaps."""
    steps = np.diff(time)
    edges = [0, *(np.flatnonzero(steps > 1.5 * np.median(steps)) + 1).tolist(), len(time)] if len(time) > 1 else [0, 1]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def grid(time: Array) -> tuple[Array, float]:
    """Even instants over the time (T,) of a log, and their rate in Hz: as many as the log has where it is even."""
    usual = usual_step(time)
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
    return max(1, whole_steps(rate, wanted))


def slow_cutoff(rate: float) -> float:
    """A cut-off in Hz that leaves little but motion at a rate in Hz: for rough looks, and the lowest that makes sense."""
    return min(5.0, 0.08 * rate)


def highest_cutoff(rate: float) -> float:
    """The highest cut-off in Hz that makes sense at a rate in Hz."""
    return _NYQUIST * 0.5 * rate


def lowest_rate(cutoff: float) -> float:
    """The lowest rate in Hz at which a cut-off in Hz makes sense."""
    return cutoff / highest_cutoff(1.0)
