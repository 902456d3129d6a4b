# SPDX-License-Identifier: Apache-2.0
"""How far one signal lags behind another: clock offsets and delays, to a fraction of a sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.errors import RecordingError
from trueup.recording import Channel

Array = NDArray[np.float64]


def lag(reference: Channel, delayed: Channel, *, longest: float = 0.5, hold: bool = False) -> float:
    """Seconds by which `delayed` lags behind `reference` (negative: it leads), from the labels that both have.

    The speeds of both signals are cross-correlated (slow offsets and drifts then do not matter) up to `longest` s; the
    peak is refined by a parabola. `hold`: the reference is a command, held between its samples.
    Raises RecordingError where they share no label, no time, or do not move.
    """
    labels = [label for label in reference.labels if label in delayed.labels]
    if not labels:
        raise RecordingError(f"channels '{reference.name}' and '{delayed.name}' share no label")
    start, stop = max(reference.time[0], delayed.time[0]), min(reference.time[-1], delayed.time[-1])
    step = float(min(np.median(np.diff(reference.time)), np.median(np.diff(delayed.time))))
    grid = np.arange(start, stop, step)
    if len(grid) < 2 * longest / step:
        raise RecordingError(f"channels '{reference.name}' and '{delayed.name}' overlap for {stop - start:.3g} s only")
    a = np.nan_to_num(np.gradient(reference.select(labels).at(grid, hold=hold), axis=0))
    b = np.nan_to_num(np.gradient(delayed.select(labels).at(grid), axis=0))
    if not a.any() or not b.any():
        raise RecordingError(f"channels '{reference.name}' and '{delayed.name}' do not move: no lag can be seen")
    # Faded at both ends, so that what enters and leaves the overlap does not pull the peak.
    fade = np.hanning(len(grid) + 2)[1:-1]
    a, b = (fade[:, None] * (x - x.mean(axis=0)) / (x.std(axis=0) + 1e-12) for x in (a, b))
    width = int(longest / step)
    size = 1 << int(np.ceil(np.log2(len(grid) + width)))
    spectrum = np.fft.rfft(b, size, axis=0) * np.conj(np.fft.rfft(a, size, axis=0))
    overlap = np.fft.irfft(np.abs(np.fft.rfft(fade, size)) ** 2, size)
    correlation = np.fft.irfft(spectrum, size, axis=0).sum(axis=1) / np.maximum(overlap, 1e-3 * overlap[0])
    around = np.concatenate([correlation[-width:], correlation[: width + 1]])
    k = int(around.argmax())
    fraction = 0.0
    if 0 < k < len(around) - 1:
        left, mid, right = around[k - 1 : k + 2]
        fraction = 0.5 * (left - right) / (left - 2 * mid + right)
    return float((k - width + fraction) * step)
