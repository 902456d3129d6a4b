# SPDX-License-Identifier: Apache-2.0
"""How far a calibrated vehicle is predicted wrong, beside what it was told, how long it drove, how it faced and where."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.engines.vehicle.prediction import tracked
from trueup.engines.vehicle.rollout import VehicleSimulator
from trueup.inspection.remainder import (
    DRIVEN,
    EVERY,
    FACED,
    PLACED,
    SIGNALS,
    TOLD,
    Astray,
    cubes,
    means,
    moved,
    powers,
    unexplained,
    unlike,
)
from trueup.noise import estimate_noise
from trueup.recording import Recording
from trueup.samples import wrapped
from trueup.tracking.channels import READ
from trueup.tracking.past import PAST, begun_at
from trueup.trial import Trial


def errors_go_with(
    simulator: VehicleSimulator, values: Array, drives: Sequence[Recording], horizon: float
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What to say of prepared drives whose errors `horizon` s ahead go with commands, time, heading or place, and how large
    those are that are beyond the noise and go with none of these.
    """
    each = [astray(simulator, values, drive, horizon) for drive in drives]
    each = [a for a in each if len(a.begun)]
    said = unlike(each, horizon)
    return said, () if said else unexplained(each, horizon)


def astray(simulator: VehicleSimulator, values: Array, recording: Recording, horizon: float) -> Astray:
    """Of a prepared drive, predicted `horizon` s ahead with values (n,) of the simulator's parameters."""
    trial = Trial.of(recording, simulator.observable(recording))
    past = simulator.past(trial)
    starts = begun_at(past, horizon, EVERY)
    begun, at = past.begin + past.step * starts.astype(np.float64), np.array([0.5 * horizon, horizon])
    rows, _ = simulator.rows(values)
    first, since = 2 * np.arange(len(starts) + 1, dtype=np.int64), np.tile(at, len(starts))
    found = simulator.predict(past, rows[:1], starts, first, since)[0].reshape(len(starts), 2, READ)[:, :, :3]
    position, heading = recording.channel("position"), recording.channel("heading")
    pose = np.concatenate([position.values, heading.at(position.time)], axis=1)
    seen = tracked(position.time, pose, begun[:, None] + at)
    errors = moved(found) - moved(seen)
    errors[:, 2] = wrapped(errors[:, 2])
    windows = np.round(np.arange(-PAST, horizon + 0.5) / past.step).astype(np.int64)
    way = np.linalg.norm(seen[:, 1, :2] - seen[:, 0, :2], axis=1)
    driven = (begun - 0.5 * (begun[:1] + begun[-1:]))[:, None]
    beside = {
        TOLD: np.concatenate([means(cubes(past.commands), starts, windows), cubes(past.seen[starts, 3:])], axis=1),
        DRIVEN: np.concatenate([driven, driven * means(past.commands, starts, windows)], axis=1),
        FACED: np.concatenate([np.cos(found[:, :, 2]), np.sin(found[:, :, 2])], axis=1),
        PLACED: np.concatenate([seen.mean(axis=1), way[:, None]], axis=1),
    }
    alone = [means(powers(c), starts, windows) for c in past.commands.T] + [
        powers(past.seen[starts, k]) for k in (3, 4)
    ]
    x, y, psi = estimate_noise(pose, position.time).tolist()
    noise = np.array([np.hypot(x, y), np.hypot(x, y), np.hypot(psi, psi)])
    return Astray(begun, errors, noise, beside, dict(zip(SIGNALS, alone, strict=True)))
