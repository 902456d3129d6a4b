# SPDX-License-Identifier: Apache-2.0
"""How far a body leans, from its gyros and accelerometer: what closes the loop of a walk."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from trueup.arrays import Array
from trueup.controllers.controller import Observation
from trueup.errors import unknown_name


@dataclass(frozen=True, eq=False)
class Lean:
    """Attitude of b bodies and how fast it changes; roll to the right and pitch forward are positive, in rad and rad/s."""

    roll: Array
    pitch: Array
    roll_rate: Array
    pitch_rate: Array


class Attitude(Protocol):
    """Says how far bodies lean; a user's own estimator fits here."""

    def reset(self, observation: Observation) -> None:
        """Called once before a trial."""
        ...

    def update(self, observation: Observation, period: float) -> Lean:
        """Called every `period` s."""
        ...


class Complementary:
    """Gyros, followed, and led back to what the accelerometer shows as down, with a time constant of `memory` s; at first to
    the mean of all that it has shown, since its first sample is noisy, and feet that settle shake it.

    Rates are smoothed with a time constant of `smooth` s. R. Mahony, T. Hamel and J.-M. Pflimlin, IEEE Trans. Automatic
    Control 53(5), 2008, in the small angles of a walk. Sensors are in the body's frame, x forward, y left, z up, or `mounted`
    otherwise: (3, 3) each, gyro's before accelerometer's, from the sensor's frame to the body's.
    """

    def __init__(
        self, gyro: str = "gyro", accelerometer: str = "accelerometer", *, memory: float = 1.0, smooth: float = 0.02,
        mounted: tuple[Array, Array] = (np.eye(3), np.eye(3)),
    ) -> None:  # fmt: skip
        self._gyro, self._accelerometer, self._memory, self._smooth = gyro, accelerometer, memory, smooth
        self._mounted = [None if np.array_equal(frame, np.eye(3)) else frame for frame in mounted]
        self._angles = self._rates = np.zeros((0, 2))
        self._seen = np.zeros(0)  # of each body, how often its accelerometer has shown where down is

    def reset(self, observation: Observation) -> None:
        """See Attitude. Raises UnknownNameError where the robot has no such sensor."""
        for name in (self._gyro, self._accelerometer):
            if name not in observation.sensors:
                raise unknown_name("sensor", name, observation.sensors, "the robot (a walk needs to feel its lean)")
        self._angles, self._rates = np.zeros((2, len(observation.position), 2))
        self._seen = np.zeros(len(observation.position))

    def update(self, observation: Observation, period: float) -> Lean:
        """See Attitude."""
        gyro, accelerometer = self._mounted
        turning, felt_by_it = observation.sensors[self._gyro], observation.sensors[self._accelerometer]
        rates = (turning if gyro is None else turning @ gyro.T)[:, :2]
        ax, ay, az = felt_by_it.T if accelerometer is None else accelerometer @ felt_by_it.T
        felt = ax * ax + ay * ay + az * az > 0.0
        shown = np.where(felt[:, None], np.stack([np.arctan2(ay, az), np.arctan2(-ax, np.hypot(ay, az))], axis=1), 0.0)
        self._rates = self._rates + period / (self._smooth + period) * (rates - self._rates)
        turned = self._angles + period * rates
        self._seen = self._seen + felt
        pull = np.maximum(period / (self._memory + period), 1.0 / np.maximum(self._seen, 1.0))[:, None]
        self._angles = turned + np.where(felt[:, None], pull * (shown - turned), 0.0)
        return Lean(self._angles[:, 0], self._angles[:, 1], self._rates[:, 0], self._rates[:, 1])
