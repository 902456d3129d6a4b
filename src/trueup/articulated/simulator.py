# SPDX-License-Identifier: Apache-2.0
"""A simulator of any engine that offers a model and steps it: parameters written, signals shaped, channels read off."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trueup.articulated.assignments import Assignment, laws, write
from trueup.articulated.closed_loop import ClosedLoop
from trueup.articulated.kernels import read_off
from trueup.articulated.model import Engine, Running, Stopping
from trueup.articulated.signals import Signals
from trueup.articulated.starts import measured_base
from trueup.articulated.wiring import commanded, joints_commanded
from trueup.controllers.controller import ControllerFactory, Observation
from trueup.ends import LOOK, Ended, which_end
from trueup.engines.simulator import Rollout, refuse_unsupported
from trueup.errors import ModelError, unknown_name
from trueup.parameters import ParameterSpace
from trueup.recording import Recording, is_command
from trueup.rounding import first_step, whole_steps
from trueup.trial import Trial, command_of

Array = NDArray[np.float64]

_STATES = {"position": "position", "velocity": "velocity", "torque": "force"}
"""Channels whose labels are joints, and the state that they show."""


@dataclass(frozen=True, eq=False)
class ArticulatedSimulator:
    """A `Simulator` of an engine's model; `quantities[i]` says what parameter i sets (see `declarations.declare`)."""

    engine: Engine
    parameters: ParameterSpace = field(default_factory=lambda: ParameterSpace(()))
    quantities: tuple[Assignment, ...] = ()
    step: float = 0.002

    @property
    def name(self) -> str:
        """The model's name."""
        return self.engine.name

    def at_step(self, step: float) -> ArticulatedSimulator:
        """The same with another step, in s."""
        return dataclasses.replace(self, step=step)

    def shipped(self) -> ArticulatedSimulator:
        """The same model as it came, without parameters."""
        return dataclasses.replace(self, parameters=ParameterSpace(()), quantities=())

    def observable(self, recording: Recording) -> tuple[str, ...]:
        """Positions, speeds and torques of joints, and the model's own channels.

        Raises UnknownNameError for commands and joints that are not there.
        """
        command = command_of(recording)
        if command is not None:
            commanded(self.engine, command)
        seen = [c for name, c in recording.channels.items() if not is_command(name) and name in _STATES]
        for channel in seen:
            for label in channel.labels:
                if label not in self.engine.drives():
                    where = f"model '{self.name}' (channel '{channel.name}' of recording '{recording.name}')"
                    raise unknown_name("joint", label, self.engine.drives(), where)
        channels = self.engine.channels().items()
        own = [n for n, labels in channels if recording.has(n) and set(recording.channel(n).labels) <= set(labels)]
        return (*(c.name for c in seen), *own)

    @property
    def commanded(self) -> tuple[str, ...]:
        """(width,) the joint that each column of a controller's command drives."""
        return joints_commanded(self.engine)

    def held(self, trial: Trial) -> Array:
        """(width,) what is told to drives that nobody commands in a trial."""
        return Signals(self.engine, (), [trial], np.zeros((1, 0))).hold(0)

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        """See Simulator. Where there are controllers, values (b, n) hold their parameters after the model's.

        Raises ModelError for trials with disturbances or sensing.
        """
        refuse_unsupported(self.name, trials, "disturbances", "sensing")
        values = np.atleast_2d(np.asarray(values, dtype=np.float64))
        with np.errstate(all="ignore"):  # what blows up is reported
            return [_Run(self, trial, values, trial.controller or controllers).rollout() for trial in trials]


class _Run:
    """One trial for b candidates."""

    def __init__(
        self, simulator: ArticulatedSimulator, trial: Trial, values: Array, controllers: ControllerFactory | None
    ) -> None:
        own = len(simulator.quantities)
        self._model, self._trial, self._step = simulator.engine, trial, simulator.step
        self._signals = Signals(self._model, simulator.quantities, [trial], values[:, :own])
        self._copies: Running = self._model.copies(len(values))
        write(simulator.quantities, values[:, :own], self._copies)
        self._copies.place(*self._signals.starts()[0], measured_base(trial))
        self._laws = laws(simulator.quantities, values[:, :own], self._model, self._copies)
        self._count = whole_steps(trial.duration, self._step) + 2
        self._loop: ClosedLoop | None = None
        if controllers is not None:
            self._loop = ClosedLoop(controllers(values[:, own:]), self._signals.delay, self._step)
        count = int(trial.duration / LOOK) + 1 if trial.ends else 0
        self._looks = {first_step(k * LOOK, self._step) for k in range(count)}
        self._ends: dict[int, Ended] = {}
        self._settings = values[:, own:] if values.shape[1] > own else None

    def rollout(self) -> Rollout:
        """Steps to the end of the trial and reads its channels off."""
        recorded = self._signals.commands(0, 0, self._count, self._step) if self._loop is None else None
        rows = len(self._signals.delay)
        shown = {n: self._reader(n, o.labels) for n, o in self._trial.observed.items() if n != "command"}
        histories = {n: [read(rows)] for n, read in shown.items()}
        sound, given = [self._sound()], []
        for s in range(self._count):
            self._look(s)
            command = np.array(recorded[:, s]) if recorded is not None else self._asked(s)
            given.append(np.array(command))
            for law in self._laws:
                law.act(command)
            self._copies.step(command, self._step)
            sound.append(self._sound())
            for name, read in shown.items():
                histories[name].append(read(rows))
        if "torque" in histories:  # it acts during a step, states are at its ends
            histories["torque"] = [*histories["torque"][1:], histories["torque"][-1]]
        if (command := self._trial.observed.get("command")) is not None:
            columns = [self._model.columns()[label] for label in command.labels]
            histories["command"] = [g[:, columns] for g in (*given, given[-1])]
        return self._seen(histories, ~np.logical_and.accumulate(np.stack(sound, axis=1), axis=1))

    def _sound(self) -> NDArray[np.bool_]:
        """(b,) whether a simulation has not blown up."""
        return np.asarray(np.isfinite(self._copies.position + self._copies.velocity).all(axis=1))

    def _reader(self, channel: str, labels: Sequence[str]) -> Callable[[int], Array]:
        """What reads a channel of the first n copies. Raises ModelError for one that is no signal of the model."""
        if channel not in _STATES and channel not in self._model.channels():
            raise ModelError(f"channel '{channel}' of '{self._trial.name}' is no signal of '{self._model.name}'")
        return self._copies.reader(_STATES.get(channel, channel), labels)

    def _observation(self, s: int, **channels: Array) -> Observation:
        rows = len(self._copies.position)
        sensors = {n: self._copies.reader(n, labels)(rows) for n, labels in self._model.channels().items()}
        now = s * self._step
        return Observation(now, self._copies.position, self._copies.velocity, sensors, self._trial, channels)

    def _asked(self, s: int) -> Array:
        """(b, width) what the controller commands in step s."""
        if self._loop is None:
            raise RuntimeError("no controller in this run")
        if self._loop.due <= s:
            self._loop.ask(self._observation(s, **self._shown(self._loop.looks_at)))
        return self._loop.commands(s, 1)[:, 0]

    def _look(self, s: int) -> None:
        """Which runs have ended by step s, looked at every `ends.LOOK` s."""
        if s not in self._looks:
            return
        seen = [self._observation(s, **self._shown(e.looks_at)) for e in self._trial.ends]
        reached = which_end(self._trial.ends, seen, len(self._copies.position))
        if isinstance(self._copies, Stopping):
            self._copies.stop(np.flatnonzero(reached >= 0))
        for row in np.flatnonzero(reached >= 0):
            at = self._trial.start + s * self._step
            self._ends.setdefault(int(row), Ended(at, self._trial.ends[reached[row]].name))

    def _shown(self, wanted: Mapping[str, tuple[str, ...]]) -> dict[str, Array]:
        """Channel to (b, k) of what is so now."""
        return {n: self._reader(n, labels)(len(self._copies.position)) for n, labels in wanted.items()}

    def _seen(self, histories: Mapping[str, Sequence[Array]], lost: NDArray[np.bool_]) -> Rollout:
        """Channels as they are measured; (b, m) `lost` says from when on a simulation has none."""
        channels = {}
        for name, observed in self._trial.observed.items():
            history = np.ascontiguousarray(np.stack(histories[name], axis=1))
            history[lost] = np.nan
            channels[name] = np.empty((len(history), len(observed.time), history.shape[2]))
            instants, rows = self._signals.instants(0, name, self._step), np.arange(len(history))
            bias = self._signals.bias(0, name, history.shape[2])
            shared = len(instants) == 1
            read_off(history, rows, 0, history.shape[1] - 1, True, instants, shared, bias, channels[name])
        failures = {
            int(row): f"the simulation became unstable after {self._step * int(np.argmax(lost[row])):.3g} s"
            for row in np.flatnonzero(lost.any(axis=1))
        }
        ended = {r: e for r, e in self._ends.items() if r not in failures}
        rollout = Rollout(self._trial, channels, failures, ended, self._settings)
        for name, values in channels.items():
            values[~rollout.lasted(name)] = np.nan
        return rollout
