# SPDX-License-Identifier: Apache-2.0
"""What a recording is worth: rate, gaps, what does not move or is cut off, encoder grid, noise, suspicious units."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.articulated.pose import is_quaternion
from trueup.inspection.stamps import Gap, clock_of, restless
from trueup.inspection.suspicions import suspicions
from trueup.instant import usual_step
from trueup.noise import estimate_grid, estimate_noise, is_noise
from trueup.recording import Channel, Recording, is_command
from trueup.rounding import PRINTED
from trueup.samples import MOST, stretches_of

_MEASURED = ("position", "velocity", "torque", "current")
STUCK_SECONDS, _STUCK_SAMPLES, _STUCK_SHARE = 0.15, 10, 0.02
"""How long what has come to its stop rests there in one go, in s and in samples (turning points of a motion pass sooner), and
for which share of a recording in all."""


@dataclass(frozen=True, eq=False)
class ChannelInspection:
    """What was found in one channel. Arrays are (k,), in the order of `labels`."""

    name: str
    labels: tuple[str, ...]
    unit: str
    units: tuple[str, ...]
    """One for each label where they differ; () where they do not."""
    samples: int
    rate: float
    """Median rate in Hz; NaN for a single sample."""
    jitter: float
    """Standard deviation of the steps in time without the gaps, in s."""
    restless: bool
    """Whether stamps scatter that are not those at which samples were taken."""
    gaps: tuple[Gap, ...]
    repeats: int
    """Rows equal to the row before. Many mean that the sensor is slower than the log."""
    held: int
    """How many rows each value stands for, where that is regular; 1 where every row is a new sample."""
    missing: Integers
    """NaN samples."""
    lowest: Array
    highest: Array
    motionless: tuple[str, ...]
    """Labels that show nothing but noise."""
    saturated: tuple[str, ...]
    """Labels that rest at their extreme for long."""
    grid: tuple[float | None, ...]
    """Step of the encoder grid in `unit`; None where values are continuous."""
    noise: Array
    """Standard deviation of the noise in `unit`, quantisation included."""

    @property
    def dropped(self) -> int:
        """How many of the gaps are a single sample that is missing."""
        return sum(gap.is_single(self.rate) for gap in self.gaps)


@dataclass(frozen=True, eq=False)
class Inspection:
    """What was found in a recording."""

    name: str
    start: float
    duration: float
    """In s."""
    channels: tuple[ChannelInspection, ...]
    suspicions: tuple[str, ...]
    """Units and signs that cannot be right, in words."""
    warnings: tuple[str, ...]
    """What the reader left out or repaired."""
    guesses: tuple[str, ...]
    """What the reader was not sure of, where it guessed the mapping."""

    def channel(self, name: str) -> ChannelInspection:
        """The findings of one channel. Raises KeyError."""
        return next(c for c in self.channels if c.name == name)

    def findings(self) -> tuple[str, ...]:
        """Sentences with units, and what to do; empty if all is well."""
        said: dict[str, list[str]] = {}
        for channel in self.channels:
            for sentence in _sentences(channel):
                said.setdefault(sentence, []).append(channel.name)
        found = [f"{', '.join(names)}: {sentence}" for sentence, names in said.items()]
        return (*self.warnings, *self.suspicions, *found)


def inspect(recording: Recording) -> Inspection:
    """Looks at every channel of a recording."""
    return Inspection(
        name=recording.name,
        start=recording.start,
        duration=recording.duration,
        channels=tuple(_inspect(channel, recording) for channel in recording.channels.values()),
        suspicions=tuple(suspicions(recording)),
        warnings=tuple(recording.provenance.get("warnings", "").splitlines()),
        guesses=tuple(recording.provenance.get("guesses", "").splitlines()),
    )


def motionless(channel: Channel) -> tuple[str, ...]:
    """Labels of a channel that show nothing but noise."""
    grid = [estimate_grid(column) for column in channel.values.T]
    noise = estimate_noise(channel.values, channel.time, grid)
    each = zip(channel.labels, channel.values.T, noise.tolist(), grid, strict=True)
    return tuple(label for label, column, sigma, step in each if is_noise(column, sigma, step))


def _inspect(channel: Channel, recording: Recording) -> ChannelInspection:
    rate, jitter, gaps = clock_of(channel.time)
    grid = tuple(estimate_grid(column) for column in channel.values.T)
    repeats, held = _repeats(channel)
    new = _changed(channel) if held > 1 else np.ones(len(channel.time), dtype=bool)
    noise = estimate_noise(channel.values[new], channel.time[new], grid)
    motionless = tuple(
        label
        for label, column, sigma, step in zip(channel.labels, channel.values.T, noise, grid, strict=True)
        if is_noise(column, float(sigma), step)
    )
    moving = [label for label in channel.labels if label not in motionless]
    return ChannelInspection(
        name=channel.name,
        labels=channel.labels,
        unit=channel.unit,
        units=channel.units,
        samples=len(channel.time),
        rate=rate,
        jitter=jitter,
        restless=not is_command(channel.name) and restless(channel.time[new], channel.values[new], gaps),
        gaps=gaps,
        repeats=repeats,
        held=held,
        missing=np.count_nonzero(np.isnan(channel.values), axis=0).astype(np.int64),
        lowest=_extreme(channel.values, np.fmin),
        highest=_extreme(channel.values, np.fmax),
        motionless=motionless,
        saturated=tuple(label for label in moving if _is_saturated(channel, label, recording)),
        grid=grid,
        noise=noise,
    )


def _extreme(values: Array, which: np.ufunc) -> Array:
    """(k,) lowest or highest value, NaN where all are missing."""
    return np.asarray(which.reduce(values, axis=0), dtype=np.float64)


def _repeats(channel: Channel) -> tuple[int, int]:
    """Rows equal to the one before, and how many rows each value stands for where that is regular; some may be missing."""
    new = _changed(channel)
    repeats = int(np.sum(~new))
    if is_command(channel.name) or not repeats:
        return repeats, 1
    runs = np.round(np.diff(channel.time[new])[1:] / usual_step(channel.time))
    usual = int(np.median(runs)) if runs.size >= 20 else 1
    regular = usual > 1 and float(np.mean(np.abs(runs - usual) <= 1)) > 0.9 and float(np.mean(runs == 1)) < 0.05
    return repeats, usual if regular else 1


def _changed(channel: Channel) -> Mask:
    """(T,) the rows that are not as the one before."""
    values = channel.values
    same = np.all((values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1])), axis=1)
    return np.concatenate([[True], ~same])


def _is_saturated(channel: Channel, label: str, recording: Recording) -> bool:
    """Whether a column rests at its largest size for long; a position only where its command goes further."""
    if is_quaternion(channel.labels):
        return False  # of a unit quaternion that is upright w is 1 and can be no more
    few_levels = 10  # a signal with fewer distinct values is a switch: resting at its highest is no saturation
    column = channel.column(label)
    finite = column[np.isfinite(column)]
    if finite.size == 0 or len(np.unique(finite)) < few_levels:
        return False
    size = float(np.abs(finite).max())
    close = PRINTED * size
    for extreme in (float(finite.max()), float(finite.min())):
        # Drives clip alike on both sides; a joint has its own stop on each.
        if extreme == 0.0 or (channel.name != "position" and abs(extreme) < 0.95 * size):
            continue
        there = np.abs(column - extreme) <= close
        if _rests(there, channel.time) and _is_pushed(channel, label, extreme, there, recording):
            return True
    return False


def _rests(there: Mask, time: Array) -> bool:
    """Whether samples stay at an extreme long enough, in one go and in all."""
    if float(np.mean(there)) < _STUCK_SHARE:
        return False
    starts, stops = stretches_of(there).T - [[0], [1]]
    longest = int(np.argmax(stops - starts))
    seconds = float(time[stops[longest]] - time[starts[longest]])
    return bool(stops[longest] - starts[longest] >= _STUCK_SAMPLES and seconds >= STUCK_SECONDS)


def _is_pushed(channel: Channel, label: str, extreme: float, there: Mask, recording: Recording) -> bool:
    """Positions rest wherever they are told to; only a command that moves on beyond shows that something stops them."""
    if is_command(channel.name):
        return False
    if channel.name != "position":
        return True
    command = recording.channels.get("command")
    if command is None or label not in command.labels or command.unit != channel.unit:
        return False
    wanted = command.select([label]).at(channel.time, hold=True)[:, 0]
    span = float(np.fmax.reduce(wanted) - np.fmin.reduce(wanted))
    resting = wanted[there]
    beyond = (resting - extreme) * np.sign(extreme) > 0.02 * span
    moves_on = float(np.fmax.reduce(resting) - np.fmin.reduce(resting)) > 0.2 * span
    return bool(moves_on and np.mean(beyond) > 0.6)


def _sentences(channel: ChannelInspection) -> Iterator[str]:
    """What to say about one channel, without its name."""
    if channel.gaps:
        yield _of_gaps(channel)
    scatter = channel.jitter * channel.rate if np.isfinite(channel.rate) else 0.0
    if is_command(channel.name) and scatter > MOST:  # of commands that come by chance it is about 1
        if not channel.gaps:
            yield "commands come at no rate: right where only changes were logged, as each stays in force until the next"
    elif channel.restless:
        yield (
            f"samples come at {channel.rate:.4g} Hz with {channel.jitter * 1e3:.2g} ms jitter, and what was measured is "
            "smoother at even instants; log the time at which each was taken, not the time at which it was written"
        )
    if channel.held > 1:
        yield (
            f"each value stands for {channel.held} rows, so the sensor runs at about "
            f"{channel.rate / channel.held:.3g} Hz, not {channel.rate:.4g} Hz. Keep one row in {channel.held}"
        )
    if channel.missing.any():
        worst = int(np.argmax(channel.missing))
        yield (
            f"{int(channel.missing.sum())} values are missing, most of them ({int(channel.missing[worst])}) of "
            f"{channel.labels[worst]}; {'the one before is in force' if is_command(channel.name) else 'they are skipped'}"
        )
    if channel.motionless and (is_command(channel.name) or channel.name in _MEASURED):
        verb = "never changes" if is_command(channel.name) else "shows nothing but noise"
        every = len(channel.motionless) == len(channel.labels) > 1
        who = "every column" if every else ", ".join(channel.motionless)
        yield f"{who} {verb}; this recording tells little about it. Move it, or freeze its parameters"
    if channel.saturated:
        yield (
            f"{', '.join(channel.saturated)} rests at its extreme value for long; what it would do beyond is cut off. "
            "Move less far or fast, or calibrate the limit"
        )


def _of_gaps(channel: ChannelInspection) -> str:
    """What to say of the gaps of a channel that has some."""
    longest, real = max(channel.gaps, key=lambda gap: gap.duration), len(channel.gaps) - channel.dropped
    lost = (
        "a single sample that is missing" if channel.dropped == 1
        else f"{channel.dropped} single samples that are missing"
    )  # fmt: skip
    if not real:
        return f"{lost.replace(' that', '')}: no harm done"
    count = "a gap" if real == 1 else f"{real} gaps; the longest"
    beside = f", beside {lost}" if channel.dropped else ""
    lasts = f"{count} lasts {longest.duration:.3g} s after {longest.start:.3f} s{beside}. "
    if is_command(channel.name):
        return lasts + "A command stays in force until the next: right where only changes were logged"
    return lasts + (
        "Nothing is compared there. Check the logger; a replay begins anew after half a second or more without commands too"
    )
