# SPDX-License-Identifier: Apache-2.0
"""Where in frequency and at which speeds the replay error is: what the report's small figures show."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.instant import usual_step
from trueup.report.hints import velocity
from trueup.samples import MOSTLY


def amplitude_density(time: Array, error: Array) -> tuple[Array, Array]:
    """(f,) frequencies in Hz and (f,) amplitude spectral density of `error` (T,) in unit/sqrt(Hz), by Welch's method.

    The samples are brought onto an even grid by linear interpolation. Both are empty where there are fewer than
    16 samples, or not mostly there: a spectrum would show the gaps, not the error. The zero frequency is left out.
    """
    from scipy.signal import welch

    finite = np.isfinite(error)
    if finite.sum() < 16 or np.mean(finite) < MOSTLY:
        return np.zeros(0), np.zeros(0)
    step = usual_step(time)
    grid = time[0] + step * np.arange(max(16, int((time[-1] - time[0]) / step) + 1))
    even = np.interp(grid, time[finite], error[finite])
    # Short recordings use a quarter of theirs, so that there is an average.
    segment = min(1024, max(16, grid.size // 4))
    frequency, power = welch(even, fs=1.0 / step, nperseg=segment, detrend="constant")
    return _thinned(np.asarray(frequency[1:], float), np.sqrt(np.asarray(power[1:], float)))


def white_density(noise: float, time: Array) -> float:
    """Amplitude spectral density of white noise of standard deviation `noise`, sampled as `time`; unit/sqrt(Hz)."""
    if time.size < 2:
        return float("nan")
    return float(noise * np.sqrt(2.0 * usual_step(time)))


def error_by_speed(time: Array, measured: Array, error: Array) -> tuple[Array, Array]:
    """(m,) speeds and (m,) mean `error` in bins of measured speed; bins with fewer than five samples are left out.

    Reversal shows as a step at zero (friction, backlash), a delay as a slope.
    """
    speed, bins = velocity(time, measured), 24
    usable = np.isfinite(speed) & np.isfinite(error)
    if usable.sum() < 50:
        return np.zeros(0), np.zeros(0)
    v, e = speed[usable], error[usable]
    limit = float(np.percentile(np.abs(v), 99.0))
    if limit <= 0.0:
        return np.zeros(0), np.zeros(0)
    edges = np.linspace(-limit, limit, bins + 1)
    index = np.digitize(v, edges) - 1
    inside = (index >= 0) & (index < bins)
    count = np.bincount(index[inside], minlength=bins)
    total = np.bincount(index[inside], weights=e[inside], minlength=bins)
    kept = count >= 5
    return ((edges[:-1] + edges[1:]) / 2)[kept], total[kept] / count[kept]


def _thinned(frequency: Array, density: Array) -> tuple[Array, Array]:
    """Means over logarithmic bands, so that the upper decade is not a black bar."""
    points = 220  # spaced evenly on a logarithmic axis
    if frequency.size <= points:
        return frequency, density
    edges = np.geomspace(frequency[0], frequency[-1] * 1.0001, points + 1)
    band = np.digitize(frequency, edges)
    kept = np.unique(band)
    mean = [(float(np.mean(frequency[band == b])), float(np.sqrt(np.mean(density[band == b] ** 2)))) for b in kept]
    pairs = np.array(mean)
    return pairs[:, 0], pairs[:, 1]
