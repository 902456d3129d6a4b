# SPDX-License-Identifier: Apache-2.0
"""Sensors that are late, noisy and off, whatever simulates them: what controllers see, and what is read off."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers
from trueup.articulated.kernels import late_columns
from trueup.articulated.pose import ORIENTATION, POSITION, angles_of, product, quaternion_of
from trueup.articulated.signals import Signals
from trueup.chance import Sensing, StartScatter, Streams
from trueup.trial import Trial

Turn = Callable[[Array, Array], Array]
"""An orientation (b, m) turned by small angles (b, 3) in rad about the body's own axes."""


@dataclass(frozen=True, eq=False)
class Place:
    """Where an engine holds a channel: columns of a field of its state."""

    field: str
    columns: Integers
    derived: bool = False
    """Whether the field describes the state before a step rather than the one after it."""
    turn: Turn | None = None
    """For orientations: how one is turned."""


Find = Callable[[str, tuple[str, ...]], Place | None]
"""What finds labels of a channel, all for (); None for one that is only read off. Raises UnknownNameError."""


@dataclass(frozen=True, eq=False)
class Sense:
    """How some columns of a field of the state are seen by b rows."""

    field: str
    columns: Integers
    noisy: Integers
    """Those that are noisy and off."""
    latency: Array
    """(b,) in steps."""
    noise: float = 0.0
    streams: Streams | None = None
    bias: Array | None = None
    """(b, k) what is added to the noisy columns, for the whole run."""
    derived: bool = False
    """Whether the field describes the state before a step rather than the one after it."""
    turn: Turn | None = None
    """For orientations: what noise does to them."""

    @classmethod
    def declared(cls, trial: Trial, s: Sensing, rows: int, step: float, place: Place, noisy: Integers) -> Sense:
        """One that a trial declares, of a channel. Raises TrialError where its chance is not settled."""
        streams = trial.settled().streams(f"{trial.name}/seen {s.channel}", rows) if s.noise > 0.0 else None
        bias = None
        if s.bias > 0.0:
            width = 3 if place.turn is not None else len(noisy)
            bias = s.bias * trial.settled().streams(f"{trial.name}/bias of {s.channel}", rows).normal(width)
        late = np.full(rows, s.latency / step)
        return cls(place.field, place.columns, noisy, late, s.noise, streams, bias, place.derived, place.turn)


class Senses:
    """What controllers of one trial see of its b rows."""

    def __init__(self, senses: Sequence[Sense]) -> None:
        self._all = list(senses)
        self._kept = int(np.ceil(max((s.latency.max(initial=0.0) for s in self._all), default=0.0))) + 2
        self._past: dict[str, Array] = {}
        self._wholly_late: set[str] = set()
        self._blocks: dict[int, tuple[Array, int]] = {}
        self._ago = {n: _ago(s) for n, s in enumerate(self._all) if s.latency.any()}
        self._by_field: dict[str, list[tuple[int, Sense]]] = {}
        for number, sense in enumerate(self._all):
            self._by_field.setdefault(sense.field, []).append((number, sense))
        self.late = tuple(dict.fromkeys(s.field for s in self._all if s.latency.any()))
        """Fields of which the past is needed."""

    def begin(self, state: Mapping[str, Array]) -> None:
        """Takes the start (b, size) of each of the `late` fields: before it, it was the same."""
        self._past = {f: np.repeat(now[:, None], self._kept, axis=1) for f, now in state.items()}
        late = [(s.field, column) for s in self._all if (s.latency >= 1.0).all() for column in s.columns]
        self._wholly_late = {f for f, now in state.items() if len({c for g, c in late if g == f}) == now.shape[1]}

    def note(self, history: Mapping[str, Array], rows: Integers) -> None:
        """Takes what `rows` went through: field to (len(rows), n, size)."""
        for field, past in self._past.items():
            past[rows] = np.concatenate([past[rows], history[field]], axis=1)[:, -self._kept :]

    def of(self, field: str, now: Callable[[], Array]) -> Array:
        """(b, size) a field as it is seen; `now` gives what it is, and is not asked where all of it is seen late."""
        mine = self._by_field.get(field)
        if not mine:
            return now()
        seen = np.array(self._past[field][:, -1] if field in self._wholly_late else now())
        for number, sense in mine:
            if number in self._ago:
                late_columns(self._past[field], *self._ago[number], sense.columns, seen)
        for number, sense in mine:
            if sense.streams is not None:
                width = 3 if sense.turn is not None else len(sense.noisy)
                _add(seen, sense, sense.noise * self._next(number, sense.streams, width))
        for _, sense in mine:
            if sense.bias is not None:
                _add(seen, sense, sense.bias)
        return seen

    def _next(self, number: int, streams: Streams, width: int) -> Array:
        """(b, width) standard normal numbers for the next look."""
        ahead = 64  # looks for which noise is drawn at once: generators are asked seldom, and little is kept
        block, used = self._blocks.get(number, (np.zeros(0), ahead))
        if used == ahead:
            block, used = streams.normal(ahead, width), 0
        self._blocks[number] = block, used + 1
        return block[:, used]


class Sensors(Mapping[str, Array]):
    """Sensor name to (b, dim), computed when the first is looked at: few controllers look, and it costs half a step."""

    def __init__(self, places: Mapping[str, slice], compute: Callable[[], Array]) -> None:
        self._places, self._compute = places, compute
        self._data: Array | None = None

    def __getitem__(self, name: str) -> Array:
        """Raises KeyError for a sensor that is not in the model."""
        place = self._places[name]
        return self.whole()[:, place]

    def whole(self) -> Array:
        """(b, all) every sensor's numbers, in the model's order."""
        if self._data is None:
            self._data = self._compute()
        return self._data

    def __iter__(self) -> Iterator[str]:
        """The names, in the model's order."""
        return iter(self._places)

    def __len__(self) -> int:
        """How many there are."""
        return len(self._places)


def senses_of(signals: Signals, k: int, step: float, find: Find) -> Senses:
    """What controllers of one trial see: as the trial declares it, and as calibrated errors and delays of sensors have it."""
    trial, rows, found = signals.trial(k), len(signals.delay), []
    for s in trial.sensing:
        if (whole := find(s.channel, ())) is not None:
            noisy = find(s.channel, s.labels) if s.labels else whole
            found.append(Sense.declared(trial, s, rows, step, whole, (noisy or whole).columns))
    for channel, late in _on_robot(signals.sensor_delays, trial):
        if (whole := find(channel, ())) is not None:
            found.append(Sense(whole.field, whole.columns, whole.columns, late / step, derived=whole.derived))
    errors = signals.sensor_errors
    if errors and (own := find("position", tuple(errors))) is not None:
        bias = np.stack(list(errors.values()), axis=1)
        found.append(Sense(own.field, own.columns, own.columns, np.zeros(rows), bias=bias))
    return Senses(found)


def scatter(trial: Trial, rows: int, find: Find, state: Callable[[str], Array]) -> None:
    """Moves the start states of one trial's rows by what is declared to scatter; `state` gives a field (rows, size)."""
    for i, d in enumerate(trial.disturbances):
        if isinstance(d, StartScatter) and (place := find(d.channel, d.labels)) is not None:
            now, streams = state(place.field), trial.settled().streams(f"{trial.name}/{i}", rows)
            if place.turn is not None:
                now[:, place.columns] = place.turn(now[:, place.columns], d.deviation * streams.normal(3))
            else:
                now[:, place.columns] += d.deviation * streams.normal(len(place.columns))


def _on_robot(delays: Mapping[str, Array], trial: Trial) -> list[tuple[str, Array]]:
    """Calibrated delays (b,) of the channels that a robot's own controller sees: a motion capture's clock is not its own."""
    known = {"position", "velocity", *trial.observed} - {POSITION, ORIENTATION}
    return [(channel, late) for channel, late in delays.items() if channel in known]


def read_noise(trial: Trial, channel: str, values: Array) -> Array:
    """(b, T, k) a channel as it is read off, with the noise that the trial declares for it; changed in place."""
    observed = trial.observed[channel]
    for sensing in trial.sensing:
        if sensing.channel == channel and sensing.noise > 0.0:
            streams = trial.settled().streams(f"{trial.name}/read {channel}", len(values))
            noisy = [i for i, label in enumerate(observed.labels) if label in (sensing.labels or observed.labels)]
            values[:, :, noisy] += sensing.noise * streams.normal(len(observed.time), len(noisy))
    return values


def turned(quaternion: Array, by: Array) -> Array:
    """(b, 4) quaternions w, x, y, z turned by small angles (b, 3), in rad, about the body's own axes."""
    out = product(quaternion, np.hstack([np.ones((len(by), 1)), 0.5 * by]))
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def turned_angles(angles: Array, by: Array) -> Array:
    """(b, 3) roll, pitch and yaw turned so."""
    return angles_of(turned(quaternion_of(angles), by))


def _ago(sense: Sense) -> tuple[Integers, Array]:
    """(b,) whole steps ago that are seen, and (b,) the rest of one; what is derived from the state was noted one late."""
    ago = np.maximum(sense.latency - float(sense.derived), 0.0)
    whole: Integers = np.floor(ago).astype(np.int64)
    return whole, ago % 1.0


def _add(seen: Array, sense: Sense, error: Array) -> None:
    if sense.turn is not None:
        seen[:, sense.columns] = sense.turn(seen[:, sense.columns], error)
    else:
        seen[:, sense.noisy] += error
