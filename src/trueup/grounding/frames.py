# SPDX-License-Identifier: Apache-2.0
"""Frames of a recording: at which instants it is looked at, and what was measured at them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.errors import GroundingError
from trueup.instant import MISSING, usual_step
from trueup.recording import Channel, Recording
from trueup.rounding import PRINTED, SAME_INSTANT
from trueup.samples import SLIGHT

FRAME = 0.02
"""s: the paper's frame, in which simulator and robot are compared; the shortest one that is taken by itself."""


def period_of(recordings: Sequence[Recording]) -> float:
    """The frame in s that recordings suggest: that of their positions, at least `FRAME`. Raises GroundingError."""
    spacing = [step for r in recordings if (step := step_of(r.channel("position")))]
    if not spacing:
        raise GroundingError("every recording has a single sample; learning needs pairs of them")
    return max(float(np.median(spacing)), FRAME)


def step_of(channel: Channel) -> float:
    """The usual time between samples that hold a value, in s; 0 where there are none."""
    time = channel.time[np.isfinite(channel.values).any(axis=1)]
    return usual_step(time) if len(time) > 1 else 0.0


def instants_of(recording: Recording, period: float) -> Array:
    """(T,) s of a recording's frames: its samples' own instants, every so many, where these are as far apart as frames are;
    else evenly spaced.
    """
    position = recording.channel("position")
    time = position.time[np.isfinite(position.values).any(axis=1)]
    if len(time) < 2:
        return time
    every = period / usual_step(time)
    if every > 1.0 - SLIGHT and abs(every - round(every)) <= SLIGHT * every:
        return time[:: max(round(every), 1)]
    return time[0] + period * np.arange(int((time[-1] - time[0]) / period + PRINTED) + 1)


def measured_at(channel: Channel, instants: Array, period: float) -> Array:
    """(T, k) what was measured at `instants`, on lines between samples that are no further apart than `MISSING` frames, or
    usual steps of the channel where these are longer; NaN in
    gaps that are longer, and outside.
    """
    columns = []
    for values in channel.values.T:
        known = np.isfinite(values)
        time = channel.time[known]
        if len(time) < 2:
            columns.append(np.full(len(instants), np.nan))
            continue
        after = np.clip(np.searchsorted(time, instants), 1, len(time) - 1)
        near = time[after] - time[after - 1] <= MISSING * max(period, usual_step(time))
        sampled = np.minimum(np.abs(time[after] - instants), np.abs(time[after - 1] - instants)) <= SAME_INSTANT
        inside = (instants >= time[0] - SAME_INSTANT) & (instants <= time[-1] + SAME_INSTANT)
        columns.append(np.where((near | sampled) & inside, np.interp(instants, time, values[known]), np.nan))
    return np.stack(columns, axis=1)
