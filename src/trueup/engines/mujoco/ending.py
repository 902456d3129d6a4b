# SPDX-License-Identifier: Apache-2.0
"""Looks at the conditions that end runs, along what rows have just gone through."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array, Integers
from trueup.articulated.pose import angles_of
from trueup.controllers.controller import Observation
from trueup.ends import LOOK, Ended, which_end
from trueup.engines.mujoco.acts import sensor_places
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.wiring import Source, source_of
from trueup.errors import ModelError
from trueup.rounding import SAME_INSTANT
from trueup.trial import Trial


class Watch:
    """The conditions of all trials of a run, tied to a model. Raises ModelError for a channel that it has not."""

    def __init__(self, model: Model, compiled: mujoco.MjModel, trials: Sequence[Trial], step: float) -> None:
        self._trials, self._step = trials, step
        self._sources = [_sources(model, compiled, t) for t in trials]
        self._sensors = sensor_places(compiled)
        self.any = any(t.ends for t in trials)
        state = {"qpos", "qvel", *(["sensordata"] if compiled.nsensor else [])} if self.any else set()
        sources = (s for per in self._sources for each in per for s in each.values())
        self.fields = tuple(sorted(state | {s.field for s in sources}))
        """What must be recorded."""

    def ends(
        self, k: int, joined: Mapping[str, Array], at: int, good: Integers, settings: Array | None = None
    ) -> list[tuple[int, Ended]]:
        """Rows of one trial that end within a stretch, and how.

        Field to (n, m, ...): the state after `at` steps and after each of the steps that follow; row i is what it seems for
        `good[i]` of these. `settings` (n, p) are those of their controllers.
        """
        trial = self._trials[k]
        over: list[tuple[int, Ended]] = []
        count = next(iter(joined.values())).shape[1] - 1 if trial.ends else 0
        places = self._looks(at, count, trial.duration)
        if not len(places):
            return over
        channels = [
            {n: _along(s, joined[s.field], places) for n, s in each.items()} for each in self._sources[k]
        ]  # for each end and channel (n, looks, k)
        left = np.ones(len(good), dtype=bool)
        for look, i in enumerate(places.tolist()):
            rows = np.flatnonzero(left & (good >= i))
            now, own = (at + i) * self._step, None if settings is None else settings[rows]
            position, velocity, sensors = self._state(joined, rows, i)
            seen = [
                Observation(now, position, velocity, sensors, trial, {n: v[rows, look] for n, v in each.items()}, own)
                for each in channels
            ]
            which = which_end(trial.ends, seen, len(rows))
            for row in np.flatnonzero(which >= 0).tolist():
                over.append((int(rows[row]), Ended(trial.start + now, trial.ends[which[row]].name)))
                left[rows[row]] = False
        return over

    def _looks(self, at: int, count: int, duration: float) -> Integers:
        """After how many of the `count` steps that follow step `at` is looked, the state before them included."""
        every = LOOK / self._step
        looks = np.arange(int(at / every), int((at + count) / every) + 1)
        steps = np.ceil(looks * every - SAME_INSTANT).astype(np.int64)
        return steps[(steps >= at) & (steps < at + count) & (steps * self._step <= duration + SAME_INSTANT)] - at

    def _state(
        self, joined: Mapping[str, Array], rows: NDArray[np.intp], i: int
    ) -> tuple[Array, Array, dict[str, Array]]:
        """Positions, velocities and sensors of some rows, i steps into the stretch."""
        data = joined["sensordata"][rows, i + 1] if self._sensors else None
        sensors = {} if data is None else {n: data[:, place] for n, place in self._sensors.items()}
        return joined["qpos"][rows, i], joined["qvel"][rows, i], sensors


def _along(source: Source, history: Array, places: Integers) -> Array:
    """(n, looks, k) a channel at some places of a field's history (n, m, size)."""
    # Derived fields describe the state before each step: their history begins one step earlier.
    values = source.read(history[:, places + int(source.derived)])
    return angles_of(values) if source.turned else values


def _sources(model: Model, compiled: mujoco.MjModel, trial: Trial) -> list[dict[str, Source]]:
    """For each end of a trial the channels that it looks at."""
    sources = []
    for end in trial.ends:
        sources.append({})
        for channel, labels in end.looks_at.items():
            source = source_of(model, compiled, channel, labels)
            if source is None:
                raise ModelError(
                    f"end '{end.name}' of trial '{trial.name}' looks at '{channel}' ({', '.join(labels)}), which is no "
                    f"signal of '{model.name}'"
                )
            sources[-1][channel] = source
    return sources
