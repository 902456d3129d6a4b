# SPDX-License-Identifier: Apache-2.0
"""What goes into and comes out of simulations: commands held, delayed and limited, start states, instants of sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from trueup.arrays import Array, Integers
from trueup.articulated.assignments import Assignment, changes
from trueup.articulated.changes import NO_ACCELERATION_LIMIT, NO_SPEED_LIMIT
from trueup.articulated.kernels import delayed_commands, limited_commands, read_off
from trueup.articulated.leading import paces
from trueup.articulated.model import Model, servos
from trueup.articulated.starts import at_rest, gone_on, measured_start
from trueup.articulated.wiring import commanded, control_of, twins
from trueup.recording import Channel
from trueup.samples import held_integral, in_force
from trueup.trial import SETTLE, Trial

_OF_JOINTS = ("position", "velocity")
"""Channels of which joints may have sensors of their own."""


class _Held(NamedTuple):
    """A held command."""

    columns: Integers
    times: Array
    """(n,) instants in s since the start."""
    values: Array
    """(n, k)"""
    integral: Array
    """(n, k) of the values up to each instant."""
    pace: Array
    """(n, k) speeds of the command; zero where nothing leads."""
    way: Array
    """(n, k) their running integral."""


class Signals:
    """Commands, start states and read-off instants of trials (R) x candidates (b). Joints are those of `model.drives()`."""

    def __init__(
        self, model: Model, assignments: Sequence[Assignment], trials: Sequence[Trial], values: Array, step: float = 0.0
    ) -> None:
        """`step` in s of the simulation that they begin."""
        self._model, self._trials, self._rows = model, trials, len(values)
        self._changes = changes(assignments, values)
        self._drives, self._columns, self._servos = model.drives(), model.columns(), servos(model)
        self._joints = list(self._drives)
        self.delay = np.zeros((self._rows, model.width))
        """(b, width) delay of each command, in s."""
        own = {a: np.full(self._rows, model.get("actuator.delay", a)[0]) for a in self._columns}
        for actuator, value in {**own, **self._changes.of("delay")}.items():
            self.delay[:, self._columns[actuator]] = value
        self.lead = np.zeros((self._rows, model.width))
        """(b, width) how far ahead along its speed each command is taken, in s."""
        for actuator, value in self._changes.of("lead").items():
            self.lead[:, self._columns[actuator]] = value
        self.twins = twins(model)
        """Columns of the commands that repeat another one, and which."""
        self._limits = self._profile_limits()
        self._profile: dict[int, tuple[Array, Array]] = {}
        self._told: dict[tuple[int, int], tuple[Integers, Array, Array]] = {}
        # Trials that differ in their start states share their commands.
        held: dict[tuple[int, float, float], _Held | None] = {}
        for t in trials:
            if (key := (id(t.command), t.start, t.duration)) not in held:
                held[key] = self._command(t)
        self._commands = [held[id(t.command), t.start, t.duration] for t in trials]
        rest = at_rest(model)
        self._measured_starts = [measured_start(rest, t, self._joints, step) for t in trials]

    def starts(self) -> list[tuple[Array, Array]]:
        """For each trial (b, k) positions and velocities of the joints, sensor errors taken out, corrections added."""
        return [self.start(k) for k in range(len(self._trials))]

    def start(self, trial: int) -> tuple[Array, Array]:
        """Those of one trial."""
        position, velocity = (np.repeat(m[None], self._rows, axis=0) for m in self._measured_starts[trial])
        measured = self._trials[trial].initial.get("position")
        for joint, value in self._changes.of("sensor").items():
            if measured is not None and joint in measured.labels:
                position[:, self._joints.index(joint)] -= value
        for joint, late in self._changes.of("joint_sensor_delay").items():
            further = gone_on(self._trials[trial], joint, late)
            for state, more in zip((position, velocity), further, strict=True):
                state[:, self._joints.index(joint)] += more
        for kind, state in (("start_position", position), ("start_velocity", velocity)):
            for target, value in self._changes.of(kind).items():
                recording, _, joint = target.partition(":")
                if recording == self._trials[trial].name:
                    state[:, self._joints.index(joint)] += value
        return position, velocity

    def hold(self, trial: int) -> Array:
        """(width,) the command of actuators that nobody commands: servos hold their start, others do nothing."""
        position, _ = self._measured_starts[trial]
        held = np.zeros(self._model.width)
        for start, actuator in zip(position, self._drives.values(), strict=True):
            if actuator in self._servos:
                held[self._columns[actuator]] = start
        return held

    def commands(self, trial: int, at: int, count: int, step: float) -> Array:
        """(b, count, width) commands of steps at ... at + count: held, delayed, averaged over each step."""
        held = self._commands[trial]
        out = np.empty((self._rows, count, self._model.width))
        out[:] = self.hold(trial)
        if held is None:
            return out
        columns = held.columns
        part = np.empty((self._rows, count, len(columns)))
        delay = np.ascontiguousarray(self.delay[:, columns] - self._late(trial)[:, None])
        delayed_commands(held.times, held.values, held.integral, delay, at, step, part)
        if (lead := self.lead[:, columns]).any():
            ahead = np.empty_like(part)
            delayed_commands(held.times, held.pace, held.way, delay, at, step, ahead)
            part += lead[:, None] * ahead
        out[:, :, columns] = self._limited(trial, at, part, columns, step)
        return self._off(out)

    def arriving(self, trial: int, at: int, given: Array, step: float) -> Array:
        """(b, n, width) what a controller of the trial commands in steps from `at` on, delayed, as drives take it.

        Limits of speed and zero errors act as on recorded commands. Stretches of a trial must be asked for in their order.
        """
        return self._off(self._limited(trial, at, given, np.arange(self._model.width), step))

    def _off(self, commands: Array) -> Array:
        """(b, n, width) commands less what servos take off them; they are changed in place."""
        for joint, value in self._changes.of("command").items():
            if (actuator := self._drives[joint]) in self._servos:
                commands[:, :, self._columns[actuator]] -= value[:, None]
        return commands

    @property
    def sensor_errors(self) -> Mapping[str, Array]:
        """Joint to (b,) what its position sensor adds to the truth, in rad."""
        return self._changes.of("sensor")

    @property
    def sensor_delays(self) -> Mapping[str, Array]:
        """Channel to (b,) how late it is measured, in s."""
        return self._changes.of("sensor_delay")

    def trial(self, k: int) -> Trial:
        """One of the trials."""
        return self._trials[k]

    def measured_start(self, k: int) -> tuple[Array, Array]:
        """(k,), (k,) positions and velocities of the joints where a trial begins, by its measurements alone."""
        return self._measured_starts[k]

    def held(self, trial: int, actuator: str) -> tuple[Array, Array, Array, Array, Array]:
        """(n,) instants, values and running integral of the command that an actuator ('': none) holds in between, its speed
        and the running integral of that.
        """
        held, address = self._commands[trial], self._columns.get(actuator, -1)
        if held is not None and address in held.columns:
            column = int(np.flatnonzero(held.columns == address)[0])
            values, integral, pace, way = (np.ascontiguousarray(part[:, column]) for part in held[2:])
            return held.times, values, integral, pace, way
        rest = self.hold(trial)[address] if address >= 0 else 0.0
        return np.zeros(1), np.full(1, rest), np.zeros(1), np.zeros(1), np.zeros(1)

    def shaping(self, trial: int, actuator: str) -> dict[str, Array]:
        """(b,) what becomes of the command of an actuator ('': none): its delay, lead, zero error and limits."""
        nothing, free, address = np.zeros(self._rows), np.full(self._rows, np.inf), self._columns.get(actuator, -1)
        limits = self._limits if address >= 0 else None
        joint = next((j for j, a in self._drives.items() if a and a == actuator), "")
        told = actuator in self._servos and self._commands[trial] is not None
        return {
            "delay": self.delay[:, address] - self._late(trial) if address >= 0 else nothing,
            "lead": self.lead[:, address] if address >= 0 else nothing,
            "offset": self._changes.of("command").get(joint, nothing) if told else nothing,
            "speed_limit": limits[0][:, address] if limits is not None else free,
            "acceleration_limit": limits[1][:, address] if limits is not None else free,
        }

    def _late(self, trial: int) -> Array:
        """(b,) how late the time stamps of a trial's commands are, in s: commands really were given that earlier."""
        return self._changes.of("clock").get(self._trials[trial].name, np.zeros(self._rows))

    def _profile_limits(self) -> tuple[Array, Array] | None:
        """(b, width) limits of speed and acceleration of the commands, infinite for none; None where no command has any."""
        given = [self._changes.of(kind) for kind in ("speed_limit", "acceleration_limit")]
        if not any(given):
            return None
        limits = np.full((2, self._rows, self._model.width), np.inf)
        for limit, of_actuators, none in zip(limits, given, (NO_SPEED_LIMIT, NO_ACCELERATION_LIMIT), strict=True):
            for actuator, value in of_actuators.items():
                limit[:, self._columns[actuator]] = np.where(value < none, value, np.inf)
        return (limits[0], limits[1]) if np.isfinite(limits).any() else None

    def _limited(self, trial: int, at: int, command: Array, columns: Integers, step: float) -> Array:
        """(b, count, k) commands as drives with limits let them through; they have arrived when a trial begins."""
        if self._limits is None:
            return command
        speed, acceleration = (np.ascontiguousarray(limit[:, columns]) for limit in self._limits)
        if at == 0 or trial not in self._profile:
            self._profile[trial] = np.array(command[:, 0]), np.zeros((len(command), len(columns)))
        out = np.empty_like(command)
        limited_commands(command, speed, acceleration, step, *self._profile[trial], out)
        return out

    def read(
        self, trial: int, channel: str, history: Array, rows: Integers, span: tuple[int, int, bool], step: float, out: Array
    ) -> None:  # fmt: skip
        """Reads a stretch of simulated steps off at the instants of a channel into `out` (b, T, k): see `kernels.read_off`.

        `history` (n, m, k) of `rows` (n,); `span` is the stretch's first step, the one that it ends before, and whether the
        run ends there. Joints that have a sensor of their own are read off when that one saw them.
        """
        labels, bias = self._trials[trial].observed[channel].labels, self.bias(trial, channel, history.shape[2])
        own = [j for j in self._changes.of("joint_sensor_delay") if channel in _OF_JOINTS and j in labels]
        if not own:
            at = self.instants(trial, channel, step)
            read_off(history, rows, *span, at, len(at) == 1, bias, out)
            return
        rest = [j for j in labels if j not in own]
        for together in ([rest] if rest else []) + [[j] for j in own]:
            columns = [labels.index(j) for j in together]
            at = self.instants(trial, channel, step, together[0])
            part = np.ascontiguousarray(out[:, :, columns])
            seen = np.ascontiguousarray(history[:, :, columns])
            read_off(seen, rows, *span, at, len(at) == 1, np.ascontiguousarray(bias[:, columns]), part)
            out[:, :, columns] = part

    def instants(self, trial: int, channel: str, step: float, label: str = "") -> Array:
        """(1 or b, T) when a channel is to be read off, in steps since the start, each sensor's delay taken off: that of a
        joint's own too, where `label` names one.
        """
        own = self._trials[trial]
        declared = sum(s.latency for s in own.sensing if s.channel == channel)
        at = (own.observed[channel].time - own.start - declared)[None] / step
        late = self._changes.of("sensor_delay").get(channel)
        if late is not None:
            at = at - late[:, None] / step
        more = self._changes.of("joint_sensor_delay").get(label) if channel in _OF_JOINTS else None
        if more is not None:  # what it tells of the time before the run: with the speed that the run begins with
            return np.ascontiguousarray(at - more[:, None] / step)
        return np.ascontiguousarray(np.maximum(at, 0.0))

    def bias(self, trial: int, channel: str, width: int) -> Array:
        """(b, width) what the sensor adds to the truth."""
        labels = self._trials[trial].observed[channel].labels
        bias = np.zeros((self._rows, width))
        for joint, value in self._changes.of("sensor").items() if channel == "position" else ():
            if joint in labels:
                bias[:, labels.index(joint)] += value
        return bias

    def _command(self, trial: Trial) -> _Held | None:
        if trial.command is None:
            return None
        if (key := (id(trial.command), id(trial.pace))) not in self._told:
            self._told[key] = self._controls(trial.command, trial.pace)
        columns, values, pace = self._told[key]
        near = self._near(trial, trial.command.time)
        # What was commanded before the first sample is not known: the first command held for ever before.
        before = [] if near.start else [min(trial.command.time[0] - trial.start, 0.0) - 10.0]
        times = np.concatenate([before, trial.command.time[near] - trial.start])
        values, pace = (np.concatenate([part[: len(before)], part[near]]) for part in (values, pace))
        return _Held(columns, times, values, held_integral(times, values), pace, held_integral(times, pace))

    def _controls(self, command: Channel, pace: Channel | None) -> tuple[Integers, Array, Array]:
        """(k,) columns of a command, its values (n, k) in the units of the drives, and its speeds (n, k)."""
        actuators = commanded(self._model, command)
        columns = np.array([self._columns[a] for a in actuators], dtype=np.int64)
        told = np.nan_to_num(in_force(command.values))  # of a drive that nothing is ever told: 0
        units = [command.unit_of(label) for label in command.labels]
        values = told * [control_of(self._model, a, unit) for a, unit in zip(actuators, units, strict=True)]
        return columns, values, paces(command, pace) if self.lead.any() else np.zeros_like(values)

    def _near(self, trial: Trial, time: Array) -> slice:
        """The samples of a trial's command that may act in it, of those that drives have not forgotten (`SETTLE`), with
        longer delays all: windows of a long recording would keep all of it each.
        """
        late = self.delay - self._changes.of("clock").get(trial.name, np.zeros(self._rows))[:, None]
        if np.abs(late).max(initial=0.0) > SETTLE:
            return slice(0, len(time))
        first = int(np.searchsorted(time, trial.start - SETTLE, side="right")) - 1
        return slice(max(first, 0), int(np.searchsorted(time, trial.start + trial.duration + SETTLE, side="right")))
