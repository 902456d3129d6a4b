# SPDX-License-Identifier: Apache-2.0
"""How far predictions go astray: from many instants of a drive, some seconds ahead, under the commands that followed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.engines.vehicle.rollout import VehicleSimulator
from trueup.engines.vehicle.vehicle import HORIZONS
from trueup.errors import RecordingError
from trueup.inspection.remainder import EVERY
from trueup.recording import Recording
from trueup.rounding import PRINTED
from trueup.tracking.past import begun_at, first_state, last_known
from trueup.trial import Trial


def prediction_errors(
    simulator: VehicleSimulator, values: Array, recording: Recording, horizons: Sequence[float] = HORIZONS
) -> Array:
    """(S, len(horizons)) distances in m between predicted and tracked position, for predictions begun every `EVERY` s.

    A prediction may use all that was measured until it begins and the commands thereafter. It counts where the car drove
    when it began and was tracked all the way; the tracked position is the mean over 0.1 s around the instant. A drive of a
    few seconds is predicted once, from its first state (`first_state`), NaN at horizons that it does not reach.
    `recording` as `simulator.prepared` gives it; values (n,) of the simulator's parameters.
    """
    trial = Trial.of(recording, simulator.observable(recording))
    drive = simulator.past(trial)
    starts = begun_at(drive, max(horizons), EVERY)
    if not len(starts):
        starts = first_state(drive, min(horizons))
    first = np.arange(len(starts) + 1, dtype=np.int64) * len(horizons)
    since = np.tile(np.sort(np.asarray(horizons, dtype=np.float64)), len(starts))
    rows, _ = simulator.rows(values)
    found = simulator.predict(drive, rows[:1], starts, first, since)[0, :, :2].reshape(len(starts), len(horizons), 2)
    ends = (
        drive.begin
        + drive.step * starts[:, None].astype(np.float64)
        + np.sort(np.asarray(horizons, dtype=np.float64))[None]
    )
    position = recording.channel("position")
    order = np.argsort(np.argsort(horizons))
    errors = np.linalg.norm(found - tracked(position.time, position.values, ends), axis=2)
    return np.where(ends <= last_known(drive) + 0.5 * drive.step, errors, np.nan)[:, order]


def spoken(
    simulator: VehicleSimulator, values: Array, drives: Sequence[Recording], which: str, horizons: Sequence[float]
) -> list[str]:
    """How far off predictions are, in the mean: one sentence a drive, and one for all that are predicted once."""
    each = {f"'{d.name}'{which}": prediction_errors(simulator, values, d, horizons) for d in drives}
    once = [e for e in each.values() if len(e) == 1]
    if len(once) > 1:
        each = {
            **{name: e for name, e in each.items() if len(e) > 1},
            f"{len(once)} short drives{which}": np.concatenate(once),
        }
    said = []
    for name, errors in each.items():
        columns = [(h, e[np.isfinite(e)]) for h, e in zip(horizons, errors.T, strict=True)]
        means = ", ".join(f"{1000 * e.mean():.0f} mm {h:g} s ahead" for h, e in columns if len(e))
        if means:
            said.append(f"{name}: predicted position is off by {means} (mean of {len(errors)} predictions)")
    return said


def moved(simulator: VehicleSimulator, recording: Recording, horizon: float) -> float:
    """How far a car goes in `horizon` s, in the mean over the predictions that are judged, in m; NaN without any."""
    drive = simulator.past(Trial.of(recording, simulator.observable(recording)))
    starts = begun_at(drive, horizon, 0.25)
    if not len(starts):
        starts = first_state(drive, 0.0)
    stops = np.minimum(starts + round(horizon / drive.step), drive.index(last_known(drive)))
    way = drive.seen[stops, :2] - drive.seen[starts, :2]
    return float(np.linalg.norm(way, axis=1).mean()) if len(way) else float("nan")


def horizons_for(simulator: VehicleSimulator, drives: Sequence[Recording], usual: Sequence[float]) -> tuple[float, ...]:
    """The `usual` horizons in s; where all drives are too short for these, what all but stumps reach, and a part of it."""
    pasts = [simulator.past(Trial.of(d, simulator.observable(d))) for d in drives]
    if not pasts or any(len(begun_at(p, max(usual), 0.25)) for p in pasts):
        return tuple(usual)
    reach = [last_known(p) - p.begin - p.step * int(k) for p in pasts for k in first_state(p, 0.0)]
    least = min((r for r in reach if r > 0.5 * max(reach)), default=0.0)
    far = min(np.floor(10.0 * least + PRINTED) / 10.0, max(usual))
    return (min(*usual, round(far / 2.0, 2)), float(far)) if far > 0.0 else tuple(usual)


def tracked(time: Array, values: Array, instants: Array) -> Array:
    """(..., k) the mean of a line through the samples (T, k) within 0.05 s, at the instants (...).

    Raises RecordingError without any.
    """
    good = np.isfinite(values).all(axis=1)
    if not good.any():
        raise RecordingError("there is not one sample in which the position was tracked: nothing to predict")
    grid = np.linspace(-0.05, 0.05, 11)
    return np.stack(
        [np.interp(instants[..., None] + grid, time[good], column).mean(axis=-1) for column in values[good].T], axis=-1
    )
