# SPDX-License-Identifier: Apache-2.0
"""The car as a Simulator: a drive is predicted in stretches, each from what was known when it began."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from trueup.controllers.controller import ControllerFactory
from trueup.engines.car.car import Car, columns_of
from trueup.engines.car.kernels import READ, predict_rows
from trueup.engines.car.past import Drive
from trueup.engines.car.tracking import cleaned
from trueup.engines.simulator import Rollout, refuse_unsupported
from trueup.errors import ModelError
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.trial import Trial

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_PLACES = 0.1  # s: stretches begin at multiples of it, so that they are the same at every integration step
HORIZON = 3.0  # s: under recorded commands alone a car drifts away from any simulation; each stretch starts anew
CHANNELS = {"position": ("x", "y"), "heading": ("heading",), "speed": ("speed",), "yaw_rate": ("yaw_rate",)}
_COLUMNS = {"x": 0, "y": 1, "heading": 2, "speed": 3, "yaw_rate": 4}
_FITTED = ("position", "heading")


class CarSimulator:
    """A car under recorded throttle and steering, predicted `horizon` s ahead, again and again.

    A stretch starts from the measured pose and velocity (fitted to the last quarter of a second), with servo and motor where
    the past commands brought them, and with what the last two seconds showed beyond the model: a push (battery, slope)
    and a turn of the tracked heading. After its start nothing that was measured counts. `step` in s.
    """

    def __init__(
        self, car: Car, space: ParameterSpace | None = None, *, horizon: float = HORIZON, step: float = 0.01
    ) -> None:
        self.car, self.horizon, self.step = car, horizon, step
        self.parameters = space if space is not None else ParameterSpace(())
        self._columns = columns_of(self.parameters)
        self._drives: WeakKeyDictionary[Trial, Drive] = WeakKeyDictionary()

    @property
    def name(self) -> str:
        """The car's name."""
        return self.car.name

    def at_step(self, step: float) -> CarSimulator:
        """The same simulator with another step, in s."""
        return CarSimulator(self.car, self.parameters, horizon=self.horizon, step=step)

    def starting(self, values: Mapping[str, float]) -> CarSimulator:
        """The same simulator whose parameters start at these values, by name."""
        parameters = (p.replace(nominal=values.get(p.name, p.nominal)) for p in self.parameters.parameters)
        return CarSimulator(self.car, ParameterSpace(tuple(parameters)), horizon=self.horizon, step=self.step)

    def shipped(self) -> CarSimulator:
        """The car as it came, without parameters."""
        return CarSimulator(self.car, horizon=self.horizon, step=self.step)

    def observable(self, recording: Recording) -> tuple[str, ...]:
        """Position and heading: speed and turn rate say the same again, later and coarser."""
        return tuple(name for name in _FITTED if recording.has(name))

    def prepared(self, recording: Recording) -> Recording:
        """The recording without what the tracker mistook for the car; see `cleaned`."""
        return cleaned(recording, self.car.enabled_by, self.car.middle, self.car.full, self.car.wheelbase)

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        """Every trial for every row of values (b, n). See `Simulator.rollout`. Raises ModelError for a controller."""
        if controllers is not None:
            raise ModelError(
                f"car '{self.name}' is simulated under recorded commands only; take a bicycle for controllers"
            )
        refuse_unsupported(self.name, trials, "ends", "disturbances", "sensing")
        rows, failures = self.rows(values)
        return [self._rolled(trial, rows, failures) for trial in trials]

    def rows(self, values: Array) -> tuple[Array, dict[int, str]]:
        """(b, 1 + quantities) for the kernel, and the rows that cannot be simulated."""
        given = np.atleast_2d(np.asarray(values, dtype=np.float64))
        rows = np.tile(self.car.row, (len(given), 1))
        rows[:, self._columns] = given
        unusable = np.flatnonzero(~np.isfinite(given).all(axis=1))
        rows[unusable] = self.car.row
        return rows, {int(row): "a parameter is not finite" for row in unusable}

    def drive(self, trial: Trial) -> Drive:
        """A trial's commands and measured past; computed once."""
        if trial not in self._drives:
            self._drives[trial] = Drive.of(trial, self.step)
        return self._drives[trial]

    def ahead(self, trial: Trial, times: Array) -> Array:
        """(T,) how long before each instant its prediction began, in s; 0 where nothing is predicted."""
        since, _, _ = self._stretches(trial, times)
        return np.where(since > self.horizon + 1.5 * self.step, 0.0, np.clip(since, 0.0, self.horizon))

    def _stretches(self, trial: Trial, times: Array) -> tuple[Array, Indices, Indices]:
        """(T,) time since the stretch that holds each instant began; its number; (S,) where stretches begin."""
        drive = self.drive(trial)
        starts = _starts(drive, trial, self.horizon)
        stretch = np.clip(np.searchsorted(starts, (times - drive.begin) / drive.step + 1e-6, side="right") - 1, 0, None)
        return times - drive.begin - drive.step * starts[stretch], stretch, starts

    def _rolled(self, trial: Trial, rows: Array, failures: dict[int, str]) -> Rollout:
        for name, o in trial.observed.items():
            if name not in CHANNELS or any(label not in CHANNELS[name] for label in o.labels):
                raise ModelError(
                    f"a car has no channel '{name}' ({', '.join(o.labels)}); it has: {', '.join(CHANNELS)}"
                )
        times = np.unique(np.concatenate([o.time for o in trial.observed.values()]))
        drive = self.drive(trial)
        since, stretch, starts = self._stretches(trial, times)
        first = np.searchsorted(stretch, np.arange(len(starts) + 1)).astype(np.int64)
        out = self.predict(drive, rows, starts, first, np.clip(since, 0.0, self.horizon))
        # Before the first start, and after a gap until enough is known again, there is no prediction to be judged.
        idle = np.flatnonzero((since < 0.0) | (since > self.horizon + 1.5 * drive.step))
        out[:, idle] = drive.at(times[idle])
        failures = dict(failures)
        for row in np.flatnonzero(~np.isfinite(out).all(axis=(1, 2))):
            failures.setdefault(int(row), "the simulation gave values that are not finite")
        out[list(failures)] = np.nan
        channels = {
            name: out[:, np.searchsorted(times, o.time)][:, :, [_COLUMNS[label] for label in o.labels]]
            for name, o in trial.observed.items()
        }
        return Rollout(trial, channels, failures)

    def predict(self, drive: Drive, rows: Array, starts: Indices, first: Indices, since: Array) -> Array:
        """(b, len(since), 5) x, y, heading, speed, yaw rate of stretches; see `predict_rows`."""
        out = np.empty((len(rows), len(since), READ))
        predict_rows(rows, drive.step, drive.commands, drive.seen, starts, drive.pasts[starts], drive.settle, first,
                     since, out)  # fmt: skip
        return out


def _starts(drive: Drive, trial: Trial, horizon: float) -> Indices:
    """(S,) grid instants at which stretches begin: every `horizon` s, later where nothing was known then.

    Raises ModelError where nothing is known at all.
    """
    every = max(1, round(_PLACES / drive.step))
    last = drive.index(trial.start + trial.duration)
    places = np.arange(drive.earliest, last + 1, every)
    places = places[drive.known[places]]
    found: list[int] = []
    for place in places.tolist():
        if not found or place >= found[-1] + round(horizon / drive.step):
            found.append(place)
    if not found:
        raise ModelError(f"trial '{trial.name}' never shows position and heading for long enough to start a prediction")
    return np.array(found, dtype=np.int64)
