# SPDX-License-Identifier: Apache-2.0
"""The bicycle as a Simulator: candidates x trials, under recorded commands or with a controller in the loop."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trueup.controllers.controller import Controller, ControllerFactory, Observation
from trueup.controllers.stanley import Stanley
from trueup.controllers.stanley.kernel import path_table
from trueup.engines.bicycle.kernels import (
    POSE,
    drive_all,
    follow_rows,
    observe_all,
    read_all,
    replay_rows,
)  # fmt: skip
from trueup.engines.bicycle.start import start_state
from trueup.engines.bicycle.vehicle import Vehicle, columns_of
from trueup.engines.simulator import Rollout, refuse_unsupported
from trueup.errors import ModelError, RecordingError
from trueup.parameters import ParameterSpace, concatenate
from trueup.recording import Channel, Recording, is_command
from trueup.trial import Trial

Array = NDArray[np.float64]

CHANNELS = {
    "position": ("x", "y"),
    "heading": ("heading",),
    "speed": ("speed",),
    "yaw_rate": ("yaw_rate",),
}
"""What is measured: pose of the rear axle in m and rad, speed of the wheels in m/s, turn rate in rad/s."""

COMMAND = ("speed", "steering")
"""Labels of the command channel: speed in m/s and steering angle of the front wheels in rad, left positive."""

_COLUMNS = {"x": 0, "y": 1, "heading": 2, "speed": 3, "yaw_rate": 4}


class BicycleSimulator:
    """A kinematic Ackermann vehicle (the paper's eq. (1)) with the delays and limits of its Table II, and more.

    The parameters of `space` are quantities of the vehicle by name (see `vehicle_space`); all others keep the vehicle's
    values. With a `controller`, the parameters of `controller_parameters` follow and are handed to it. `step` in s.
    Localisation noise is the same for all candidates (drawn from `seed`) and acts in closed loop only: under recorded
    commands nobody reacts to it. `compiled=False` runs the Stanley controller in plain numpy, as any other one.
    """

    def __init__(
        self, vehicle: Vehicle, space: ParameterSpace | None = None, *, step: float = 0.02, seed: int = 0,
        threads: int | None = None, controller: ControllerFactory | None = None,
        controller_parameters: ParameterSpace | None = None, compiled: bool = True,
    ) -> None:  # fmt: skip
        own = space if space is not None else ParameterSpace(())
        self.vehicle, self.step, self.controller = vehicle, step, controller
        self.parameters = concatenate([own, controller_parameters]) if controller_parameters is not None else own
        self._columns = columns_of(own)
        self._seed = seed
        self._threads = threads or len(os.sched_getaffinity(0))
        self._compiled = compiled

    @property
    def name(self) -> str:
        """The vehicle's name."""
        return self.vehicle.name

    def at_step(self, step: float) -> BicycleSimulator:
        """The same simulator with another step, in s."""
        twin = object.__new__(BicycleSimulator)
        twin.__dict__.update(self.__dict__)
        twin.step = step
        return twin

    def shipped(self) -> BicycleSimulator:
        """The vehicle as it came, without parameters."""
        controller, own = self.controller, self.parameters.nominal[len(self._columns) :]
        declared: ControllerFactory | None = controller
        if controller is not None and len(own):
            declared = lambda values: controller(np.tile(own, (len(values), 1)))  # noqa: E731
        return BicycleSimulator(self.vehicle, step=self.step, seed=self._seed, threads=self._threads,
                                controller=declared, compiled=self._compiled)  # fmt: skip

    def observable(self, recording: Recording) -> tuple[str, ...]:
        """The measured channels that the vehicle reproduces; those with other labels are none of its own."""
        return tuple(
            name
            for name, c in recording.channels.items()
            if name in CHANNELS and all(label in CHANNELS[name] for label in c.labels)
        )

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        """Every trial for every row of values (b, n [+ controller parameters]). See `Simulator.rollout`.

        A trial may observe 'command' too: what the controller commanded. Raises RecordingError for a trial without
        command where no controller is given, ModelError for channels that a vehicle has not.
        """
        refuse_unsupported(self.name, trials, "ends", "disturbances", "sensing")
        given = np.atleast_2d(np.asarray(values, dtype=np.float64))
        rows = np.tile(self.vehicle.row, (len(given), 1))
        rows[:, self._columns] = given[:, : len(self._columns)]
        # What is not a number is not simulated: such a delay would be looked up outside of all memory.
        unusable = np.flatnonzero(~np.isfinite(given).all(axis=1))
        rows[unusable] = self.vehicle.row
        done = []
        for trial in trials:
            factory, read = trial.controller or controllers or self.controller, _Read.of(trial)
            if factory is None:
                pose, orders = self._replay(trial, rows, read.times), None
            else:
                controller = factory(given[:, len(self._columns) :])
                pose, orders = self._drive(trial, rows, controller, read.times)
            done.append(self._rollout(trial, read, pose, orders, unusable))
        return done

    def _replay(self, trial: Trial, rows: Array, times: Array) -> Array:
        command = _command_of(trial)
        out = np.empty((len(rows), len(times), POSE))
        steps = int(np.ceil(trial.duration / self.step - 1e-9))
        start = start_state(trial)
        sent = command.time - trial.start
        self._shared(
            lambda i: replay_rows(rows[i], start, sent, command.values, steps, self.step, times, out[i]), len(rows)
        )
        return out

    def _drive(self, trial: Trial, rows: Array, controller: Controller, times: Array) -> tuple[Array, _Orders]:
        substeps = max(1, round(controller.period / self.step))
        period = substeps * self.step
        ticks = int(np.ceil(trial.duration / period - 1e-9))
        noise = np.random.default_rng(self._seed).standard_normal((ticks + 1, 3))
        start = start_state(trial)
        orders = np.empty((len(rows), ticks, 2))
        out = np.empty((len(rows), len(times), POSE))
        if self._compiled and isinstance(controller, Stanley):
            path = path_table(controller.path_of(_first_look(trial, rows, start)))
            gains, settings = controller.gains, controller.settings.row
            self._shared(lambda i: follow_rows(rows[i], start, gains[i], settings, path, ticks, substeps, self.step, noise,
                                               times, out[i], orders[i]), len(rows))  # fmt: skip
        else:
            self._lockstep(trial, rows, controller, start, substeps, noise, orders, times, out)
        return out, _Orders(trial.start + period * np.arange(ticks, dtype=np.float64), orders)

    def _lockstep(
        self, trial: Trial, rows: Array, controller: Controller, start: Array, substeps: int, noise: Array, orders: Array,
        times: Array, out: Array,
    ) -> None:  # fmt: skip
        ticks = orders.shape[1]
        history = np.empty((len(rows), ticks * substeps + 1, POSE))
        history[:, 0] = start[:POSE]
        state, seen = np.tile(start, (len(rows), 1)), np.empty((len(rows), POSE))
        controller.reset(_first_look(trial, rows, start))
        for n in range(ticks):
            observe_all(rows, history, n * substeps, self.step, noise[n], seen)
            look = Observation(n * substeps * self.step, seen[:, :3], seen[:, 3:], {}, trial)
            orders[:, n] = controller.command(look)
            drive_all(rows, start, orders, n, substeps, self.step, state, history)
        read_all(rows, history, ticks * substeps, self.step, times, noise, substeps * self.step, out)

    def _shared(self, work: Callable[[slice], None], rows: int) -> None:
        """Does the work on all rows, in as many threads as are worth it."""
        parts = min(self._threads, rows)
        if parts <= 1:
            work(slice(0, rows))
            return
        edges = np.linspace(0, rows, parts + 1).astype(int)
        with ThreadPoolExecutor(parts) as pool:
            list(pool.map(work, [slice(a, b) for a, b in pairwise(edges.tolist())]))

    def _rollout(
        self, trial: Trial, read: _Read, pose: Array, orders: _Orders | None, unusable: NDArray[np.intp]
    ) -> Rollout:
        channels = {}
        for name, o in trial.observed.items():
            if is_command(name) and orders is not None:
                channels[name] = orders.at(o.time)[:, :, [COMMAND.index(label) for label in o.labels]]
                continue
            columns = [_COLUMNS[label] for label in o.labels]
            channels[name] = pose[:, read.rows[name]][:, :, columns]
        failures = {int(row): "a parameter is not finite" for row in unusable}
        for channel in channels.values():
            for row in np.flatnonzero(~np.isfinite(channel).all(axis=(1, 2))):
                failures.setdefault(int(row), "the simulation gave values that are not finite")
        for channel in channels.values():
            channel[unusable] = np.nan  # these were never simulated
        return Rollout(trial, channels, failures)


@dataclass(frozen=True)
class _Orders:
    """What a controller commanded: times (n,) on the trial's clock and (b, n, 2)."""

    time: Array
    values: Array

    def at(self, time: Array) -> Array:
        """(b, T, 2) the command in force."""
        last = np.searchsorted(self.time, time + 1e-9, side="right") - 1
        return self.values[:, np.clip(last, 0, None)]


@dataclass(frozen=True)
class _Read:
    """The instants at which a trial is observed, each once, and where the channels find theirs."""

    times: Array
    """(T,) since the start of the trial, in s."""
    rows: dict[str, NDArray[np.intp]]

    @classmethod
    def of(cls, trial: Trial) -> _Read:
        measured = {name: o for name, o in trial.observed.items() if not is_command(name)}
        for name, o in measured.items():
            if name not in CHANNELS or any(label not in CHANNELS[name] for label in o.labels):
                known = "; ".join(f"{k} ({', '.join(v)})" for k, v in CHANNELS.items())
                raise ModelError(f"a vehicle has no channel '{name}' ({', '.join(o.labels)}); it has: {known}")
        times = np.unique(np.concatenate([np.zeros(0), *(o.time for o in measured.values())]))
        return cls(times - trial.start, {name: np.searchsorted(times, o.time) for name, o in measured.items()})


def _command_of(trial: Trial) -> Channel:
    if trial.command is None:
        raise RecordingError(f"trial '{trial.name}' has no command, and no controller is given")
    return trial.command.select(COMMAND)


def _first_look(trial: Trial, rows: Array, start: Array) -> Observation:
    pose = np.tile(start[:POSE], (len(rows), 1))
    return Observation(0.0, pose[:, :3], pose[:, 3:], {}, trial)
