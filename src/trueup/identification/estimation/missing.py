# SPDX-License-Identifier: Apache-2.0
"""Stretches that a log does not hold: instants without a sample, joints without a value."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array, Mask
from trueup.errors import IdentificationError, listed
from trueup.instant import usual_step
from trueup.recording import Channel

_GAP, _GAP_STEPS = 0.02, 5.0

Gaps = tuple[tuple[float, float], ...]
"""First and last instant in s of each stretch."""


def gaps(*clocks: Array) -> Gaps:
    """Stretches of more than 20 ms and five usual steps without a sample."""
    return tuple(sorted({gap for time in clocks for gap in _between(time, usual_step(time))}))


def clear_of(gaps: Gaps, time: Array, margin: float = 0.0) -> Mask:
    """(T,) which instants lie in none of the stretches, nor within `margin` s of one."""
    clear = np.ones(len(time), dtype=bool)
    for first, last in gaps:
        clear &= (time < first - margin) | (time > last + margin)
    return clear


def bridged(channel: Channel, recording: str) -> tuple[Channel, Gaps, list[str]]:
    """A channel with a value everywhere, the stretches where none was measured for longer than `gaps` allows, and a note on
    these: single missing samples are bridged, of a stretch nothing is known.

    Raises IdentificationError for a joint that lacks values in half of the log.
    """
    values, step = np.array(channel.values), usual_step(channel.time)
    lost: dict[tuple[float, float], list[str]] = {}
    for k, label in enumerate(channel.labels):
        known = np.isfinite(values[:, k])
        if known.all():
            continue
        ends = channel.time[[0, -1]]
        stretches = _between(np.unique([*ends, *channel.time[known]]), step) if known.any() else [(ends[0], ends[1])]
        if sum(last - first for first, last in stretches) > 0.5 * (ends[1] - ends[0]):
            raise IdentificationError(
                f"recording '{recording}', channel '{channel.name}': {np.count_nonzero(~known)} of {len(known)} samples of "
                f"'{label}' are missing; cut the log where they are, or lock the joint (--lock {label})"
            )
        values[~known, k] = np.interp(channel.time[~known], channel.time[known], values[known, k])
        for stretch in stretches:
            lost.setdefault(stretch, []).append(label)
    said = [f"of {listed(labels)} from {first:.4g} to {last:.4g} s" for (first, last), labels in lost.items()]
    note = (
        f"recording '{recording}': {channel.name} is missing {listed(said)}; what is missing is left out, of what the model "
        "is judged by too"
    )
    return channel.replace(values=values), tuple(lost), [note] if lost else []


def _between(time: Array, step: float) -> Sequence[tuple[float, float]]:
    long = np.flatnonzero(np.diff(time) > max(_GAP_STEPS * step, _GAP))
    return [(float(time[i]), float(time[i + 1])) for i in long]
