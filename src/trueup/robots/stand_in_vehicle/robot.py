# SPDX-License-Identifier: Apache-2.0
"""The stand-in vehicle as a Robot: it follows a trial's path with the gains that the trial asks for, or plays commands."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.controllers.stanley.kernel import path_table
from trueup.controllers.stanley.law import GAINS, Stanley, StanleySettings
from trueup.errors import RecordingError, TrialAbortedError, unknown_name
from trueup.paths import Path
from trueup.recording import Channel, Recording
from trueup.robots.stand_in_vehicle.kernel import follow, play
from trueup.robots.stand_in_vehicle.truth import VehicleTruth
from trueup.rounding import SAME_INSTANT
from trueup.tracking.channels import CHANNELS, PLACE, READ
from trueup.trial import STEP, Trial


@dataclass(frozen=True, eq=False)
class Drive:
    """What really happened in b runs, and what was measured; arrays are (b, T, 5): x, y, heading, wheel speed, yaw rate."""

    time: Array
    """(T,) since the start, in s, at the controller's rate."""
    truth: Array
    measured: Array
    orders: Array
    """(b, T, 2) commanded speed and steering."""


class StandInVehicle:
    """A simulated Robot with a hidden truth: a seed of the series, or given.

    A trial with a reference 'path' is driven by the robot's own Stanley controller with the gains in `Trial.settings`
    (1 where none is given); one with a command channel (speed, steering) is played open loop. `failing` is the share of
    runs that the operator must abort; `drifting` s are those over which the slow error of the localisation changes.
    """

    def __init__(
        self,
        truth: VehicleTruth | int = 0,
        settings: StanleySettings | None = None,
        *,
        seed: int = 0,
        failing: float = 0.0,
        drifting: float = 8.0,
    ) -> None:
        self.truth = VehicleTruth.of_seed(truth) if isinstance(truth, int) else truth
        self.settings = settings or StanleySettings()
        self._failing, self._drifting, self._seed = failing, drifting, seed
        self._rng = np.random.default_rng([seed, 7])

    @property
    def repeatable(self) -> bool:
        """True: a trial's noise and failures depend on the seed and on its name alone."""
        return True

    def perform(self, trial: Trial) -> list[Recording]:
        """See Robot.

        Raises RecordingError for a trial with neither path nor command, UnknownNameError for channels that it does not
        measure, TrialAbortedError for a run that the operator had to stop.
        """
        for name in trial.observed:
            if name not in CHANNELS and not name.startswith("command"):
                raise unknown_name("channel", name, CHANNELS, "what this robot measures")
        self._rng = np.random.default_rng([self._seed, 7, zlib.crc32(trial.name.encode())])
        if trial.command is not None:
            return [self._recording(name, trial, self._play(trial), 0) for name in trial.runs]
        gains = np.array([list(trial.settings.values()) or [1.0] * len(GAINS)], dtype=np.float64)
        drive = self.drive(trial, np.repeat(gains, trial.repeats, axis=0), tuple(trial.settings) or GAINS)
        return [self._recording(name, trial, drive, i) for i, name in enumerate(trial.runs)]

    def drive(self, trial: Trial, gains: Array, names: tuple[str, ...] = GAINS, *, noise: int | None = None) -> Drive:
        """Closed loop on the trial's path for b sets of gains (b, m), each with noise of its own.

        With a seed for the `noise` it is the same for all, so that they can be compared more closely.

        Nobody on the floor sees the truth in it: it is for judging methods. Raises RecordingError without a path.
        """
        if "path" not in trial.references:
            raise RecordingError(f"trial '{trial.name}' has neither a reference 'path' nor a command: nothing to drive")
        table = path_table(Path.of(trial.references["path"], trial.name))
        controller = Stanley(gains, self.settings, names=names)
        rows, time = len(controller.gains), self._clock(trial)
        unrest = (
            self._noise(self._rng, rows, len(time)) if noise is None else
            np.repeat(self._noise(np.random.default_rng([noise, 8]), 1, len(time)), rows, axis=0)
        )  # fmt: skip
        truth, seen = np.empty((rows, len(time), READ)), np.empty((rows, len(time), READ))
        orders = np.empty((rows, len(time), 2))
        follow(self.truth.row, _start(trial), controller.gains, self.settings.row, table, self.settings.period, STEP, unrest,
               truth, seen, orders)  # fmt: skip
        return Drive(time, truth, seen, orders)

    def _play(self, trial: Trial) -> Drive:
        if trial.command is None:
            raise RecordingError(f"trial '{trial.name}' has no command")
        time = self._clock(trial)
        orders = np.ascontiguousarray(trial.command.select(("speed", "steering")).at(time + trial.start, hold=True))
        truth, seen = np.empty((len(time), READ)), np.empty((len(time), READ))
        noise = self._noise(self._rng, 1, len(time))[0]
        play(self.truth.row, _start(trial), self.settings.period, STEP, noise, orders, truth, seen)
        return Drive(time, truth[None], seen[None], orders[None])

    def _noise(self, rng: np.random.Generator, rows: int, ticks: int) -> Array:
        """(rows, ticks, 7) unit noise of x, y, heading, speed, yaw rate, and slow drift of x and y."""
        from scipy.signal import lfilter

        noise = rng.standard_normal((rows, ticks, 7))
        keep = np.exp(-self.settings.period / self._drifting)
        slow = noise[:, :, 5:] * np.sqrt(1.0 - keep**2)
        slow[:, 0] = noise[:, 0, 5:]
        noise[:, :, 5:] = lfilter([1.0], [1.0, -keep], slow, axis=1)
        return noise

    def _clock(self, trial: Trial) -> Array:
        return self.settings.period * np.arange(
            int(np.ceil(trial.duration / self.settings.period)) + 1, dtype=np.float64
        )

    def _recording(self, name: str, trial: Trial, drive: Drive, row: int) -> Recording:
        if self._rng.random() < self._failing:
            stopped = trial.duration * self._rng.uniform(0.1, 0.7)
            raise TrialAbortedError(f"'{name}': somebody stood in the way after {stopped:.0f} s")
        command = trial.command
        if command is None:
            command = Channel("command", ("speed", "steering"), "", trial.start + drive.time, drive.orders[row])
        channels = {"command": command.replace(name="command")}
        for role, o in trial.observed.items():
            if role in CHANNELS:
                last = np.searchsorted(drive.time, o.time - trial.start + SAME_INSTANT, side="right") - 1
                columns = [PLACE[label] for label in o.labels]
                channels[role] = Channel(role, o.labels, o.unit, o.time, drive.measured[row][last][:, columns])
                if (
                    role == "heading" and "yaw_rate" not in trial.observed
                ):  # its log holds the gyroscope, asked for or not
                    turning = drive.measured[row][last][:, [PLACE["yaw_rate"]]]
                    channels["yaw_rate"] = Channel("yaw_rate", ("yaw_rate",), "rad/s", o.time, turning)
        settings = " ".join(f"{k}={v:.6g}" for k, v in trial.settings.items())
        return Recording(name, channels, {"source": "stand-in vehicle", "settings": settings})


def _start(trial: Trial) -> Array:
    """(3,) where the operator puts the robot: x, y in m, heading in rad."""
    if "position" in trial.initial:
        given = trial.initial
        heading = given["heading"].values[0, 0] if "heading" in given else 0.0
        return np.array([*given["position"].values[0], heading])
    if "path" in trial.references:
        path = Path.of(trial.references["path"], trial.name)
        return np.array([*path.points[0], path.heading[0]])
    return np.zeros(3)
