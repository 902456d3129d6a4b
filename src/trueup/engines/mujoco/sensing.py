# SPDX-License-Identifier: Apache-2.0
"""Sensors that are late and noisy, and starts that scatter: channels tied to the state of a model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.articulated.pose import ANGLES, AXES, ORIENTATION, POSITION
from trueup.chance import Sensing, StartScatter, Streams
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.wiring import Source, source_of
from trueup.errors import unknown_name
from trueup.trial import Trial

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

_AHEAD = 64  # looks for which noise is drawn at once: generators are asked seldom, and little is kept


@dataclass(frozen=True, eq=False)
class _Sense:
    """One declared sensor, where it is read from the state."""

    source: Source
    noisy: Rows
    """Columns of the field that are noisy."""
    noise: float
    latency: float
    """In steps."""
    streams: Streams | None
    bias: Array | None
    """(b, k) of the noisy columns, for the whole run."""


class Senses:
    """What controllers of one trial see of its b rows."""

    def __init__(self, model: Model, compiled: mujoco.MjModel, trial: Trial, rows: int, step: float) -> None:
        self._all = [_sense(model, compiled, trial, s, rows, step) for s in trial.sensing]
        latest = max((s.latency for s in self._all), default=0.0)
        self._kept = int(np.ceil(latest)) + 2
        self._past: dict[str, Array] = {}
        self._blocks: dict[int, tuple[Array, int]] = {}
        self.late = tuple({s.source.field for s in self._all if s.latency > 0.0})
        """Fields of which the past is needed."""

    def begin(self, state: Mapping[str, Array]) -> None:
        """Takes the start (b, size) of each of the `late` fields: before it, it was the same."""
        self._past = {f: np.repeat(now[:, None], self._kept, axis=1) for f, now in state.items()}

    def note(self, history: Mapping[str, Array], rows: Rows) -> None:
        """Takes what `rows` went through: field to (len(rows), n, size)."""
        for field, past in self._past.items():
            past[rows] = np.concatenate([past[rows], history[field]], axis=1)[:, -self._kept :]

    def of(self, field: str, now: Callable[[], Array]) -> Array:
        """(b, size) a field as it is seen; `now` gives what it is, and is not asked where all of it is seen late."""
        mine = [s for s in self._all if s.source.field == field]
        if not mine:
            return now()
        late = [s.source.columns for s in mine if s.latency >= 1.0]
        wholly = field in self._past and len(np.unique(np.concatenate([*late, [-1]]))) > self._past[field].shape[2]
        seen = np.array(self._past[field][:, -1] if wholly else now())
        for sense in mine:
            if sense.latency > 0.0:
                seen[:, sense.source.columns] = self._before(field, sense)[:, sense.source.columns]
        for number, sense in enumerate(self._all):
            if sense.source.field == field and sense.streams is not None:
                noise = sense.noise * self._next(number, sense.streams, 3 if sense.source.turned else len(sense.noisy))
                if sense.source.turned:
                    seen[:, sense.source.columns] = turned(seen[:, sense.source.columns], noise)
                else:
                    seen[:, sense.noisy] += noise
        for sense in mine:
            if sense.bias is not None and sense.source.turned:
                seen[:, sense.source.columns] = turned(seen[:, sense.source.columns], sense.bias)
            elif sense.bias is not None:
                seen[:, sense.noisy] += sense.bias
        return seen

    def _before(self, field: str, sense: _Sense) -> Array:
        """(b, size) a field as it was; what is derived from the state was noted one step late."""
        ago = max(sense.latency - float(sense.source.derived), 0.0)
        whole, past = int(ago), self._past[field]
        later, earlier = past[:, -1 - whole], past[:, max(-2 - whole, -past.shape[1])]
        return later + (ago - whole) * (earlier - later)

    def _next(self, number: int, streams: Streams, width: int) -> Array:
        """(b, width) standard normal numbers for the next look."""
        block, used = self._blocks.get(number, (np.zeros(0), _AHEAD))
        if used == _AHEAD:
            block, used = streams.normal(_AHEAD, width), 0
        self._blocks[number] = block, used + 1
        return block[:, used]


def turned(quaternion: Array, by: Array) -> Array:
    """(b, 4) quaternions w, x, y, z turned by small angles (b, 3), in rad, about the body's own axes."""
    w, v = quaternion[:, :1], quaternion[:, 1:]
    half = 0.5 * by
    out = np.hstack([w - np.sum(v * half, axis=1, keepdims=True), v + w * half + np.cross(v, half)])
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def scatter(model: Model, compiled: mujoco.MjModel, trial: Trial, qpos: Array, qvel: Array) -> None:
    """Moves the start states (b, nq), (b, nv) of one trial by what is declared to scatter."""
    for i, d in enumerate(trial.disturbances):
        if isinstance(d, StartScatter):
            source = _source(model, compiled, trial, d.channel, d.labels)
            state = qvel if source.field == "qvel" else qpos
            streams = trial.settled().streams(f"{trial.name}/{i}", len(qpos))
            if source.turned:
                state[:, source.columns] = turned(state[:, source.columns], d.deviation * streams.normal(3))
            else:
                state[:, source.columns] += d.deviation * streams.normal(len(source.columns))


def _sense(model: Model, compiled: mujoco.MjModel, trial: Trial, s: Sensing, rows: int, step: float) -> _Sense:
    source = _source(model, compiled, trial, s.channel, ())
    noisy = _source(model, compiled, trial, s.channel, s.labels).columns if s.labels else source.columns
    streams = trial.settled().streams(f"{trial.name}/seen {s.channel}", rows) if s.noise > 0.0 else None
    bias = None
    if s.bias > 0.0:
        width = 3 if source.turned else len(noisy)
        bias = s.bias * trial.settled().streams(f"{trial.name}/bias of {s.channel}", rows).normal(width)
    return _Sense(source, noisy, s.noise, s.latency / step, streams, bias)


def _source(model: Model, compiled: mujoco.MjModel, trial: Trial, channel: str, labels: tuple[str, ...]) -> Source:
    """Where a channel of the state is, or a sensor of the model by its own name. Raises UnknownNameError."""
    number = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_SENSOR, channel)
    if number >= 0:
        first, size = int(compiled.sensor_adr[number]), int(compiled.sensor_dim[number])
        return Source("sensordata", np.arange(first, first + size, dtype=np.int64), None, derived=True)
    whole = {POSITION: AXES, ORIENTATION: ANGLES, "position": model.scalar_joints(), "velocity": model.scalar_joints()}
    observed = trial.observed[channel].labels if channel in trial.observed else ()
    source = source_of(model, compiled, channel, labels or tuple(whole.get(channel, observed)))
    if source is None or not len(source.columns):
        raise unknown_name("channel", channel, [*whole, *trial.observed], f"what can be sensed in trial '{trial.name}'")
    return source
