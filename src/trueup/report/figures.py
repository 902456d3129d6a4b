# SPDX-License-Identifier: Apache-2.0
"""The data of the interactive figures, stored once; the browser draws from it what is asked for."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Calibration, Replay
from trueup.formats.plain import finite
from trueup.report.drawing import SAMPLES
from trueup.report.encoding import kept_samples, packed
from trueup.report.hints import sampled, worst_moment
from trueup.report.numbers import Scale, scale_for
from trueup.report.spectra import amplitude_density, error_by_speed, white_density
from trueup.report.summary import Comparison, column_score, comparisons, noise_of, pooled_score
from trueup.rounding import DATE


def figure_data(calibration: Calibration) -> dict[str, Any]:
    """All that the figures need, ready for JSON: replays, search trace and correlations."""
    most_in_all = 400_000  # Samples of all lines together at most, which keeps the file small enough to mail
    groups = comparisons(calibration)
    columns = sum(len(r.labels) for r in calibration.replays)
    most = max(SAMPLES, most_in_all // max(columns, 1))
    replays = [_replay(r, error_scale(group), most) for group in groups for r in group.ordered]
    correlation = correlations(calibration)
    return {
        "replays": replays,
        "start": _start(groups),
        "trace": _trace(calibration, groups),
        "correlation": None if correlation is None else _matrix(calibration, correlation),
    }


def error_scale(group: Comparison) -> Scale:
    """The scale in which all errors of one channel are shown."""
    scores = [pooled_score([r]) for r in group.replays]
    return scale_for(group.unit, [s.after for s in scores])


def correlations(calibration: Calibration) -> Array | None:
    """(n, n) correlations of the fitted parameters, NaN where a variance is missing; None without a covariance."""
    fitted = sum(e.fitted for e in calibration.estimates)
    covariance = np.asarray(calibration.covariance, dtype=float)
    if fitted == 0 or covariance.shape != (fitted, fitted):
        return None
    variance = np.diag(covariance)
    deviation = np.sqrt(np.where(np.isfinite(variance) & (variance > 0), variance, np.nan))
    if np.isnan(deviation).all():
        return None
    with np.errstate(invalid="ignore", over="ignore"):
        return np.clip(covariance / deviation[:, None] / deviation[None, :], -1.0, 1.0)


def _replay(replay: Replay, scale: Scale, most: int) -> dict[str, Any]:
    origin = float(replay.time[0]) if replay.time.size else 0.0
    return {
        "recording": replay.recording,
        "heldOut": replay.held_out,
        "channel": replay.channel,
        "unit": replay.unit,
        "errorUnit": scale.unit,
        "errorFactor": scale.factor,
        "labels": list(replay.labels),
        "origin": 0.0 if abs(origin) > DATE else origin,
        "fromStart": abs(origin) > DATE,
        "samples": int(replay.time.size),
        "columns": [_column(replay, j, most) for j in range(len(replay.labels))],
    }


def _column(replay: Replay, column: int, most: int) -> dict[str, Any]:
    own = sampled(replay.measured[:, column])
    measured = replay.measured[own, column]
    before, after = replay.before[own, column] - measured, replay.after[own, column] - measured
    command = None if replay.command is None else replay.command[own, column]
    time = replay.time[own] - (replay.time[0] if replay.time.size else 0.0)
    lines = [measured, before, after] + ([] if command is None else [command])
    kept = kept_samples(lines, most)
    score, (start, stop, _) = column_score(replay, column), worst_moment(time, after)
    noise = float(noise_of(replay)[column])
    return {
        "time": packed(time[kept]),
        "measured": packed(measured[kept]),
        "before": packed(before[kept]),
        "after": packed(after[kept]),
        "command": None if command is None else packed(command[kept]),
        "noise": finite(noise),
        "score": [finite(score.before), finite(score.after)],
        "worst": None if math.isnan(start) else [start, stop],
        "spectrum": _spectrum(time, before, after, noise),
        "speed": [packed(v) for e in (before, after) for v in error_by_speed(time, measured, e)],
    }


def _spectrum(time: Array, before: Array, after: Array, noise: float) -> dict[str, Any]:
    return {
        "before": [packed(v) for v in amplitude_density(time, before)],
        "after": [packed(v) for v in amplitude_density(time, after)],
        "noise": finite(white_density(noise, time)),
    }


def _start(groups: tuple[Comparison, ...]) -> list[int]:
    """[replay, column] to show first: the largest remaining error of a held-out motion, else of any."""
    if not groups:
        return [0, 0]
    shown = groups[0].ordered
    candidates = range(len(groups[0].held_out) or len(shown))
    best, largest = [0, 0], -1.0
    for i in candidates:
        for j in range(len(shown[i].labels)):
            after = column_score(shown[i], j).after
            if after > largest:
                best, largest = [i, j], after
    return best


def _trace(calibration: Calibration, groups: tuple[Comparison, ...]) -> dict[str, Any]:
    # the trace is pooled over the fitted recordings in the unit of the main channel: same scale as its errors
    scale = error_scale(groups[0]) if groups else Scale("", 1.0)
    points = [
        [p.stage, p.evaluations, finite(p.loss), finite(p.rmse * scale.factor), finite(p.seconds)]
        for p in calibration.trace
    ]
    return {"unit": scale.unit, "points": points}


def _matrix(calibration: Calibration, correlation: Array) -> dict[str, Any]:
    return {
        "names": [e.name for e in calibration.estimates if e.fitted],
        "values": packed(correlation.ravel()),
    }
