# SPDX-License-Identifier: Apache-2.0
"""The scores a report speaks of: errors before and after, pooled by channel, by recording and by joint."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Calibration, Replay
from trueup.report.numbers import Scale, with_unit
from trueup.samples import SLIGHT


@dataclass(frozen=True)
class Score:
    """Root mean square replay error before and after, and what measurement noise alone would leave; one unit."""

    before: float
    after: float
    noise: float
    """NaN where the noise is unknown."""

    @property
    def compared(self) -> bool:
        """Whether there is anything to compare with: no model of guessed gains is shown as 'before'."""
        return math.isfinite(self.before)

    @property
    def worse(self) -> bool:
        """Whether the error rose by more than two percent, or the calibrated model could not be replayed at all."""
        return self.after > self.before * (1 + SLIGHT) or (math.isnan(self.after) and math.isfinite(self.before))

    @property
    def better(self) -> bool:
        """Whether the error fell by more than two percent."""
        return self.after < self.before * (1 - SLIGHT)


@dataclass(frozen=True)
class Comparison:
    """All replays of one channel in one unit: errors may be pooled within it, never across."""

    channel: str
    unit: str
    replays: tuple[Replay, ...]

    @property
    def title(self) -> str:
        """What a heading calls it: hinges and slides are apart in one channel, so the unit belongs to it."""
        return f"Channel '{self.channel}' ({self.unit})" if self.unit else f"Channel '{self.channel}'"

    @property
    def held_out(self) -> tuple[Replay, ...]:
        """Replays of recordings that the fit never saw."""
        return tuple(r for r in self.replays if r.held_out)

    @property
    def training(self) -> tuple[Replay, ...]:
        """Replays of the recordings that were fitted."""
        return tuple(r for r in self.replays if not r.held_out)

    @property
    def labels(self) -> tuple[str, ...]:
        """Every label that occurs, in the order of first appearance."""
        return tuple(dict.fromkeys(label for r in self.replays for label in r.labels))

    @property
    def ordered(self) -> tuple[Replay, ...]:
        """The held-out replays first, each group in the order given."""
        return self.held_out + self.training


def comparisons(calibration: Calibration) -> tuple[Comparison, ...]:
    """The replays by channel and unit, 'position' first, else in the order of first appearance."""
    groups: dict[tuple[str, str], list[Replay]] = {}
    for replay in calibration.replays:
        groups.setdefault((replay.channel, replay.unit), []).append(replay)
    found = [Comparison(channel, unit, tuple(replays)) for (channel, unit), replays in groups.items()]
    return tuple(sorted(found, key=lambda c: c.channel != "position"))


def pooled_score(replays: Sequence[Replay]) -> Score:
    """The score over all samples and columns of `replays`, which share a unit."""
    before = [(r.before - r.measured).ravel() for r in replays]
    after = [(r.after - r.measured).ravel() for r in replays]
    noise = [np.broadcast_to(noise_of(r), r.measured.shape)[np.isfinite(r.measured)] for r in replays]
    return Score(known_rms(before), known_rms(after), known_rms(noise, every=True))


def amounts(score: Score, scale: Scale) -> str:
    """'before → after unit', or the error alone where there is nothing to compare with."""
    after = with_unit(scale.text(score.after), scale.unit)
    return f"{scale.text(score.before)} → {after}" if score.compared else after


def column_score(replay: Replay, column: int) -> Score:
    """The score of one column."""
    measured = replay.measured[:, column]
    before, after = replay.before[:, column] - measured, replay.after[:, column] - measured
    return Score(known_rms([before]), known_rms([after]), float(noise_of(replay)[column]))


def noise_of(replay: Replay) -> Array:
    """(k,) measurement noise in the replay's unit, NaN where it is unknown."""
    if replay.noise.shape == (len(replay.labels),):
        return np.where(replay.noise > 0, replay.noise, np.nan)
    return np.full(len(replay.labels), np.nan)


def label_score(replays: Sequence[Replay], label: str) -> Score:
    """The score of one label pooled over the replays that have it."""
    parts = [r.columns([r.labels.index(label)]) for r in replays if label in r.labels]
    return pooled_score(parts)


def worsened(replays: Sequence[Replay]) -> list[tuple[Replay, str, Score]]:
    """(replay, label, score) of every column whose error rose, the largest rise first."""
    found = [(r, label, column_score(r, j)) for r in replays for j, label in enumerate(r.labels)]
    return sorted((entry for entry in found if entry[2].worse), key=lambda e: -_rise(e[2]))


def broken_off(replay: Replay, *, after: bool) -> float | None:
    """The time in s from which a simulated replay has no values though the recording has; None if it is complete."""
    simulated = replay.after if after else replay.before
    missing = (np.isfinite(replay.measured) & ~np.isfinite(simulated)).any(axis=1)
    return float(replay.time[int(np.argmax(missing))]) if missing.any() else None


def signal_size(replay: Replay) -> float:
    """Root mean square of what was measured about each column's mean, pooled; NaN without samples."""
    columns = [c[np.isfinite(c)] for c in replay.measured.T]
    return known_rms([c - c.mean() for c in columns if c.size])


def _rise(score: Score) -> float:
    return math.inf if math.isnan(score.after) else score.after - score.before


def known_rms(errors: Sequence[Array], *, every: bool = False) -> float:
    """Root mean square of the finite values; NaN if there are none, or with `every` if one is missing."""
    values = np.concatenate([np.zeros(0), *errors])
    finite = values[np.isfinite(values)]
    if finite.size == 0 or (every and finite.size < values.size):
        return math.nan
    peak = float(np.abs(finite).max())  # a diverged simulation must not overflow
    return peak * math.sqrt(float(np.mean((finite / peak) ** 2))) if peak > 0 else 0.0
