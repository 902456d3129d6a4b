# SPDX-License-Identifier: Apache-2.0
"""What happens to the rows of a run on the way, and what their controllers see of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import mujoco
import numpy as np
from mujoco.batch import Batch

from trueup.arrays import Array, Integers
from trueup.articulated.disturbances import NEVER, CommandNoises, Forces
from trueup.articulated.pose import angles_of
from trueup.articulated.sensing import Senses, Sensors, senses_of
from trueup.articulated.signals import Signals
from trueup.controllers.controller import Observation
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.sensing import finder
from trueup.engines.mujoco.wiring import Source, source_of
from trueup.errors import ModelError
from trueup.trial import Trial


class Acts:
    """Pushes, noise on commands, and observations of trials x candidates (rows, trial-major)."""

    def __init__(
        self,
        batch: Batch,
        model: Model,
        compiled: mujoco.MjModel,
        trials: Sequence[Trial],
        signals: Signals,
        step: float,
        seeing: Sequence[bool],
    ) -> None:
        """`seeing`: which of the trials have a controller."""
        self._batch, self._compiled, self._trials = batch, compiled, trials
        self._model, self._sources = model, dict[tuple[str, tuple[str, ...]], Source]()
        self._candidates, self._step = len(signals.delay), step
        bodies = [compiled.body(i).name for i in range(compiled.nbody)]
        self._forces = [Forces(t, self._candidates, step, bodies) for t in trials]
        self._bodies = {name: bodies.index(name) for forces in self._forces for name in forces.bodies}
        self._edges = np.unique(np.concatenate([f.edges for f in self._forces]))
        self._noises = [CommandNoises(model, t, self._candidates) for t in trials]
        self._senses = [
            senses_of(signals, k, step, finder(model, compiled, trials[k])) if s else Senses(())
            for k, s in enumerate(seeing)
        ]
        self._names = sensor_places(compiled)

    @property
    def watched(self) -> tuple[str, ...]:
        """Fields of which controllers see the past."""
        return tuple(sorted({field for senses in self._senses for field in senses.late}))

    def begin(self) -> None:
        """Takes the start states, once they are written."""
        for k, senses in enumerate(self._senses):
            senses.begin({field: self._batch.bind(field)[self._of(k)] for field in senses.late})

    def next_after(self, at: int) -> int:
        """The first step after `at` before which a force changes."""
        later = int(np.searchsorted(self._edges, at, side="right"))
        return int(self._edges[later]) if later < len(self._edges) else NEVER

    def push(self, at: int) -> None:
        """Sets the forces on bodies where one changes before step `at`."""
        if not len(self._edges) or at not in self._edges:
            return
        applied = self._batch.bind("xfrc_applied")
        for k, forces in enumerate(self._forces):
            for name, force in forces.at(at).items():
                applied[self._of(k), self._bodies[name], :3] = force

    def force(self, k: int, joints: Sequence[str], torque: Array) -> None:
        """Pushes joints of one trial's rows with (b, k) N m until the next call, past all drives."""
        dofs = [self._compiled.jnt_dofadr[self._compiled.joint(j).id] for j in joints]
        self._batch.bind("qfrc_applied")[self._of(k), dofs] = torque

    def disturbed(self, k: int, at: int, commands: Array) -> Array:
        """Commands (b, n, nu) of one trial from step `at` on as they arrive."""
        return self._noises[k].add(at, self._step, commands)

    def observation(
        self, k: int, now: float, rows: Integers, channels: Mapping[str, tuple[str, ...]] = MappingProxyType({})
    ) -> Observation:
        """What the controllers of one trial see, of which `rows` still run; the others as they ended.

        `channels` that they want, each with its labels. Raises ModelError for one that the model has not.
        """
        own, senses = self._of(k), self._senses[k]
        position, velocity = (senses.of(f, lambda f=f: self._batch.bind(f)[own]) for f in ("qpos", "qvel"))

        def sensors() -> Array:
            # Sensors must describe the present state, not the one before the last step.
            self._batch.forward(rows, stage=int(mujoco.mjtStage.mjSTAGE_VEL))
            return self._batch.bind("sensordata")[own]

        shown = Sensors(self._names, lambda: senses.of("sensordata", sensors))
        state = {"qpos": lambda: position, "qvel": lambda: velocity, "sensordata": shown.whole}
        named = {}
        for name, labels in channels.items():
            source = self._source(k, name, labels)
            read = source.read(state.get(source.field, lambda f=source.field: self._batch.bind(f)[own])()[:, None])[
                :, 0
            ]
            named[name] = angles_of(read) if source.turned else read
        return Observation(now, position, velocity, shown, self._trials[k], named)

    def _source(self, k: int, channel: str, labels: tuple[str, ...]) -> Source:
        if (channel, labels) not in self._sources:
            source = source_of(self._model, self._compiled, channel, labels)
            if source is None:
                raise ModelError(
                    f"the controller of trial '{self._trials[k].name}' looks at '{channel}' ({', '.join(labels)}), which is "
                    f"no signal of '{self._model.name}'"
                )
            self._sources[channel, labels] = source
        return self._sources[channel, labels]

    def note(self, history: Mapping[str, Array], rows: Integers) -> None:
        """Takes what `rows` went through, where controllers see the past."""
        for k, senses in enumerate(self._senses):
            if senses.late:
                first, last = np.searchsorted(rows, (k * self._candidates, (k + 1) * self._candidates))
                mine = {field: history[field][first:last] for field in senses.late}
                senses.note(mine, rows[first:last] - k * self._candidates)

    def _of(self, k: int) -> slice:
        return slice(k * self._candidates, (k + 1) * self._candidates)


def sensor_places(compiled: mujoco.MjModel) -> dict[str, slice]:
    """Sensor name, or its number where it has none, to its columns."""
    names = [compiled.sensor(i).name or str(i) for i in range(compiled.nsensor)]
    return {n: slice(a, a + d) for n, a, d in zip(names, compiled.sensor_adr, compiled.sensor_dim, strict=True)}
