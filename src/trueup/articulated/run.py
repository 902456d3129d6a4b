# SPDX-License-Identifier: Apache-2.0
"""One trial of any engine for b candidates: placed, disturbed, commanded and stepped to its end, then read off."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from trueup.arrays import Array, Mask
from trueup.articulated.assignments import Assignment, laws, write
from trueup.articulated.chance import Chances
from trueup.articulated.closed_loop import ClosedLoop
from trueup.articulated.gains import Gains
from trueup.articulated.model import Engine, Running, Stopping, step_of
from trueup.articulated.pose import ANGLES, ORIENTATION, near
from trueup.articulated.sensing import read_noise
from trueup.articulated.signals import Signals
from trueup.articulated.wiring import actuators_named, no_signal
from trueup.controllers.controller import ControllerFactory, Observation
from trueup.ends import LOOK, Ended, which_end
from trueup.engines.simulator import Rollout
from trueup.errors import unknown_name
from trueup.rounding import first_step, whole_steps
from trueup.samples import wrapped
from trueup.trial import Trial

STATES = {"position": "position", "velocity": "velocity", "torque": "force"}
"""Channels whose labels are joints, and the state that they show."""


class Run:
    """One trial for b candidates."""

    def __init__(
        self, engine: Engine, quantities: Sequence[Assignment], gains: Gains, step: float, trial: Trial, values: Array,
        controllers: ControllerFactory | None,
    ) -> None:  # fmt: skip
        """`values` (b, n) of what `quantities` assign, then of the controller's parameters."""
        own = len(quantities)
        self._model, self._trial, self._step = engine, trial, step
        self._rows = len(values)
        self._copies: Running = self._model.copies(self._rows)
        self._signals = Signals(engine, quantities, [trial], values[:, :own], step_of(self._copies, step))
        write(quantities, values[:, :own], self._copies)
        gains.scale(self._model, self._copies, [trial.name], self._rows)
        seeing = controllers is not None
        self._chance = Chances(engine, self._copies, self._signals, self._step, seeing=seeing)
        self._chance.place(*self._signals.starts()[0])
        self._laws = laws(quantities, values[:, :own], self._model, self._copies)
        self._count = whole_steps(trial.duration, self._step) + 2
        self._loop: ClosedLoop | None = None
        if controllers is not None:
            self._loop = ClosedLoop(controllers(values[:, own:]), self._signals, 0, self._step)
        count = int(trial.duration / LOOK) + 1 if trial.ends else 0
        self._looks = {first_step(k * LOOK, self._step) for k in range(count)}
        self._ends: dict[int, Ended] = {}
        self._settings = values[:, own:] if values.shape[1] > own else None

    def rollout(self) -> Rollout:
        """Steps to the end of the trial and reads its channels off."""
        recorded = None
        if self._loop is None:
            recorded = self._chance.noisy(0, self._signals.commands(0, 0, self._count, self._step))
        shown = {n: self._reader(n, o.labels) for n, o in self._trial.observed.items() if n != "command"}
        histories = {n: [read(self._rows)] for n, read in shown.items()}
        sound, given, over = [self._sound()], [], False
        for s in range(self._count):
            if over:  # one step later: what acts during a step is known after it
                break
            over = self._look(s) == self._rows
            command = np.array(recorded[:, s]) if recorded is not None else self._commands(s)
            given.append(np.array(command))
            for law in self._laws:
                law.act(command)
            self._chance.push(s)
            self._copies.step(command, self._step)
            self._chance.note()
            sound.append(self._sound())
            for name, read in shown.items():
                histories[name].append(read(self._rows))
        if "torque" in histories:  # it acts during a step, states are at its ends
            histories["torque"] = [*histories["torque"][1:], histories["torque"][-1]]
        if (command := self._trial.observed.get("command")) is not None:
            columns = [self._model.columns()[name] for name in actuators_named(self._model, command.labels)]
            histories["command"] = [g[:, columns] for g in (*given, given[-1])]
        return self._measured(histories, ~np.logical_and.accumulate(np.stack(sound, axis=1), axis=1))

    def _sound(self) -> Mask:
        """(b,) whether a simulation has not blown up."""
        return np.asarray(np.isfinite(self._copies.position + self._copies.velocity).all(axis=1))

    def _reader(self, channel: str, labels: Sequence[str]) -> Callable[[int], Array]:
        """What reads a channel of the first n copies. Raises ModelError for one that is no signal of the model, or has
        no such label.
        """
        known = list(self._model.drives()) if channel in STATES else self._model.channels().get(channel)
        if known is None:
            raise no_signal(self._trial.name, channel, self._model.name, [*STATES, *self._model.channels()])
        for label in (label for label in labels if label not in known):
            raise unknown_name(
                "joint" if channel in STATES else "label", label, known, f"'{channel}' of '{self._model.name}'"
            )
        return self._copies.reader(STATES.get(channel, channel), labels)

    def _commands(self, s: int) -> Array:
        """(b, width) what the controller commands in step s, as it arrives."""
        if self._loop is None:
            raise RuntimeError("no controller in this run")
        if self._loop.due <= s:
            self._loop.ask(self._chance.observation(s * self._step, self._loop.looks_at, self._reader))
        return self._chance.noisy(s, self._loop.commands(s, 1))[:, 0]

    def _look(self, s: int) -> int:
        """How many runs have ended by step s, looked at every `ends.LOOK` s."""
        if s not in self._looks:
            return len(self._ends)
        c, now = self._copies, s * self._step
        sensors = {n: c.reader(n, labels)(self._rows) for n, labels in self._model.channels().items()}
        seen = [
            Observation(now, c.position, c.velocity, sensors, self._trial, self._shown(e.looks_at), self._settings)
            for e in self._trial.ends
        ]
        reached = which_end(self._trial.ends, seen, self._rows)
        if isinstance(c, Stopping):
            c.stop(np.flatnonzero(reached >= 0))
        for row in np.flatnonzero(reached >= 0):
            self._ends.setdefault(int(row), Ended(self._trial.start + now, self._trial.ends[reached[row]].name))
        return len(self._ends)

    def _shown(self, wanted: Mapping[str, tuple[str, ...]]) -> dict[str, Array]:
        """Channel to (b, k) of what is so now."""
        return {n: self._reader(n, labels)(self._rows) for n, labels in wanted.items()}

    def _measured(self, histories: Mapping[str, Sequence[Array]], lost: Mask) -> Rollout:
        """Channels as they are measured; (b, m) `lost` says from when on a simulation has none."""
        channels = {}
        for name, observed in self._trial.observed.items():
            history = np.ascontiguousarray(np.stack(histories[name], axis=1))
            history[lost[:, : history.shape[1]]] = np.nan
            turned = name == ORIENTATION and observed.labels == ANGLES
            if turned:  # so that they can be interpolated
                history = np.ascontiguousarray(np.unwrap(history, axis=1))
            channels[name] = np.full((len(history), len(observed.time), history.shape[2]), np.nan)
            span = (0, history.shape[1] - 1, True)
            self._signals.read(0, name, history, np.arange(len(history)), span, self._step, channels[name])
            if turned:
                channels[name] = self._nearest(channels[name])
            read_noise(self._trial, name, channels[name])
        failures = {
            int(row): f"the simulation became unstable after {self._step * int(np.argmax(lost[row])):.3g} s"
            for row in np.flatnonzero(lost.any(axis=1))
        }
        ended = {r: e for r, e in self._ends.items() if r not in failures}
        rollout = Rollout(self._trial, channels, failures, ended, self._settings)
        for name, values in channels.items():
            values[~rollout.lasted(name)] = np.nan
        return rollout

    def _nearest(self, angles: Array) -> Array:
        """(b, T, 3) angles of the base in the turn in which they were measured, else in the first."""
        measured = self._trial.initial.get(ORIENTATION)
        first = wrapped(angles)
        return first if measured is None else near(first, measured.at(self._trial.observed[ORIENTATION].time))
