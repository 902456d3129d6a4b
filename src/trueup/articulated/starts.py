# SPDX-License-Identifier: Apache-2.0
"""Where a run began and how fast, from the first measured samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trueup.articulated.model import BasePose, Model
from trueup.articulated.pose import ANGLES, AXES, ORIENTATION, POSITION
from trueup.recording import Channel
from trueup.trial import Trial

Array = NDArray[np.float64]

_WINDOW = 0.06  # s of samples from which a start state is estimated


def measured_base(trial: Trial) -> BasePose | None:
    """The pose of a free base at the trial's start, where its position and angles (`pose.in_angles`) were measured."""
    position, orientation = trial.initial.get(POSITION), trial.initial.get(ORIENTATION)
    if position is None or orientation is None or orientation.labels != ANGLES:
        return None
    states = []
    for channel in (position.select(AXES), orientation):
        state = np.array(starting_point(channel, trial.start))
        if channel.name in trial.corrections:
            labels = trial.initial[channel.name].labels
            state += trial.corrections[channel.name][:, [labels.index(n) for n in channel.labels]]
        states += list(state)
    return BasePose(*states)


def at_rest(model: Model) -> tuple[Array, Array]:
    """(k,), (k,) positions and velocities of the joints of `model.drives()` where the model begins."""
    place, pace = ([model.get(f"joint.{a}", j)[0] for j in model.drives()] for a in ("start", "start_velocity"))
    return np.array(place, dtype=np.float64), np.array(pace, dtype=np.float64)


def measured_start(rest: tuple[Array, Array], trial: Trial, joints: Sequence[str]) -> tuple[Array, Array]:
    """(k,), (k,) positions and velocities of `joints` at the trial's start, from its recording; else those of `rest`."""
    place, pace = (np.array(r) for r in rest)
    position, velocity = trial.initial.get("position"), trial.initial.get("velocity")
    if position is not None:
        value, slope = starting_point(position, trial.start)
        for label, q, v in zip(position.labels, value, slope, strict=True):
            if label in joints and np.isfinite(q):
                place[joints.index(label)] = q
                pace[joints.index(label)] = v if np.isfinite(v) else 0.0
    if velocity is not None and velocity.unit:
        value, _ = starting_point(velocity, trial.start)
        for label, v in zip(velocity.labels, value, strict=True):
            known = not np.isfinite(v) or _slope_knows_better(position, velocity, label, trial.start)
            if label in joints and not known:
                pace[joints.index(label)] = v
    if position is not None and "position" in trial.corrections:
        for label, q, v in zip(position.labels, *trial.corrections["position"], strict=True):
            if label in joints:
                place[joints.index(label)] += q
                pace[joints.index(label)] += v
    return place, pace


def _slope_knows_better(position: Channel | None, velocity: Channel, label: str, start: float) -> bool:
    """Whether the slope of the measured positions tells the start speed more exactly than a noisy speed channel."""
    if position is None or label not in position.labels:
        return False
    # Variances at the end of a parabola through n samples in T seconds: 9 / n of its value, 192 / (n T^2) of its slope.
    sigma = {}
    for channel, factor in ((position, 192.0**0.5 / _WINDOW), (velocity, 3.0)):
        inside = (channel.time >= start - 1e-9) & (channel.time < start + 4.0 * _WINDOW)
        sigma[channel.name] = factor * _scatter(channel.column(label)[inside]) / max(float(inside.sum()), 1.0) ** 0.5
    return sigma[position.name] < sigma[velocity.name]


def _scatter(values: Array) -> float:
    """Noise of a short stretch: third differences hide smooth motion and keep noise, at twenty times its variance."""
    finite = values[np.isfinite(values)]
    return float(np.std(np.diff(finite, 3)) / np.sqrt(20.0)) if len(finite) > 4 else 0.0


def starting_point(channel: Channel, start: float, window: float = _WINDOW) -> tuple[Array, Array]:
    """(k,) value and (k,) slope at the start: a line or parabola through the first `window` s (five samples at least).

    Where the motion bends more than a parabola can follow, fewer samples are used. A joint that has not moved by more
    than its samples scatter is taken to be at rest.
    """
    inside = channel.time >= start - 1e-9
    time, values = channel.time[inside] - start, channel.values[inside]
    count = max(5, int(np.searchsorted(time, window)))
    value, slope = np.full(values.shape[1], np.nan), np.zeros(values.shape[1])
    for j in range(values.shape[1]):
        good = np.isfinite(values[:count, j])
        t, y = time[:count][good], values[:count, j][good]
        if len(t) == 0:
            continue
        noise = _scatter(values[: 4 * count, j])
        if len(t) < 3 or float(np.std(y)) <= 2.0 * noise + 1e-12:
            value[j] = float(y.mean())
        else:
            value[j], slope[j] = _parabola(t, y, noise)
    return value, slope


def _parabola(t: Array, y: Array, noise: float) -> tuple[float, float]:
    """Value and slope at 0 of a parabola through as many of the first samples as it fits to within twice the noise."""
    for count in range(len(t), 3, -1):
        curve = np.polynomial.Polynomial.fit(t[:count], y[:count], min(2, count - 2))
        error = float(np.sqrt(np.sum((curve(t[:count]) - y[:count]) ** 2) / max(count - 3, 1)))
        if error <= 2.0 * noise or count <= 5:
            return float(curve(0.0)), float(curve.deriv()(0.0))
    line = np.polynomial.Polynomial.fit(t, y, 1)
    return float(line(0.0)), float(line.deriv()(0.0))
