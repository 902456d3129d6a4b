# SPDX-License-Identifier: Apache-2.0
"""Where a run starts: pose, speed and turn rate from what was measured around its first instant."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.errors import RecordingError
from trueup.paths import Path
from trueup.recording import Channel
from trueup.tracking.channels import READ
from trueup.trial import Trial

POSE_WINDOW = 0.12
"""s: a parabola through this much of the past, or a line through as much on both sides, gives the pose and the turn rate at
an instant: long enough to average noise, short enough to be straight."""


def start_state(trial: Trial) -> Array:
    """(READ,) x, y, heading (m, rad), speed (m/s) and yaw rate (rad/s) at `trial.start`.

    A channel in `trial.initial` counts first; else the start of the trial's path; else the origin. Speed and turn rate
    that were not measured come from the slopes of position and heading.
    """
    s = np.zeros(READ)
    given = trial.initial
    if "path" in trial.references and "position" not in given:
        path = Path.of(trial.references["path"], trial.name)
        s[:2], s[2] = path.points[0], path.heading[0]
    if "position" in given:
        (s[0], vx), (s[1], vy) = (_fitted(given["position"], label, trial) for label in ("x", "y"))
        if "heading" not in given:
            s[2] = np.arctan2(vy, vx)
        s[3] = np.hypot(vx, vy)
    if "heading" in given:
        s[2], s[4] = _fitted(given["heading"], "heading", trial)
    if "speed" in given:
        s[3] = _fitted(given["speed"], "speed", trial)[0]
    if "yaw_rate" in given:
        s[4] = _fitted(given["yaw_rate"], "yaw_rate", trial)[0]
    return s


def _fitted(channel: Channel, label: str, trial: Trial) -> tuple[float, float]:
    """Value and slope at the trial's start: a line through the samples around it (one sample: that value, no slope)."""
    more = trial.corrections.get(channel.name, np.zeros((2, len(channel.labels))))[:, channel.labels.index(label)]
    values = channel.column(label)
    good = np.isfinite(values)
    time, values = channel.time[good] - trial.start, values[good]
    if not len(time):
        raise RecordingError(f"trial '{trial.name}': channel '{channel.name}' has no sample of '{label}'")
    near = np.abs(time) <= POSE_WINDOW
    if near.sum() < 3:
        near = np.zeros(len(time), dtype=bool)
        near[np.argsort(np.abs(time), kind="stable")[:3]] = True
    if near.sum() < 2:
        return float(values[near][0] + more[0]), float(more[1])
    slope, value = np.polyfit(time[near], values[near], 1)
    return float(value + more[0]), float(slope + more[1])
