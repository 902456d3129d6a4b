# SPDX-License-Identifier: Apache-2.0
"""What chance does to the runs of one trial, whatever simulates them: forces on bodies, noise on commands."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

import numpy as np

from trueup.arrays import Array, Integers
from trueup.articulated.model import Model
from trueup.chance import Buffeting, CommandNoise, Push, Pushed
from trueup.errors import unknown_name
from trueup.rounding import SAME_INSTANT, whole_steps
from trueup.trial import Trial

NEVER = sys.maxsize
"""The step at which nothing happens."""


class Forces:
    """Pushes and buffeting of one trial's b rows, on bodies by their names. Raises UnknownNameError for none of `bodies`."""

    def __init__(self, trial: Trial, rows: int, step: float, bodies: Sequence[str]) -> None:
        drawn = [
            (d, trial.settled().streams(f"{trial.name}/{i}", rows))
            for i, d in enumerate(trial.disturbances)
            if isinstance(d, (Push, Buffeting))
        ]
        for d, _ in drawn:
            if d.body not in bodies:
                raise unknown_name("body", d.body, [b for b in bodies if b], "the model (a push)")
        self._rows, self._step = rows, step
        self._pushes = [Pushed.of(d, streams) for d, streams in drawn if isinstance(d, Push)]
        self._buffets = [(d, d.forces(trial.duration, s)) for d, s in drawn if isinstance(d, Buffeting)]
        edges = [np.ceil(t / step - SAME_INSTANT) for p in self._pushes for t in (p.start, p.stop)]
        edges += [np.ceil(np.arange(f.shape[1]) * d.every / step - SAME_INSTANT) for d, f in self._buffets]
        self.edges: Integers = (
            np.unique(np.concatenate(edges)).astype(np.int64) if edges else np.zeros(0, dtype=np.int64)
        )
        """Steps before which a force changes."""

    def at(self, step: int) -> Mapping[str, Array]:
        """Each body that is ever pushed to the force (b, 3) on its centre of mass from a step on, in N, in the world."""
        now = step * self._step
        found = {name: np.zeros((self._rows, 3)) for name in self.bodies}
        for d, forces in self._buffets:
            found[d.body][:, :2] += forces[:, min(whole_steps(now, d.every), forces.shape[1] - 1)]
        for push in self._pushes:
            on = (push.start <= now + SAME_INSTANT) & (now + SAME_INSTANT < push.stop)
            found[push.body] += on[:, None] * push.force
        return found

    @property
    def bodies(self) -> tuple[str, ...]:
        """Those that are ever pushed."""
        return tuple(dict.fromkeys([*(d.body for d, _ in self._buffets), *(p.body for p in self._pushes)]))


class CommandNoises:
    """Noise on the commands of one trial's b rows. Raises UnknownNameError for labels that the model has not."""

    def __init__(self, model: Model, trial: Trial, rows: int) -> None:
        self._all: list[
            tuple[float, Integers | slice, Array]
        ] = []  # each with its ticks' length, columns and values (b, ticks, k)
        for i, noise in enumerate(trial.disturbances):
            if isinstance(noise, CommandNoise):
                columns = np.array([_column(model, x) for x in noise.labels] or range(model.width), dtype=np.int64)
                ticks = int(np.ceil(trial.duration / noise.every)) + 1
                drawn = trial.settled().streams(f"{trial.name}/{i}", rows).normal(ticks, len(columns))
                every = np.array_equal(columns, np.arange(model.width))
                self._all.append((noise.every, slice(None) if every else columns, noise.deviation * drawn))

    def add(self, at: int, step: float, commands: Array) -> Array:
        """Commands (b, n, width) from step `at` on as they arrive; they are changed in place."""
        times = at * step + step * np.arange(commands.shape[1])
        for every, columns, values in self._all:
            ticks = np.minimum((times / every + SAME_INSTANT).astype(np.int64), values.shape[1] - 1)
            commands[:, :, columns] += values[:, ticks]
        return commands


def _column(model: Model, label: str) -> int:
    by_joint, columns = {j: a for j, a in model.drives().items() if a}, model.columns()
    if label not in by_joint and label not in columns:
        raise unknown_name("actuator", label, {*columns, *by_joint}, "the model (noise on commands)")
    return columns[by_joint.get(label, label)]
