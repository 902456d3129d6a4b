# SPDX-License-Identifier: Apache-2.0
"""How far predictions go astray: from many instants of a drive, some seconds ahead, under the commands that followed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trueup.engines.vehicle.kernels import MOVES
from trueup.engines.vehicle.past import PAST, Past
from trueup.engines.vehicle.rollout import VehicleSimulator
from trueup.errors import RecordingError
from trueup.recording import Recording
from trueup.trial import Trial

Array = NDArray[np.float64]


def prediction_errors(
    simulator: VehicleSimulator, values: Array, recording: Recording, horizons: Sequence[float] = (1.0, 3.0), *,
    every: float = 0.25,
) -> Array:  # fmt: skip
    """(S, len(horizons)) distances in m between predicted and tracked position, for predictions begun `every` s.

    A prediction may use all that was measured until it begins and the commands thereafter. It counts where the car drove
    when it began and was tracked all the way; the tracked position is the mean over 0.1 s around the instant.
    `recording` as `simulator.prepared` gives it; values (n,) of the simulator's parameters.
    """
    trial = Trial.of(recording, simulator.observable(recording))
    drive = simulator.past(trial)
    starts = begun_at(drive, max(horizons), every)
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
    return np.linalg.norm(found - _tracked(position.time, position.values, ends), axis=2)[:, order]


def spoken(
    simulator: VehicleSimulator, values: Array, drives: Sequence[Recording], horizons: Sequence[float] = (1.0, 3.0)
) -> list[str]:
    """One sentence a drive: how far off its predictions are, in the mean."""
    said = []
    for drive in drives:
        errors = prediction_errors(simulator, values, drive, horizons)
        if len(errors):
            means = ", ".join(
                f"{1000 * e:.0f} mm {h:g} s ahead" for h, e in zip(horizons, errors.mean(axis=0), strict=True)
            )
            said.append(f"'{drive.name}': predicted position is off by {means} (mean of {len(errors)} predictions)")
    return said


def moved(simulator: VehicleSimulator, recording: Recording, horizon: float) -> float:
    """How far a car goes in `horizon` s, in the mean over the predictions that are judged, in m; NaN without any."""
    drive = simulator.past(Trial.of(recording, simulator.observable(recording)))
    starts = begun_at(drive, horizon, 0.25)
    way = drive.seen[starts + round(horizon / drive.step), :2] - drive.seen[starts, :2]
    return float(np.linalg.norm(way, axis=1).mean()) if len(way) else float("nan")


def begun_at(drive: Past, longest: float, every: float) -> NDArray[np.int64]:
    """(S,) grid instants, every `every` s, at which the car drives and from which it is tracked for `longest` s."""
    ahead, back = round(longest / drive.step), round(PAST / drive.step)
    missing = np.concatenate([[0], np.cumsum(~drive.known)])
    candidates = np.arange(drive.earliest + back, len(drive.known) - ahead - 1, max(1, round(every / drive.step)))
    tracked = missing[candidates + ahead + 1] == missing[candidates]
    return candidates[tracked & (drive.seen[candidates, 3] > MOVES)].astype(np.int64)


def _tracked(time: Array, values: Array, instants: Array) -> Array:
    """(..., 2) the mean of a line through the samples within 0.05 s, at the instants."""
    good = np.isfinite(values).all(axis=1)
    if not good.any():
        raise RecordingError("there is not one sample in which the position was tracked: nothing to predict")
    grid = np.linspace(-0.05, 0.05, 11)
    return np.stack(
        [np.interp(instants[..., None] + grid, time[good], column).mean(axis=-1) for column in values[good].T], axis=-1
    )
