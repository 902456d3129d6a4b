# SPDX-License-Identifier: Apache-2.0
"""How far one signal lags behind another: clock offsets and delays, to a fraction of a sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.errors import RecordingError
from trueup.inspection.diagnosis import Diagnosis
from trueup.instant import usual_step
from trueup.recording import Channel, Recording
from trueup.rounding import NEGLIGIBLE
from trueup.tracking.heading import SPAN
from trueup.trial import command_of

LONGEST = 2.0
"""s by which a vehicle may follow its command, or lead."""
_MEASURED = {"speed": "speed", "turn": "yaw_rate"}
"""What a car is commanded, and the channel that shows it."""


def lag(reference: Channel, delayed: Channel, *, longest: float = 0.5, hold: bool = False) -> float:
    """Seconds by which `delayed` lags behind `reference` (negative: it leads), from the labels that both have.

    The speeds of both signals are cross-correlated (slow offsets and drifts then do not matter) up to `longest` s; the
    peak is refined by a parabola. `hold`: the reference is a command, held between its samples.
    Raises RecordingError where they share no label, no time, or do not move.
    """
    around, width, step = _correlation(reference, delayed, longest, hold=hold)
    return _peak(around, width, step)[0]


def _peak(around: Array, width: int, step: float) -> tuple[float, float]:
    """The lag in s at which correlations (2 width + 1,) are greatest, refined by a parabola, and how great they are there."""
    k = int(around.argmax())
    fraction = 0.0
    if 0 < k < len(around) - 1:
        left, mid, right = around[k - 1 : k + 2]
        fraction = 0.5 * (left - right) / (left - 2 * mid + right)
    return float((k - width + fraction) * step), float(around[k])


def _correlation(reference: Channel, delayed: Channel, longest: float, *, hold: bool) -> tuple[Array, int, float]:
    """(2 width + 1,) the correlation of speeds by lags of -width to width steps of so many s. Raises as `lag`."""
    labels = [label for label in reference.labels if label in delayed.labels]
    if not labels:
        raise RecordingError(f"channels '{reference.name}' and '{delayed.name}' share no label")
    start, stop = max(reference.time[0], delayed.time[0]), min(reference.time[-1], delayed.time[-1])
    step = min(usual_step(reference.time), usual_step(delayed.time))
    grid = np.arange(start, stop, step)
    if len(grid) < 2 * longest / step:
        raise RecordingError(f"channels '{reference.name}' and '{delayed.name}' overlap for {stop - start:.3g} s only")
    a = np.nan_to_num(np.gradient(reference.select(labels).at(grid, hold=hold), axis=0))
    b = np.nan_to_num(np.gradient(delayed.select(labels).at(grid), axis=0))
    if not a.any() or not b.any():
        raise RecordingError(f"channels '{reference.name}' and '{delayed.name}' do not move: no lag can be seen")
    # Faded at both ends, so that what enters and leaves the overlap does not pull the peak.
    fade = np.hanning(len(grid) + 2)[1:-1]
    a, b = (fade[:, None] * (x - x.mean(axis=0)) / (x.std(axis=0) + NEGLIGIBLE) for x in (a, b))
    width = int(longest / step)
    size = 1 << int(np.ceil(np.log2(len(grid) + width)))
    spectrum = np.fft.rfft(b, size, axis=0) * np.conj(np.fft.rfft(a, size, axis=0))
    overlap = np.fft.irfft(np.abs(np.fft.rfft(fade, size)) ** 2, size)
    correlation = np.fft.irfft(spectrum, size, axis=0).sum(axis=1) / np.maximum(overlap, 1e-3 * overlap[0])
    return np.concatenate([correlation[-width:], correlation[: width + 1]]), width, step


@dataclass(frozen=True)
class Clocks:
    """What is beyond doubt a clock of its own, and no lag of a robot."""

    close: float = 0.3
    """Share of the variance that may be left, for a shift to count as an explanation."""
    better: float = 0.5
    """... and that share, over the least that a lag that may be leaves."""
    enough: float = 2.5
    """s: in less than that a single move may look like another one."""
    lead: float = 0.01
    """s: no robot moves before it is told to."""
    apart: float = 0.25
    """s of lag beyond that of the other recordings."""
    alike: float = 0.1
    """How far the lags of joints are apart behind one clock: of its error, or `least_apart` s."""
    least_apart: float = 0.03
    usual: float = 0.05
    """s of lag where no other recording tells: servos take a few hundredths."""

    def errors(self, recordings: Sequence[Recording]) -> dict[str, float]:
        """How late the commands of a recording are stamped, in s (negative: early), for those where it is beyond doubt.

        That is where positions move before they are told to, or far later than in the other recordings, and a shift of the
        clock explains them far better than any lag that a robot may have.
        """
        lags = {r.name: v for r in recordings for v in (self._command_lag(r),) if v is not None}
        sound = sorted(v for v in lags.values() if v >= -self.lead)
        usual = sound[(len(sound) - 1) // 2] if sound else self.usual  # the lower median: late clocks are among them
        suspects = {name: v for name, v in lags.items() if v < -self.lead or v > usual + self.apart}
        by_name = {r.name: r for r in recordings}
        return {name: usual - v for name, v in suspects.items() if self._explains(by_name[name], v, usual)}

    def _command_lag(self, recording: Recording) -> float | None:
        command = command_of(recording)
        if command is None or not recording.has("position"):
            return None
        position = recording.channel("position")
        same = [
            x for x in command.labels if x not in position.labels or command.unit_of(x) in ("", position.unit_of(x))
        ]
        if not same:
            return None
        command = command.select(same)
        found = None
        overlap = min(recording.stop, command.time[-1]) - max(recording.start, command.time[0])
        if overlap < self.enough:
            return None
        for longest in (0.5, min(5.0, 0.4 * overlap)):
            try:
                found = lag(command, recording.channel("position"), longest=longest, hold=True)
            except RecordingError:
                break
            if _unexplained(recording, found) < self.close:
                break
        return found

    def _explains(self, recording: Recording, shift: float, usual: float) -> bool:
        """Whether commands shifted by `shift` explain the positions, and far better than with a lag that may be."""
        may_be = min(_unexplained(recording, v) for v in np.linspace(0.0, usual + self.apart, 12))
        left = _unexplained(recording, shift)
        return left < self.close and left < self.better * may_be and self._shared(recording, shift, abs(shift - usual))

    def _shared(self, recording: Recording, shift: float, error: float) -> bool:
        """Whether the joints lag alike, as they do behind a wrong clock; what friction holds back in slow motion lags each
        its own way.
        """
        command, position = command_of(recording), recording.channel("position")
        lags = []
        for label in position.labels:
            if command is not None and label in command.labels:
                try:
                    lags.append(
                        lag(command.select([label]), position.select([label]), longest=abs(shift) + 0.5, hold=True)
                    )
                except RecordingError:  # it does not move
                    continue
        apart = float(np.median(np.abs(np.array(lags) - np.median(lags)))) if lags else 0.0
        return apart < max(self.alike * error, self.least_apart)


def clock_errors(recordings: Sequence[Recording]) -> dict[str, float]:
    """See `Clocks.errors`."""
    return Clocks().errors(recordings)


def on_other_clocks(recordings: Sequence[Recording]) -> list[str]:
    """A sentence on each recording whose commands are stamped by a clock of their own; of cars, where that is too late."""
    later = "far later than in the other recordings" if len(recordings) > 1 else "far later than drives do"
    found = [
        f"'{name}': positions move {'before they are told to' if late > 0 else later}; the commands' clock seems "
        f"{1000 * abs(late):.0f} ms {'late' if late > 0 else 'early'} (the quantity `clock` sets it right), or command and "
        "position are swapped"
        for name, late in clock_errors(recordings).items()
    ]
    found += [
        f"'{r.name}': {_MEASURED[label]} goes the other way than {label} is commanded: they do not grow in the same sense. "
        "Say sign = -1 in the mapping for the one that grows to the right, or backwards"
        for r in recordings
        for label, followed in _followed(r).items()
        if followed.opposite
    ]
    ahead = {r.name: seconds for r in recordings if (seconds := _moves_ahead(r)) > 0.0}
    return found + [
        f"'{name}': it moves {1000 * seconds:.0f} ms before it is told to: the commands' clock is late by more than that, or "
        "what was measured stands for the command. No delay is below 0: log both with one clock, or take from the commands' "
        "times what they are late"
        for name, seconds in ahead.items()
    ]


def _moves_ahead(recording: Recording) -> float:
    """By how many seconds a car's speed or turn rate leads its command, where that is more than half a sample; else 0."""
    lags = [followed.lag for followed in _followed(recording).values() if followed.sign > 0.0]
    return max(0.0, -max(lags, default=0.0))


@dataclass(frozen=True)
class _Followed:
    """How a car's speed, or turn rate, follows its command."""

    sign: float
    """Below zero where the correlation is stronger so."""
    lag: float
    """In s, half a sample more than it seems: less is not told from none."""
    left: float
    """Share of the variance that the command so late leaves."""

    @property
    def opposite(self) -> bool:
        """Whether it does the opposite of what it is told, after it is told to, beyond doubt."""
        return self.sign < 0.0 and self.lag >= 0.0 and self.left < Clocks.close

    @classmethod
    def of(cls, told: Channel, moved: Channel) -> _Followed:
        """Of single labels, the same. Raises RecordingError as `lag`."""
        half = 0.5 * max(usual_step(told.time), usual_step(moved.time))
        told, moved = (averaged(c.time, c.values[:, 0]) for c in (told, moved))
        around, width, step = _correlation(told, moved, LONGEST, hold=False)
        (behind, alike), (late, unlike) = (_peak(sign * around, width, step) for sign in (1.0, -1.0))
        sign, shift = (1.0, behind) if alike >= unlike else (-1.0, late)
        asked, seen = told.at(moved.time - shift)[:, 0], moved.values[:, 0]
        good = np.isfinite(asked)
        asked, seen = asked[good] - asked[good].mean(), seen[good] - seen[good].mean()
        size = max(float(np.sqrt(np.sum(asked**2) * np.sum(seen**2))), NEGLIGIBLE)
        return cls(sign, shift + half, 1.0 - max(sign * float(asked @ seen) / size, 0.0) ** 2)


def _followed(recording: Recording) -> dict[str, _Followed]:
    """By the label of the command, for a car whose speed or turn rate was measured too."""
    command, found = command_of(recording), {}
    if command is None:
        return {}
    for label, name in _MEASURED.items():
        if label not in command.labels or not recording.has(name):
            continue
        try:
            found[label] = _Followed.of(command.select([label]), recording.channel(name))
        except RecordingError:
            continue
    return found


def averaged(time: Array, values: Array) -> Channel:
    """A signal (T,) without its gaps, averaged over `SPAN` around each sample, twice: what is noisy from sample to sample
    has a lag then.
    """
    good = np.isfinite(values)
    time, values = time[good], values[good]
    count = max(1, min(round(SPAN / usual_step(time)), len(values) // 4)) if len(time) > 1 else 1
    for _ in range(2):
        wide = np.pad(values, (count // 2, count - 1 - count // 2), mode="edge")
        values = np.convolve(wide, np.full(count, 1.0 / count), mode="valid")
    return Channel("motion", ("v",), "", time, values)


def _unexplained(recording: Recording, shift: float) -> float:
    """Share of the positions' variance that a straight line through the shifted commands leaves, pooled over joints."""
    command, position = command_of(recording), recording.channel("position")
    if command is None:
        return 1.0
    labels = [label for label in position.labels if label in command.labels]
    told = command.select(labels).at(position.time - shift, hold=True)
    moved = position.select(labels).values
    good = np.isfinite(told).all(axis=1) & np.isfinite(moved).all(axis=1)
    if not labels or good.sum() < 10:
        return 1.0
    told, moved = told[good] - told[good].mean(axis=0), moved[good] - moved[good].mean(axis=0)
    slope = (told * moved).sum(axis=0) / np.maximum((told**2).sum(axis=0), NEGLIGIBLE)
    scale = np.maximum((moved**2).sum(axis=0), NEGLIGIBLE)
    return float(np.mean(((moved - slope * told) ** 2).sum(axis=0) / scale))


def stamped_late(late: Mapping[str, float]) -> Diagnosis | None:
    """Recordings whose commands are stamped by a clock of their own."""
    if not late:
        return None
    shown = ", ".join(f"'{name}' {1e3 * seconds:+.0f} ms" for name, seconds in late.items())
    return Diagnosis(
        "clock",
        f"commands are stamped late by more than any lag explains ({shown})",
        "a clock of each is calibrated",
        late,
    )
