# SPDX-License-Identifier: Apache-2.0
"""Why not yet: what the error that is left looks like, and when it is largest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Mask
from trueup.calibration import Replay
from trueup.evidence import HALVED
from trueup.instant import usual_step
from trueup.report.numbers import Scale, significant, with_unit
from trueup.report.summary import Score, label_score
from trueup.rounding import SAME_INSTANT
from trueup.samples import MOSTLY

TELLING = 0.25
"""A pattern is named when it explains at least this share of the squared error."""


WINDOW = 1.0
"""Length of the worst moment, in s."""


@dataclass(frozen=True)
class Hint:
    """What is left of one label's error, over several replays."""

    label: str
    score: Score
    sentence: str
    recording: str
    """Where the error is largest."""
    start: float
    stop: float
    """The worst moment in that recording, in s."""


def hints(replays: Sequence[Replay], scale: Scale) -> list[Hint]:
    """One hint for each label, the largest remaining error first."""
    labels = dict.fromkeys(label for r in replays for label in r.labels)
    found = [_hint([r for r in replays if label in r.labels], label, scale) for label in labels]
    return sorted((h for h in found if h is not None), key=lambda h: -h.score.after)


def worst_moment(time: Array, error: Array) -> tuple[float, float, float]:
    """(start, stop, rms): the stretch of about a second with the largest mean square error; NaN samples are skipped.

    `time` and `error` are (T,). All NaN where no error is finite.
    """
    finite = np.isfinite(error)
    if not finite.any():
        return math.nan, math.nan, math.nan
    t, squares = time[finite], error[finite] ** 2
    window = min(WINDOW, float(t[-1] - t[0]))
    total = np.concatenate([[0.0], np.cumsum(squares)])
    first = np.arange(t.size)
    last = np.searchsorted(t, t + window, side="right")
    whole = t + window <= t[-1] + SAME_INSTANT
    mean = np.where(whole, (total[last] - total[first]) / (last - first), -1.0)
    best = int(np.argmax(mean))
    return float(t[best]), float(t[last[best] - 1]), math.sqrt(max(float(mean[best]), 0.0))


def sampled(measured: Array) -> Mask:
    """(T,) which samples are those of one label: its own, where more than a few miss it, as it was measured by another clock
    (a camera's, beside encoders); elsewhere all, and what is missing was lost.
    """
    known = np.isfinite(measured)
    return known if known.any() and np.mean(known) < MOSTLY else np.ones(len(known), dtype=bool)


def velocity(time: Array, measured: Array) -> Array:
    """(T,) rate of change of `measured` (T,), smoothed over about 60 ms; NaN beside missing samples."""
    if time.size < 3:
        return np.full(time.shape, np.nan)
    width = max(1, round(0.06 / usual_step(time)) | 1)
    width = min(width, (time.size - 1) | 1)
    padded = np.pad(measured, width // 2, mode="edge")
    smooth = np.convolve(padded, np.full(width, 1.0 / width), mode="valid")[: time.size]
    return np.gradient(smooth, time)


def _hint(replays: Sequence[Replay], label: str, scale: Scale) -> Hint | None:
    score = label_score(replays, label)
    moments = []
    for replay in replays:
        column = replay.labels.index(label)
        moments.append((replay, worst_moment(replay.time, replay.after[:, column] - replay.measured[:, column])))
    moments = [m for m in moments if math.isfinite(m[1][2])]
    if not moments:
        return None
    replay, (start, stop, _) = max(moments, key=lambda m: m[1][2])
    return Hint(label, score, _sentence(replays, label, score, scale), replay.recording, start, stop)


def _sentence(replays: Sequence[Replay], label: str, score: Score, scale: Scale) -> str:
    if HALVED * score.after <= score.noise:
        times = round(score.after / score.noise, 1) if score.noise else 1.0
        if times <= 1.0:
            return "at the measurement noise: these recordings show nothing more to explain"
        return f"{times:g} times the measurement noise: these recordings show little more to explain"
    error, position, speed = _samples(replays, label)
    mean_square = float(np.mean(error**2)) if error.size else 0.0
    if error.size < 20 or mean_square == 0.0:
        return "too few samples to say more"
    shares = _shares(error, position, speed)
    name, (share, size) = max(shares.items(), key=lambda item: item[1][0])
    if share < TELLING:
        return "no simple pattern: not an offset, a delay, a gain or a change with direction"
    return f"{_PATTERNS[name](size, scale)} ({share:.0%} of the squared error)"


def _samples(replays: Sequence[Replay], label: str) -> tuple[Array, Array, Array]:
    errors, positions, speeds = [], [], []
    for replay in replays:
        column = replay.labels.index(label)
        own = sampled(replay.measured[:, column])
        measured = replay.measured[own, column]
        errors.append(replay.after[own, column] - measured)
        positions.append(measured)
        speeds.append(velocity(replay.time[own], measured))
    error, position, speed = np.concatenate(errors), np.concatenate(positions), np.concatenate(speeds)
    usable = np.isfinite(error) & np.isfinite(position) & np.isfinite(speed)
    return error[usable], position[usable], speed[usable]


def _shares(error: Array, position: Array, speed: Array) -> dict[str, tuple[float, float]]:
    """For each pattern the share of the squared error that it alone explains, and its size."""
    mean_square = float(np.mean(error**2))
    mean = float(np.mean(error))
    typical = float(np.sqrt(np.mean(speed**2)))
    # tanh instead of a sign: measurement noise at rest must not look like reversals
    direction = np.tanh(speed / (0.1 * typical)) if typical > 0 else np.zeros_like(speed)
    shares = {"offset": (mean**2 / mean_square, mean)}
    for name, regressor in (("speed", speed), ("direction", direction), ("position", position)):
        centred = regressor - regressor.mean()
        power = float(np.mean(centred**2))
        slope = float(np.mean(centred * error)) / power if power > 0 else 0.0
        shares[name] = (slope**2 * power / mean_square, slope)
    return shares


def _offset(size: float, scale: Scale) -> str:
    side = "above" if size > 0 else "below"
    amount = with_unit(scale.text(abs(size)), scale.unit)
    return f"the simulation sits {amount} {side} the recording on average: a sensor bias or a constant load"


def _speed(size: float, scale: Scale) -> str:
    side = "behind" if size < 0 else "ahead of"
    lag = with_unit(significant(abs(size) * 1000, 2), "ms")
    return f"grows with speed, as if the simulation were {lag} {side} the robot: delay or damping"


def _direction(size: float, scale: Scale) -> str:
    amount = with_unit(scale.text(abs(size)), scale.unit)
    return f"changes sign with the direction of motion (±{amount}): friction or backlash of another form"


def _position(size: float, scale: Scale) -> str:
    return f"grows with position ({significant(abs(size) * 100, 2)} % of it): gain, gravity load or sensor scale"


_PATTERNS = {"offset": _offset, "speed": _speed, "direction": _direction, "position": _position}
