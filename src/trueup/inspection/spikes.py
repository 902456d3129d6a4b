# SPDX-License-Identifier: Apache-2.0
"""Single samples far off their neighbours, as errors on a bus leave them, counted as missing."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array, Mask
from trueup.inspection.diagnosis import few
from trueup.noise import spread
from trueup.recording import Recording
from trueup.samples import NEIGHBOURS, SLIGHT

_SCATTER, _NOISE, _RANGE = 8.0, 12.0, 0.05
"""Times the neighbours' own scatter, times the usual distance from them, and share of the signal's range: only a fault
exceeds all three."""


def without_lone_spikes(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings whose positions lack their spikes (NaN), and notes; those without spikes are the same objects."""
    result, notes = [], []
    for recording in recordings:
        cleaned, said = lone_spikes(recording)
        result.append(cleaned)
        notes += [f"'{recording.name}', {said}"] if said else []
    return result, notes


def lone_spikes(recording: Recording) -> tuple[Recording, str]:
    """A recording whose positions lack their spikes, and a sentence on how many there are, of what, and when; '' for none.

    A spike comes back at once, and goes in one sample further than the joint goes anywhere else in as many as its neighbours
    are: no motion does, and an encoder that begins anew after a turn stays on the other side.
    """
    position = recording.channels.get("position")
    if position is None:
        return recording, ""
    values = np.array(position.values)
    candidates = np.isfinite(values) & ~np.isfinite(without_spikes(values)[0])
    for column, far in zip(values.T, candidates.T, strict=True):
        if far.any():
            column[far & _beyond(column, far)] = np.nan
    gone = np.argwhere(np.isfinite(position.values) & ~np.isfinite(values))
    if not len(gone):
        return recording, ""
    shown = few([
        f"{position.labels[j]} {_shown(float(position.values[i, j]), position.unit_of(position.labels[j]))} at "
        f"{position.time[i]:.4g} s"
        for i, j in gone.tolist()
    ])  # fmt: skip
    samples = "a lone sample is" if len(gone) == 1 else f"{len(gone)} lone samples are"
    said = (
        f"position: {samples} far outside what is around and back at once, as of errors on a bus "
        f"({shown}): counted as missing"
    )
    return recording.with_channel(position.replace(values=values)), said


def _beyond(column: Array, far: Mask) -> Mask:
    """(T,) which samples of a column are further off what is around them than all else goes within as many samples."""
    at, good = np.arange(len(column)), np.isfinite(column) & ~far
    smooth = np.interp(at, at[good], column[good])
    around = np.lib.stride_tricks.sliding_window_view(smooth, 2 * NEIGHBOURS + 1)
    return np.abs(column - smooth) > float(np.ptp(around, axis=1).max())


def _shown(value: float, unit: str) -> str:
    """A value in its unit; of an angle in degrees too, which the file may have."""
    return f"{value:.5g} rad ({math.degrees(value):.5g} deg)" if unit == "rad" else f"{value:.5g} {unit}".rstrip()


def without_spikes(values: Array) -> tuple[Array, Array]:
    """(T, k) signals with NaN for their spikes, and (k,) how many samples of each that are.

    Samples are compared with the median of their neighbours (Hampel, "The influence curve and its role in robust
    estimation", 1974). A signal that is full of them is left alone; what is missing already stays so.
    """
    kept, counts = np.array(values), np.zeros(values.shape[1])
    known = np.isfinite(kept)
    if len(kept) < 8 * NEIGHBOURS or not known.all(axis=1).any():
        return kept, counts
    at = np.arange(len(kept))
    full = np.stack(
        [np.interp(at, at[good], x[good]) if good.any() else x for x, good in zip(kept.T, known.T, strict=True)], axis=1
    )
    low, high = np.quantile(full, [0.01, 0.99], axis=0)
    least = _RANGE * (high - low)
    spikes = np.zeros(full.shape, dtype=bool)
    jumping = np.abs(np.diff(full, axis=0)).max(axis=0) > 0.5 * least  # others have none: most logs cost nothing
    spikes[:, jumping] = _far_off(full[:, jumping], least[jumping])
    spikes &= known & (spikes.mean(axis=0) < SLIGHT)  # of more it is the signal that is so
    kept[spikes] = np.nan
    return kept, spikes.sum(axis=0).astype(np.float64)


def _far_off(full: Array, least: Array) -> Mask:
    """(T, k) whether samples are off their neighbours' median by more than `least` (k,) and more than is usual there."""
    around = np.pad(full, ((NEIGHBOURS, NEIGHBOURS), (0, 0)), mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(around, 2 * NEIGHBOURS + 1, axis=0)
    middle = np.median(around, axis=-1)
    off = np.abs(full - middle)
    usual = np.array([spread(x[x > 0.0]) if np.any(x > 0.0) else 0.0 for x in off.T])
    far = off > np.maximum(_NOISE * usual, least)
    scatter = np.median(np.abs(around[far] - middle[far][:, None]), axis=-1)
    far[far] = off[far] > _SCATTER * scatter
    return far
