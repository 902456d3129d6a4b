# SPDX-License-Identifier: Apache-2.0
"""What chance does to one trial's copies of any engine: where they start, what pushes them, what controllers see."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from trueup.arrays import Array, Integers
from trueup.articulated.disturbances import CommandNoises, Forces
from trueup.articulated.model import BasePose, Engine, Pushable, Running
from trueup.articulated.pose import ORIENTATION, POSITION
from trueup.articulated.sensing import Place, Senses, scatter, senses_of, turned_angles
from trueup.articulated.signals import Signals
from trueup.articulated.starts import measured_base
from trueup.chance import StartScatter
from trueup.controllers.controller import Observation
from trueup.errors import ModelError, unknown_name

Read = Callable[[str, Sequence[str]], Callable[[int], Array]]
"""What reads a channel's labels of the first n copies."""

JOINTS = ("position", "velocity")


class Chances:
    """Of the one trial of `signals`. Raises ModelError for pushes where the engine cannot push its copies."""

    def __init__(self, model: Engine, copies: Running, signals: Signals, step: float, *, seeing: bool) -> None:
        self._model, self._copies, self._step = model, copies, step
        self._trial, self._rows = signals.trial(0), len(signals.delay)
        self._forces = Forces(self._trial, self._rows, step, model.names("body"))
        if self._forces.bodies and not isinstance(copies, Pushable):
            raise ModelError(
                f"simulator '{model.name}' does not support disturbances that push bodies; trial '{self._trial.name}' pushes "
                f"{', '.join(self._forces.bodies)}"
            )
        self._edges = set(self._forces.edges.tolist())
        self._noises = CommandNoises(model, self._trial, self._rows)
        self._labels = {**{n: tuple(model.drives()) for n in JOINTS}, **model.channels()}
        self._senses = senses_of(signals, 0, step, self._place) if seeing else Senses(())

    def place(self, position: Array, velocity: Array) -> None:
        """Puts the copies where the trial begins, joints (b, k), and off by what is declared to scatter."""
        base = measured_base(self._trial)
        self._copies.place(position, velocity, base)
        if any(isinstance(d, StartScatter) for d in self._trial.disturbances):
            state = {"position": np.array(position), "velocity": np.array(velocity)}
            for name in (POSITION, ORIENTATION):
                state |= {name: self._read(name)} if name in self._labels else {}
            scatter(
                self._trial, self._rows, lambda name, labels: self._find_place(name, labels, state), state.__getitem__
            )
            if POSITION in state:
                still = np.zeros(3)
                velocity, rates = (base.velocity, base.rates) if base is not None else (still, still)
                base = BasePose(state[POSITION], velocity, state[ORIENTATION], rates)
            self._copies.place(state["position"], state["velocity"], base)
        self._senses.begin({field: self._read(field) for field in self._senses.late})

    def push(self, step: int) -> None:
        """Sets the forces on bodies where one changes before a step."""
        if step in self._edges and isinstance(self._copies, Pushable):
            for body, force in self._forces.at(step).items():
                self._copies.push(body, force)

    def noisy(self, at: int, commands: Array) -> Array:
        """Commands (b, n, width) from step `at` on as they arrive."""
        return self._noises.add(at, self._step, commands)

    def note(self) -> None:
        """Takes what one step has changed, where controllers see the past."""
        if self._senses.late:
            self._senses.note({f: self._read(f)[:, None] for f in self._senses.late}, np.arange(self._rows))

    def observation(self, now: float, wanted: Mapping[str, tuple[str, ...]], read: Read) -> Observation:
        """What a controller sees `now`; `wanted` are channels that it looks at, each with its labels."""
        whole = {n: self._senses.of(n, lambda n=n: self._read(n)) for n in self._labels}
        named = {
            n: whole[n][:, [self._labels[n].index(x) for x in labels]]
            if n in whole and set(labels) <= set(self._labels[n])
            else read(n, labels)(self._rows)
            for n, labels in wanted.items()
        }
        sensors = {n: v for n, v in whole.items() if n not in JOINTS}
        return Observation(now, whole["position"], whole["velocity"], sensors, self._trial, named)

    def _read(self, channel: str) -> Array:
        return self._copies.reader(channel, self._labels[channel])(self._rows)

    def _place(self, channel: str, labels: tuple[str, ...]) -> Place | None:
        """Where it is sensed; None where it is only read off."""
        if channel not in self._labels and channel in self._trial.observed:
            return None
        return self._find_place(channel, labels, self._labels)

    def _find_place(self, channel: str, labels: tuple[str, ...], known: Mapping[str, object]) -> Place:
        columns = self._columns(channel, labels, known)
        if channel == ORIENTATION:  # it turns as a whole
            return Place(channel, self._columns(channel, (), known), turn=turned_angles)
        return Place(channel, columns)

    def _columns(self, channel: str, labels: Sequence[str], known: Mapping[str, object]) -> Integers:
        """Of a channel's labels, all for (). Raises UnknownNameError."""
        where = f"what can be sensed in trial '{self._trial.name}'"
        if channel not in known:
            raise unknown_name("channel", channel, known, where)
        own = self._labels[channel]
        for label in labels:
            if label not in own:
                raise unknown_name("label", label, own, f"channel '{channel}' of '{self._model.name}'")
        return np.array([own.index(x) for x in labels or own], dtype=np.int64)
