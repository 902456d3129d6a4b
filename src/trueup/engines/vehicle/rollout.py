# SPDX-License-Identifier: Apache-2.0
"""The vehicle as a Simulator: candidates x trials, under recorded commands or with a controller in the loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from weakref import WeakKeyDictionary

import numpy as np

from trueup.arrays import Array, Integers
from trueup.controllers.controller import Controller, ControllerFactory, Observation, as_declared
from trueup.controllers.stanley import Stanley
from trueup.controllers.stanley.kernel import path_table
from trueup.cores import cores, in_threads
from trueup.engines.simulator import Rollout, refuse_unsupported
from trueup.engines.vehicle.kernels import STATE
from trueup.engines.vehicle.loops import drive_all, follow_rows, measure_all, read_all, replay_rows, start_all
from trueup.engines.vehicle.reading import Ending, Orders, Reading, first_look
from trueup.engines.vehicle.vehicle import TURNED, Vehicle
from trueup.parameters import ParameterSpace, concatenate
from trueup.recording import Recording
from trueup.rounding import PRINTED, SAME_INSTANT, first_step
from trueup.tracking.channels import CHANNELS, READ
from trueup.tracking.cleaned import cleaned
from trueup.tracking.commands import COMMAND, by_unsteered_axle, refuse_another_range
from trueup.tracking.past import Past, stretches_begin
from trueup.tracking.start import start_state
from trueup.tracking.wheels import as_driven, refuse_another_unit
from trueup.trial import Trial


class VehicleSimulator:
    """A vehicle that steers its front axle, with the delays, lags, limits and losses that its values name.

    The parameters of `space` are quantities of the vehicle by name (see `Vehicle.space`); all others keep the vehicle's
    values. With a `controller`, the parameters of `controller_parameters` follow and are handed to it.

    `step` (s) is the vehicle's own unless told otherwise. Under recorded commands each trial is predicted in stretches of
    `horizon` s (None: its own). An endless one starts from what was measured around the trial's start. Any
    other starts from the pose and velocity measured until then, with steering and motor where the past commands brought
    them, and with what the last seconds showed beyond the model: a push (battery, slope), a wheel angle, a turn of the
    tracked heading.

    Localisation noise is the same for all candidates (drawn from `seed`) and acts in closed loop only: under recorded
    commands nobody reacts to it. `compiled=False` runs the Stanley controller in plain numpy, as any other one.
    """

    def __init__(
        self, vehicle: Vehicle, space: ParameterSpace | None = None, *, step: float | None = None,
        horizon: float | None = None, seed: int = 0, threads: int | None = None, controller: ControllerFactory | None = None,
        controller_parameters: ParameterSpace | None = None, compiled: bool = True,
    ) -> None:  # fmt: skip
        own = space if space is not None else ParameterSpace(())
        self.vehicle, self.controller = vehicle, controller
        self.step, self.horizon = step or vehicle.step, horizon or vehicle.horizon
        self.parameters = concatenate([own, controller_parameters]) if controller_parameters is not None else own
        self._columns = vehicle.columns(own.names)
        self._seed = seed
        self._threads = threads
        self._compiled = compiled
        self._pasts: WeakKeyDictionary[Trial, Past] = WeakKeyDictionary()
        self._starts: WeakKeyDictionary[Trial, Integers] = WeakKeyDictionary()
        self._shares: Mapping[str, Integers] = {}

    def __getstate__(self) -> dict[str, object]:
        """As it is sent to another process: with that one's threads, without what was read of this one's trials."""
        return {**self.__dict__, "_pasts": None, "_starts": None, "_threads": None}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update({**state, "_pasts": WeakKeyDictionary(), "_starts": WeakKeyDictionary()})

    @property
    def name(self) -> str:
        """The vehicle's name."""
        return self.vehicle.name

    def at_step(self, step: float) -> VehicleSimulator:
        """The same simulator with another step, in s."""
        twin = object.__new__(VehicleSimulator)
        twin.__dict__.update(self.__dict__)
        twin.step, twin._pasts, twin._starts = step, WeakKeyDictionary(), WeakKeyDictionary()
        return twin

    def with_parameters(self, space: ParameterSpace) -> VehicleSimulator:
        """The same simulator with another space of the same parameters."""
        twin = object.__new__(VehicleSimulator)
        twin.__dict__.update(self.__dict__)
        twin.parameters = space
        return twin

    def predicting(self, shares: Mapping[str, Integers]) -> VehicleSimulator:
        """The same simulator that predicts only these stretches (S,), by number, of trials with these names."""
        twin = self.with_parameters(self.parameters)
        twin._shares = shares
        return twin

    def with_vehicle(self, vehicle: Vehicle) -> VehicleSimulator:
        """The same simulator of a vehicle that differs in nothing but how its recordings are read."""
        twin = self.at_step(self.step)
        twin.vehicle = vehicle
        return twin

    def shipped(self) -> VehicleSimulator:
        """The vehicle as it came, without parameters."""
        declared = as_declared(self.controller, self.parameters.nominal[len(self._columns) :])
        return VehicleSimulator(self.vehicle, step=self.step, horizon=self.horizon, seed=self._seed, threads=self._threads,
                                controller=declared, compiled=self._compiled)  # fmt: skip

    def observable(self, recording: Recording) -> tuple[str, ...]:
        """The measured channels that the vehicle reproduces; those with other labels are none of its own.

        In stretches position and heading: speed and turn rate say the same again, later and coarser.
        """
        wanted = CHANNELS if np.isinf(self.horizon) else ("position", "heading")
        return tuple(
            name for name, c in recording.channels.items() if name in wanted and set(c.labels) <= set(CHANNELS[name])
        )

    def prepared(self, recording: Recording) -> Recording:
        """The recording without what the tracker mistook for the vehicle; see `cleaned`."""
        v = self.vehicle
        if v.drive == "speed":
            return recording
        if v.wheels is not None:
            recording = as_driven(recording, v.wheels)
            refuse_another_unit(recording, v.full)
        elif v.drive == "throttle":
            refuse_another_range(recording, v.middle, v.full, v.steered_over)
        clean = cleaned(recording, v.enabled_by, v.middle, v.full, v.steered_over, backs=v.pursues, headings=v.headings)
        return by_unsteered_axle(clean) if v.driven == "front" else clean

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        """Every trial for every row of values (b, n [+ controller parameters]). See `Simulator.rollout`.

        A trial may observe 'command' too: what the controller commanded. Raises RecordingError for a trial without
        command where no controller is given, ModelError for channels that a vehicle has not.
        """
        refuse_unsupported(self.name, trials, "disturbances", "sensing")
        rows, unusable = self.rows(values)
        given = np.atleast_2d(np.asarray(values, dtype=np.float64))
        done = []
        for trial in trials:
            factory = trial.controller or controllers or self.controller
            read, orders = Reading.of(trial), None
            ending = Ending(trial, len(rows))
            if factory is None:
                refuse_unsupported(f"{self.name}, under recorded commands", [trial], "ends")
                out = self._replay(trial, rows, read)
            else:
                out, orders = self._drive(trial, rows, factory(given[:, len(self._columns) :]), read.times, ending)
            done.append(read.rollout(trial, out, orders, unusable, ending.ends))
        return done

    def rows(self, values: Array) -> tuple[Array, Integers]:
        """(b, columns) for the kernels, and the rows that are not numbers: what is none is not simulated."""
        given = np.atleast_2d(np.asarray(values, dtype=np.float64))
        rows = np.tile(self.vehicle.row, (len(given), 1))
        rows[:, self._columns] = given[:, : len(self._columns)]
        unusable = np.flatnonzero(~np.isfinite(given).all(axis=1))
        rows[unusable] = self.vehicle.row
        return rows, unusable

    def past(self, trial: Trial) -> Past:
        """A trial's commands, and what was seen of it until each instant; computed once."""
        if trial not in self._pasts:
            labels = ("speed", "steering") if self.vehicle.drive == "speed" else COMMAND
            self._pasts[trial] = (
                Past.at_start(trial, self.step, labels)
                if np.isinf(self.horizon)
                else Past.of(trial, self.step, labels, turned=self.vehicle.drive == TURNED)
            )
        return self._pasts[trial]

    def ahead(self, trial: Trial, times: Array) -> Array:
        """(T,) how long before each instant its prediction began, in s; NaN where nothing is predicted."""
        since, _, _ = self._stretches(trial, times)
        return since

    def stretches(self, trial: Trial) -> Callable[[Array], tuple[Array, Integers]]:
        """Of instants (T,): how long before each its prediction began, as `ahead` has it, and the number of that."""
        return lambda times: self._stretches(trial, times)[:2]

    def predict(
        self, past: Past, rows: Array, starts: Integers, first: Integers, since: Array, faster: float = 0.0
    ) -> Array:
        """(b, len(since), 5) x, y, heading, speed, yaw rate of stretches; see `replay_rows`."""
        out = np.empty((len(rows), len(since), READ))
        known = (
            past.commands,
            past.seen,
            starts,
            past.lengths[starts],
            past.settle,
            past.lag,
            past.log_begin,
            past.doubt[3],
        )
        how = past.step, *known, faster, first, since
        in_threads(lambda i: replay_rows(rows[i], *how, out[i]), len(rows), self._threads or cores(), timed=True)
        return out

    def starts(self, trial: Trial) -> Integers:
        """(S,) grid instants at which the stretches of a trial begin, predicted or not."""
        if trial not in self._starts:
            self._starts[trial] = stretches_begin(self.past(trial), trial, self.horizon)
        return self._starts[trial]

    def _stretches(self, trial: Trial, times: Array) -> tuple[Array, Integers, Integers]:
        """(T,) time since the stretch that holds each instant began; its number; (S,) where predicted ones begin."""
        past, starts, wanted = self.past(trial), self.starts(trial), self._shares.get(trial.name)
        if not len(starts):
            return np.full(len(times), np.nan), np.zeros(len(times), dtype=np.int64), starts
        stretch = np.clip(
            np.searchsorted(starts, (times - past.begin) / past.step + PRINTED, side="right") - 1, 0, None
        )
        since = times - past.begin - past.step * starts[stretch]
        # Before the first start, and after a gap until enough is known again, there is no prediction to be judged.
        told = (since > -SAME_INSTANT) & (since < self.horizon + 1.5 * past.step)
        if wanted is not None:
            wanted = wanted[wanted < len(starts)]
            told &= np.isin(stretch, wanted)
            stretch, starts = np.clip(np.searchsorted(wanted, stretch, side="right") - 1, 0, None), starts[wanted]
        return np.where(told, np.clip(since, 0.0, self.horizon), np.nan), stretch, starts

    def moved_by_speed(self, trial: Trial, values: Array, faster: float) -> dict[str, Array]:
        """(T, k) by channel how values are changed by a speed at the starts of stretches that is `faster` (m/s)."""
        read, (rows, _) = Reading.of(trial), self.rows(values)
        as_seen, moved = (
            read.rollout(trial, self._replay(trial, rows, read, by), None, np.zeros(0, dtype=np.int64), {})
            for by in (0.0, faster)
        )
        return {name: moved.channels[name][0] - channel[0] for name, channel in as_seen.channels.items()}

    def _replay(self, trial: Trial, rows: Array, read: Reading, faster: float = 0.0) -> Array:
        times = read.times + trial.start
        since, stretch, starts = self._stretches(trial, times)
        first = np.searchsorted(stretch, np.arange(len(starts) + 1)).astype(np.int64)
        past = self.past(trial)
        # Times must not fall within a stretch: those after a gap has ended one early are read where it would have ended.
        idle = np.isnan(since)
        over = times - past.begin > past.step * (starts[0] if len(starts) else np.inf)
        out = self.predict(past, rows, starts, first, np.where(idle, np.where(over, self.horizon, 0.0), since), faster)
        out[:, idle] = past.at(times[idle])
        return out

    def _drive(
        self, trial: Trial, rows: Array, controller: Controller, times: Array, ending: Ending
    ) -> tuple[Array, Orders]:
        substeps = max(1, round(controller.period / self.step))
        period = substeps * self.step
        ticks = first_step(trial.duration, period)
        noise = np.random.default_rng(self._seed).standard_normal((ticks + 1, 3))
        start = np.zeros(STATE)
        start[:READ] = start_state(trial)  # straight wheels
        orders = np.empty((len(rows), ticks, 2))
        out = np.empty((len(rows), len(times), READ))
        compiled = self._compiled and self.vehicle.steered_by_angle and not trial.ends
        if compiled and isinstance(controller, Stanley):
            path = path_table(controller.path_of(first_look(trial, rows, start)))
            gains, settings = controller.gains, controller.settings.row
            in_threads(lambda i: follow_rows(rows[i], start, gains[i], settings, path, ticks, substeps, self.step, noise,
                                             times, out[i], orders[i]), len(rows), self._threads or cores())  # fmt: skip
        else:
            self._lockstep(trial, rows, controller, start, substeps, noise, orders, times, out, ending)
        return out, Orders(trial.start + period * np.arange(ticks, dtype=np.float64), orders)

    def _lockstep(
        self, trial: Trial, rows: Array, controller: Controller, start: Array, substeps: int, noise: Array, orders: Array,
        times: Array, out: Array, ending: Ending,
    ) -> None:  # fmt: skip
        ticks = orders.shape[1]
        history = np.empty((len(rows), ticks * substeps + 1, READ))
        history[:, 0] = start[:READ]
        state, pose = np.empty((len(rows), STATE)), np.empty((len(rows), READ))
        start_all(rows, start, state)
        controller.reset(first_look(trial, rows, start))
        told = np.empty_like(orders)
        for n in range(ticks):
            ending.look(n * substeps * self.step, history[:, n * substeps])
            if not ending.alive.any():
                break
            measure_all(rows, history, n * substeps, self.step, noise[n], pose)
            look = Observation(n * substeps * self.step, pose[:, :3], pose[:, 3:], {}, trial)
            orders[:, n] = controller.command(look)
            told[:, n] = self.vehicle.unsteered(orders[:, n])
            drive_all(rows, ending.alive, start, told, n, substeps, self.step, state, history)
        read_all(rows, history, ticks * substeps, self.step, times, noise, substeps * self.step, out)
