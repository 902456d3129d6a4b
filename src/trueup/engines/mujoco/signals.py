# SPDX-License-Identifier: Apache-2.0
"""Parameters that change signals rather than the model: delays, sensor errors, corrections of the start."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from trueup.articulated.kernels import delayed_commands, held_integral, limited_commands
from trueup.engines.mujoco.model import Model
from trueup.engines.mujoco.quantities import Quantity
from trueup.engines.mujoco.wiring import actuators_of, control_of, joint_id, start_state
from trueup.trial import Trial

Array = NDArray[np.float64]

_SETTLES = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))


class Signals:
    """Commands, start states and read-off instants of trials (R) x candidates (b)."""

    def __init__(
        self,
        model: Model,
        compiled: mujoco.MjModel,
        quantities: Sequence[Quantity],
        trials: Sequence[Trial],
        values: Array,
    ) -> None:
        self._model, self._compiled = model, compiled
        self._trials, self._values = trials, values
        self._quantities = quantities
        names = model.names("actuator")
        self.delay = np.zeros((len(values), compiled.nu))
        self.delay[:, compiled.actuator_ctrladr] = model.compiled.actuator_delay
        """(b, nu) delay of each command, in s."""
        self._offsets: dict[str, Array] = {}
        self._biases: dict[str, Array] = {}
        for column, quantity in enumerate(quantities):
            for i, target in enumerate(quantity.targets):
                value = values[:, column] * quantity.sign(i)
                if quantity.kind == "delay":
                    self.delay[:, compiled.actuator_ctrladr[names.index(target)]] = value
                elif quantity.kind == "offset":
                    self._offsets[target] = value
                elif quantity.kind == "bias":
                    self._biases[target] = value
        self._limits = self._profile_limits()
        self._profile: dict[int, tuple[Array, Array]] = {}
        self._commands = [self._command(t) for t in trials]
        self._measured_starts = [start_state(model, compiled, t) for t in trials]

    def starts(self) -> list[tuple[Array, Array]]:
        """For each trial (b, nq) positions and (b, nv) velocities, sensor errors taken out, corrections added."""
        found = []
        for trial, (q0, v0) in zip(self._trials, self._measured_starts, strict=True):
            qpos = np.repeat(q0[None], len(self._values), axis=0)
            qvel = np.repeat(v0[None], len(self._values), axis=0)
            measured = trial.initial.get("position")
            labels = measured.labels if measured is not None else ()
            for errors in (self._biases, self._offsets):
                for joint, value in errors.items():
                    if joint in labels:
                        qpos[:, self._qpos(joint)] -= value
            self._correct(trial, "start_position", qpos, self._compiled.jnt_qposadr)
            self._correct(trial, "start_velocity", qvel, self._compiled.jnt_dofadr)
            found.append((qpos, qvel))
        return found

    def _clock(self, recording: str) -> Array:
        """(b,) how late the time stamps of a recording's commands are, in s: commands really were given that earlier."""
        late = np.zeros(len(self._values))
        for column, quantity in enumerate(self._quantities):
            if quantity.kind == "clock" and recording in quantity.targets:
                late += self._values[:, column]
        return late

    def _correct(self, trial: Trial, kind: str, state: Array, address: NDArray[np.int32]) -> None:
        for column, quantity in enumerate(self._quantities):
            if quantity.kind == kind:
                for target in quantity.targets:
                    recording, _, joint = target.partition(":")
                    if recording == trial.name:
                        state[:, address[joint_id(self._compiled, joint)]] += self._values[:, column]

    def hold(self, trial: int) -> Array:
        """(nu,) the command of actuators that nobody commands: servos hold their start, others do nothing."""
        q0, _ = self._measured_starts[trial]
        held = np.zeros(self._compiled.nu)
        for joint, actuator in self._model.actuator_of_joint().items():
            if self._model.is_position_servo(actuator):
                held[self._compiled.actuator_ctrladr[actuator]] = q0[self._qpos(joint)]
        return held

    def commands(self, trial: int, at: int, count: int, step: float) -> Array:
        """(b, count, nu) commands of steps at ... at + count: held, delayed, averaged over each step."""
        held = self._commands[trial]
        out = np.empty((len(self._values), count, self._compiled.nu))
        out[:] = self.hold(trial)
        if held is None:
            return out
        columns, times, values, integral = held
        part = np.empty((len(self._values), count, len(columns)))
        delay = np.ascontiguousarray(self.delay[:, columns] - self._clock(self._trials[trial].name)[:, None])
        delayed_commands(times, values, integral, delay, at * step, step, part)
        out[:, :, columns] = self._limited(trial, at, part, columns, step)
        for joint, value in self._offsets.items():
            actuator = self._model.actuator_of_joint().get(joint, -1)
            if actuator >= 0 and self._model.is_position_servo(actuator):
                out[:, :, self._compiled.actuator_ctrladr[actuator]] -= value[:, None]
        return out

    def trial(self, k: int) -> Trial:
        """One of the trials."""
        return self._trials[k]

    def measured_start(self, k: int) -> tuple[Array, Array]:
        """(nq,), (nv,) where a trial begins by its measurements alone."""
        return self._measured_starts[k]

    def held(self, trial: int, actuator: int) -> tuple[Array, Array, Array]:
        """(n,) instants, values and running integral of the command that an actuator (-1: none) holds in between."""
        held, address = self._commands[trial], self._address(actuator)
        if held is not None and address in held[0]:
            columns, times, values, integral = held
            column = int(np.flatnonzero(columns == address)[0])
            return times, np.ascontiguousarray(values[:, column]), np.ascontiguousarray(integral[:, column])
        rest = self.hold(trial)[address] if address >= 0 else 0.0
        return np.zeros(1), np.full(1, rest), np.zeros(1)

    def shaping(self, trial: int, actuator: int) -> dict[str, Array]:
        """(b,) what becomes of the command of an actuator (-1: none): its delay, zero error and limits."""
        rows, address = len(self._values), self._address(actuator)
        limits = self._limits if address >= 0 else None
        free = np.full(rows, np.inf)
        joint = next((j for j, a in self._model.actuator_of_joint().items() if a == actuator), "")
        servo = bool(joint) and self._model.is_position_servo(actuator)
        commanded = self._commands[trial] is not None
        return {
            "delay": self.delay[:, address] - self._clock(self._trials[trial].name) if address >= 0 else np.zeros(rows),
            "offset": self._offsets[joint] if servo and commanded and joint in self._offsets else np.zeros(rows),
            "speed_limit": limits[0][:, address] if limits is not None else free,
            "acceleration_limit": limits[1][:, address] if limits is not None else free,
        }

    def _address(self, actuator: int) -> int:
        return int(self._compiled.actuator_ctrladr[actuator]) if actuator >= 0 else -1

    def _profile_limits(self) -> tuple[Array, Array] | None:
        """(b, nu) limits of speed and acceleration of the commands, infinite for none; None where no command has any."""
        kinds, names = ("speed_limit", "acceleration_limit"), self._model.names("actuator")
        if not any(q.kind in kinds for q in self._quantities):
            return None
        limits = np.full((2, len(self._values), self._compiled.nu), np.inf)
        for column, quantity in enumerate(self._quantities):
            if quantity.kind in kinds:
                for target in quantity.targets:
                    where = self._compiled.actuator_ctrladr[names.index(target)]
                    limits[kinds.index(quantity.kind), :, where] = self._values[:, column]
        return limits[0], limits[1]

    def _limited(self, trial: int, at: int, command: Array, columns: NDArray[np.int64], step: float) -> Array:
        """(b, count, k) commands as drives with limits let them through; they have arrived when a trial begins."""
        if self._limits is None:
            return command
        speed, acceleration = (np.ascontiguousarray(limit[:, columns]) for limit in self._limits)
        if at == 0 or trial not in self._profile:
            self._profile[trial] = np.array(command[:, 0]), np.zeros((len(command), len(columns)))
        out = np.empty_like(command)
        limited_commands(command, speed, acceleration, step, *self._profile[trial], out)
        return out

    def activations(self, trial: int, step: float) -> Array:
        """(b, na) of actuators at the start: filters have settled at the first command, integrators where the joint is."""
        model, act = self._compiled, np.zeros((len(self._values), self._compiled.na))
        first, (q0, _) = self.commands(trial, 0, 1, step)[:, 0], self._measured_starts[trial]
        for joint, i in self._model.actuator_of_joint().items():
            if model.actuator_actnum[i] == 1 and int(model.actuator_dyntype[i]) in _SETTLES:
                act[:, model.actuator_actadr[i]] = first[:, model.actuator_ctrladr[i]]
            elif model.actuator_actnum[i] == 1 and int(model.actuator_dyntype[i]) == int(
                mujoco.mjtDyn.mjDYN_INTEGRATOR
            ):
                act[:, model.actuator_actadr[i]] = q0[self._qpos(joint)]
        return act

    def instants(self, trial: int, channel: str, step: float) -> Array:
        """(1 or b, T) when a channel is to be read off, in steps since the start, each sensor's delay taken off."""
        at = (self._trials[trial].observed[channel].time - self._trials[trial].start)[None] / step
        for column, quantity in enumerate(self._quantities):
            if quantity.kind == "sensor_delay" and channel in quantity.targets:
                at = at - self._values[:, column : column + 1] / step
        return np.ascontiguousarray(np.maximum(at, 0.0))

    def bias(self, trial: int, channel: str, width: int) -> Array:
        """(b, width) what the sensor adds to the truth."""
        labels = self._trials[trial].observed[channel].labels
        bias = np.zeros((len(self._values), width))
        if channel == "position":
            for errors in (self._biases, self._offsets):
                for joint, value in errors.items():
                    if joint in labels:
                        bias[:, labels.index(joint)] += value
        return bias

    def _command(self, trial: Trial) -> tuple[NDArray[np.int64], Array, Array, Array] | None:
        if trial.command is None:
            return None
        actuators = actuators_of(self._model, trial.command)
        columns = np.array([self._compiled.actuator_ctrladr[a] for a in actuators], dtype=np.int64)
        times = trial.command.time - trial.start
        nominal = self._model.compiled
        values = _filled(trial.command.values) * [control_of(nominal, a, trial.command.unit) for a in actuators]
        # What was commanded before the first sample is not known: the first command held for ever before.
        times = np.concatenate([[min(times[0], 0.0) - 10.0], times])
        values = np.concatenate([values[:1], values])
        return columns, times, values, held_integral(times, values)

    def _qpos(self, joint: str) -> int:
        return int(self._compiled.jnt_qposadr[joint_id(self._compiled, joint)])


def _filled(values: Array) -> Array:
    """Missing commands repeat the last known one (a controller holds what it was told)."""
    filled = np.array(values)
    for column in filled.T:
        good = np.flatnonzero(np.isfinite(column))
        if len(good) == 0:
            column[:] = 0.0
            continue
        last = np.maximum.accumulate(np.where(np.isfinite(column), np.arange(len(column)), good[0]))
        column[:] = column[last]
    return filled
