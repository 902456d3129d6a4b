# SPDX-License-Identifier: Apache-2.0
"""What one run left behind: named channels with units on one clock, and where they came from. Immutable."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array
from trueup.errors import RecordingError, unknown_name
from trueup.rounding import PRINTED, SAME_INSTANT
from trueup.samples import between, in_force, unwound


@dataclass(frozen=True, eq=False)
class Channel:
    """One kind of signal of several joints. Raises RecordingError where time, values and labels do not fit together."""

    name: str
    """Its role: 'command' (requested), 'command_sent', 'position', 'velocity', 'torque', 'current', or any other."""
    labels: tuple[str, ...]
    """One per column, usually joint names."""
    unit: str
    """In SI ('rad', 'rad/s', 'N m', 'A', 'm'); '' if unknown."""
    time: Array
    """(T,) in s, strictly increasing, on the recording's clock."""
    values: Array
    """(T, k) in `unit`, read-only; NaN is a missing sample. A 'heading' in rad is kept without jumps of a turn."""
    units: tuple[str, ...] = ()
    """One per label where they differ (hinges in rad, slides in m): `unit` is then that of the most; () where they do not."""

    def __post_init__(self) -> None:
        """Copies the arrays, makes them read-only and checks them."""
        object.__setattr__(self, "labels", tuple(self.labels))
        time = _frozen(self.time, f"time of channel '{self.name}'")
        values = _frozen(self.values, f"values of channel '{self.name}'")
        if values.ndim == 1 and len(self.labels) == 1:
            values = values[:, None]
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "values", values)
        self._check_shapes()
        self._check_time()
        if self.name == "heading" and self.unit == "rad":
            object.__setattr__(self, "values", _frozen(unwound(values), "headings"))

    def column(self, label: str) -> Array:
        """(T,) the samples of one label. Raises UnknownNameError, which lists the labels."""
        return self.values[:, self._index(label)]

    def select(self, labels: Sequence[str]) -> Channel:
        """The same channel with these columns only, in this order. Raises UnknownNameError for one that is missing."""
        columns = [self._index(label) for label in labels]
        units = tuple(self.units[i] for i in columns) if self.units else ()
        return self.replace(labels=tuple(labels), values=self.values[:, columns], units=units)

    def unit_of(self, label: str) -> str:
        """The unit of one label. Raises UnknownNameError, which lists the labels."""
        return self.units[self._index(label)] if self.units else self.unit

    def replace(self, **changes: Any) -> Channel:
        """A copy with some fields changed; checked like a new one."""
        return dataclasses.replace(self, **changes)

    def at(self, times: ArrayLike, *, hold: bool = False) -> Array:
        """(n, k) the values at `times` (n,) in s.

        Linear interpolation, NaN outside the channel's time and beside a missing sample; with `hold` the last value
        stays in force (as a command does), beyond missing samples too, the first one also before the first sample.
        """
        instants = np.atleast_1d(np.asarray(times, dtype=np.float64))
        if hold:
            last = np.searchsorted(self.time, instants + SAME_INSTANT, side="right") - 1
            return in_force(self.values)[np.clip(last, 0, None)]
        outside = (instants < self.time[0] - SAME_INSTANT) | (instants > self.time[-1] + SAME_INSTANT)
        result = between(instants, self.time, self.values)
        result[outside] = np.nan
        return result

    def _index(self, label: str) -> int:
        if label not in self.labels:
            raise unknown_name("label", label, self.labels, f"channel '{self.name}'")
        return self.labels.index(label)

    def _check_shapes(self) -> None:
        where = f"channel '{self.name}'"
        repeated = sorted({label for label in self.labels if self.labels.count(label) > 1})
        if repeated:
            raise RecordingError(f"{where}: label '{repeated[0]}' is used {self.labels.count(repeated[0])} times")
        if self.time.ndim != 1 or self.values.ndim != 2 or len(self.time) != len(self.values):
            raise RecordingError(
                f"{where}: time has shape {self.time.shape} and values have shape {self.values.shape}; "
                "they must be (T,) and (T, k)"
            )
        if len(self.labels) != self.values.shape[1]:
            raise RecordingError(f"{where}: {len(self.labels)} labels for {self.values.shape[1]} columns")
        if self.units and len(self.units) != len(self.labels):
            raise RecordingError(f"{where}: {len(self.units)} units for {len(self.labels)} labels")
        if self.values.size == 0:
            raise RecordingError(f"{where} has no samples")

    def _check_time(self) -> None:
        bad = np.flatnonzero(~np.isfinite(self.time))
        if bad.size:
            raise RecordingError(f"channel '{self.name}': time of sample {bad[0]} is {self.time[bad[0]]}")
        late = np.flatnonzero(np.diff(self.time) <= 0.0)
        if late.size:
            i = int(late[0])
            raise RecordingError(
                f"channel '{self.name}': time does not increase at sample {i + 1}: "
                f"{self.time[i]:.9g} s is followed by {self.time[i + 1]:.9g} s ({late.size} such places)"
            )


PART_OF = "part of"
"""Key of the provenance of a stretch: the name of the recording that it was cut from."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Channels of one run on one clock. Raises RecordingError if there is none, or one is filed under another name."""

    name: str
    channels: Mapping[str, Channel]
    """Read-only, in the given order."""
    provenance: Mapping[str, str] = field(default_factory=dict)
    """Source files, reader, mapping, checksums, warnings: whatever tells where the numbers came from."""

    def __post_init__(self) -> None:
        """Freezes the mappings and checks the names."""
        if not self.channels:
            raise RecordingError(f"recording '{self.name}' has no channels")
        for name, channel in self.channels.items():
            if name != channel.name:
                raise RecordingError(f"recording '{self.name}': channel '{channel.name}' is filed under '{name}'")
        object.__setattr__(self, "channels", MappingProxyType(dict(self.channels)))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    def __reduce__(self) -> tuple[Any, ...]:
        """Read-only mappings do not pickle; plain dicts do."""
        return Recording, (self.name, dict(self.channels), dict(self.provenance))

    def channel(self, name: str) -> Channel:
        """The channel of this name. Raises UnknownNameError, which lists the channels."""
        if name not in self.channels:
            raise unknown_name("channel", name, self.channels, f"recording '{self.name}'")
        return self.channels[name]

    def has(self, name: str) -> bool:
        """Whether there is a channel of this name."""
        return name in self.channels

    @property
    def time(self) -> Array:
        """(T,) in s: the time of 'position' if there is such a channel, else of the first one."""
        return (self.channels.get("position") or next(iter(self.channels.values()))).time

    @property
    def start(self) -> float:
        """Time of the first sample of any channel, in s."""
        return min(float(c.time[0]) for c in self.channels.values())

    @property
    def stop(self) -> float:
        """Time of the last sample of any channel, in s."""
        return max(float(c.time[-1]) for c in self.channels.values())

    @property
    def duration(self) -> float:
        """From the first sample to the last, in s."""
        return self.stop - self.start

    def slice(self, start: float, stop: float) -> Recording:
        """The samples with start <= time <= stop, in s on the recording's clock.

        A command stays in force until the next one: where the slice begins between two commands, the earlier one is
        kept, moved to the slice's first instant. A channel without samples in the slice is left out and named in
        provenance['warnings']. Raises RecordingError if the slice is empty.
        """
        inside = self.time[(self.time >= start - SAME_INSTANT) & (self.time <= stop + SAME_INSTANT)]
        if not inside.size:
            raise RecordingError(
                f"recording '{self.name}' has no samples from {start:g} to {stop:g} s; "
                f"it lasts from {self.start:g} to {self.stop:g} s"
            )
        parts = {name: _cut(c, start, stop, float(inside[0])) for name, c in self.channels.items()}
        kept = {name: c for name, c in parts.items() if c is not None}
        lost = [f"channel '{name}' has no samples from {start:g} to {stop:g} s" for name in parts if name not in kept]
        return Recording(self.name, kept, with_warnings(self.provenance, lost))

    def resample(self, rate_or_times: float | ArrayLike) -> Recording:
        """All channels at common instants: a rate in Hz over the span of `time`, or times (n,) in s.

        Commands are held, everything else is interpolated linearly. Nothing is filtered before a reduction of the
        rate: content above half the new rate folds down, so filter first where that matters.
        """
        if np.ndim(rate_or_times) == 0:
            rate = float(np.asarray(rate_or_times))
            if not (np.isfinite(rate) and rate > 0.0):
                raise RecordingError(
                    f"cannot resample recording '{self.name}' at {rate:g} Hz; the rate must be positive"
                )
            span = float(self.time[-1] - self.time[0])
            times = self.time[0] + np.arange(int(np.floor(span * rate + PRINTED)) + 1) / rate
        else:
            times = np.asarray(rate_or_times, dtype=np.float64)
        return self._map(lambda c: c.replace(time=times, values=c.at(times, hold=is_command(c.name))))

    def align(self, offsets: Mapping[str, float]) -> Recording:
        """Clock offsets corrected: seconds added to the time of each channel named. Raises UnknownNameError."""
        for name in offsets:
            self.channel(name)
        return self._map(lambda c: c.replace(time=c.time + offsets[c.name]) if c.name in offsets else c)

    def replace(self, **changes: Any) -> Recording:
        """A copy with some fields changed; checked like a new one."""
        return dataclasses.replace(self, **changes)

    def with_channel(self, channel: Channel) -> Recording:
        """With this channel added, or put in place of the one of the same name."""
        return self.replace(channels={**self.channels, channel.name: channel})

    def without(self, name: str) -> Recording:
        """Without this channel. Raises UnknownNameError if it is not there."""
        self.channel(name)
        return self.replace(channels={key: c for key, c in self.channels.items() if key != name})

    def rename(self, labels: Mapping[str, str]) -> Recording:
        """With labels renamed (old -> new) in every channel that has them. Raises UnknownNameError if none has."""
        known = {label for c in self.channels.values() for label in c.labels}
        for old in labels:
            if old not in known:
                raise unknown_name("label", old, known, f"recording '{self.name}'")
        return self._map(lambda c: c.replace(labels=tuple(labels.get(label, label) for label in c.labels)))

    def content(self, *, units: bool = True) -> Iterator[bytes]:
        """What was measured, piece by piece, for check sums: names, labels, units, instants, values."""
        for name, channel in self.channels.items():
            yield repr((name, channel.labels, channel.unit) if units else (name, channel.labels)).encode()
            yield np.ascontiguousarray(channel.time).tobytes()
            yield np.ascontiguousarray(channel.values).tobytes()

    def _map(self, change: Any) -> Recording:
        return self.replace(channels={name: change(c) for name, c in self.channels.items()})


def is_command(name: str) -> bool:
    """Whether a channel of this name holds commands, which stay in force until the next one."""
    return name == "command" or name.startswith("command_")


def part_of(whole: Recording) -> dict[str, str]:
    """The provenance of a stretch cut from a recording, or from a stretch of one."""
    return {**whole.provenance, PART_OF: whole.provenance.get(PART_OF, whole.name)}


def with_warnings(provenance: Mapping[str, str], warnings: Iterable[str]) -> dict[str, str]:
    """`provenance` with lines added to its 'warnings'."""
    lines = [*provenance.get("warnings", "").splitlines(), *warnings]
    return {**provenance, "warnings": "\n".join(lines)} if lines else dict(provenance)


def warnings_of(recording: Recording) -> list[str]:
    """What was to be minded when it was read, such as rows that were left out, each with its name."""
    return [f"'{recording.name}': {line}" for line in recording.provenance.get("warnings", "").splitlines() if line]


def _cut(channel: Channel, start: float, stop: float, first: float) -> Channel | None:
    keep = (channel.time >= start - SAME_INSTANT) & (channel.time <= stop + SAME_INSTANT)
    time, values = channel.time[keep], channel.values[keep]
    if is_command(channel.name) and channel.time[0] < start - SAME_INSTANT:
        before = in_force(channel.values[channel.time < start - SAME_INSTANT])[-1:]
        if not time.size or time[0] > first + SAME_INSTANT:
            time, values = np.concatenate([[first], time]), np.concatenate([before, values])
        else:
            values[:1] = np.where(np.isfinite(values[:1]), values[:1], before)
    return channel.replace(time=time, values=values) if time.size else None


def _frozen(values: ArrayLike, what: str) -> Array:
    if isinstance(values, np.ndarray) and values.dtype == np.float64 and values.base is None:
        frozen = not values.flags.writeable
        if frozen:  # already copied here: copies of a channel share it
            return values
    try:
        array = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise RecordingError(f"{what} are not numbers: {error}") from None
    array.flags.writeable = False
    return array
