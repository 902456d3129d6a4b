# SPDX-License-Identifier: Apache-2.0
"""How far predictions of a simulator go astray: started again and again from what was measured until then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Ahead
from trueup.engines.floating import placed
from trueup.engines.simulator import Simulator
from trueup.instant import usual_step
from trueup.recording import Channel, Recording
from trueup.rounding import SAME_INSTANT
from trueup.trial import Observed, Trial

HORIZONS = (0.1, 1.0)
"""s ahead that are judged, beside the next sample."""
_PAST, _FITTED = 200, 5  # samples before a start that tell of it, and of the place


def predicted_ahead(
    simulator: Simulator, values: Array, recordings: Sequence[Recording], channels: Sequence[str]
) -> tuple[Ahead, ...]:
    """Errors one sample, 0.1 s and 1 s ahead of predictions by values (n,), about sixty of each recording.

    Each begins where the robot was and as fast as it went by the samples up to then, those that come after being what it is
    judged by; commands are those of the recording. A horizon that does not fit into a recording is NaN there. Recordings
    that do not tell where a free base was have no predictions.
    """
    found: list[Ahead] = []
    for recording in recordings:
        whole = Trial.of(recording, [c for c in channels if c in simulator.observable(recording)])
        if whole.command is None or not whole.observed or not placed(simulator, whole):
            continue
        clock = next(iter(whole.observed.values())).time
        period = usual_step(clock)
        horizons = (period, *(h for h in HORIZONS if h > 1.5 * period))
        begin = clock[clock >= whole.start + 5.0 * period]
        begin = begin[begin <= clock[-1] - horizons[1] if len(horizons) > 1 else begin <= clock[-1] - period]
        if not len(begin):
            continue
        count = 60  # predictions of a recording
        starts = begin[np.unique(np.linspace(0, len(begin) - 1, count).astype(int))]
        trials = [_from(whole, recording, float(at), horizons) for at in starts]
        rows = [r for r in simulator.rollout(trials, values[None])]
        for name, observed in whole.observed.items():
            errors = np.stack([_errors(recording.channel(name), observed.labels, row.channels[name][0], at, horizons)
                               for row, at in zip(rows, starts, strict=True)])  # fmt: skip
            found.append(Ahead(recording.name, name, observed.labels, observed.unit, horizons, errors))
    return tuple(found)


def _from(trial: Trial, recording: Recording, at: float, horizons: Sequence[float]) -> Trial:
    """The trial from an instant on: its start by samples until then, seen at the horizons alone."""
    seen = {n: Observed(o.labels, o.unit, at + np.array(horizons)) for n, o in trial.observed.items()}
    initial = {n: _as_until(recording.channel(n), at) for n in trial.initial}
    return replace(trial, start=at, duration=max(horizons) + 1e-6, observed=seen, initial=initial)


def _as_until(channel: Channel, at: float) -> Channel:
    """What a channel did until an instant, turned about its value there: later samples that tell the same place and speed,
    and scatter as the real ones do.
    """
    until = channel.time <= at + SAME_INSTANT
    time, values = channel.time[until][-_PAST:], channel.values[until][-_PAST:]
    if len(time) < _FITTED:
        return channel
    there = [_value(time[-_FITTED:] - at, column[-_FITTED:]) for column in values.T]
    return replace(channel, time=(2.0 * at - time)[::-1], values=(2.0 * np.array(there) - values)[::-1])


def _value(time: Array, values: Array) -> float:
    """A line through the last samples, at 0."""
    good = np.isfinite(values)
    return float(np.polynomial.Polynomial.fit(time[good], values[good], 1)(0.0)) if good.sum() > 2 else float("nan")


def _errors(channel: Channel, labels: Sequence[str], simulated: Array, at: float, horizons: Sequence[float]) -> Array:
    """(H, k) simulated minus measured, at the horizons."""
    return simulated - channel.select(labels).at(at + np.array(horizons))
