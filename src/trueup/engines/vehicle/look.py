# SPDX-License-Identifier: Apache-2.0
"""A first look at recordings: rough values of a car by linear regression, for a calibration to start from."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from trueup.engines.vehicle.driving import COMMAND
from trueup.engines.vehicle.past import Past
from trueup.engines.vehicle.vehicle import Vehicle
from trueup.errors import CalibrationError
from trueup.recording import Recording
from trueup.trial import Trial

Array = NDArray[np.float64]

LATE = 0.12  # s between command and effect, roughly, of small servos and drives
_FAST = 0.3  # m/s: slower samples say little
_SHOWS = MappingProxyType({"understeer": 3.0, "friction_limit": 5.0})
"""Sideways acceleration in m/s^2 that the recordings must reach."""


def first_look(car: Vehicle, recordings: Sequence[Recording], late: float = LATE) -> dict[str, float]:
    """Start values of steering and drive, within their bounds; nothing where the recordings say nothing.

    Curvature = (a + b z) over command z, and acceleration = drive * throttle - friction - loss * speed - curve loss.
    `recordings` prepared; `late` (s): how long steering takes to show. Raises CalibrationError where steering to the left
    turns the car to the right.
    """
    curvature, steering, throttle, speed, pushed = _samples(recordings, late)
    if len(speed) < 50:
        return {}
    found = _steering(car, curvature, steering)
    table = np.stack([throttle, -np.ones(len(speed)), -speed, -speed * curvature**2], axis=1)
    values = _least_squares(table, pushed)
    if (values[[0, 2]] > 0.0).all():
        found |= {"drive": values[0], "friction": values[1], "speed_loss": values[2], "curve_loss": values[3]}
    return {name: float(value) for name, value in found.items()}


def straight_on(recordings: Sequence[Recording]) -> float:
    """The steering command of prepared recordings at which the car drives straight on; NaN where they do not tell."""
    curvature, steering, *_ = _samples(recordings)
    if len(curvature) < 50 or np.std(steering) < 0.02:
        return float("nan")
    offset, slope = _least_squares(np.stack([np.ones(len(steering)), steering], axis=1), curvature)
    return float(-offset / slope)


def unseen(recordings: Sequence[Recording]) -> dict[str, str]:
    """Quantities of the tyres that these prepared recordings are too calm to tell, each with the reason.

    Below a third of g a car hardly slips: its understeer is less than the play of a steering, so that a fit would bend it to
    mend something else, and be far off in the first fast curve.
    """
    curvature, _, _, speed, _ = _samples(recordings)
    sideways = float(np.percentile(np.abs(curvature) * speed**2, 98)) if len(speed) else 0.0
    return {
        name: f"{name} is not looked for: the recorded curves reach {sideways:.1f} m/s^2 sideways, it shows above {least:g}"
        for name, least in _SHOWS.items()
        if sideways < least
    }


def braked(recordings: Sequence[Recording]) -> bool:
    """Whether these prepared recordings were driven with a throttle below zero."""
    throttle = _samples(recordings)[2]
    return len(throttle) > 0 and float(np.percentile(throttle, 2)) < -0.02


def _samples(recordings: Sequence[Recording], late: float = LATE) -> tuple[Array, Array, Array, Array, Array]:
    """Curvature, steering, throttle, speed, acceleration at instants in which the car drove, every 0.05 s."""
    parts: list[Array] = []
    for recording in recordings:
        drive = Past.of(Trial.of(recording, ["position", "heading"]), 0.01, COMMAND)
        k = np.arange(drive.earliest, len(drive.known) - 1, 5)
        k = k[drive.known[k] & (drive.lengths[k] > 20) & (drive.seen[k, 3] > _FAST)]
        asked = k - round(LATE / 0.01)
        speed = drive.seen[k, 3]
        gained = (speed - drive.seen[k - 20, 3]) / 0.2
        parts.append(np.stack([drive.seen[k, 5] / speed, drive.commands[k - round(late / 0.01), 1],
                               drive.commands[asked - 10, 0], speed, gained]))  # fmt: skip
    curvature, steering, throttle, speed, pushed = np.concatenate(parts, axis=1) if parts else np.zeros((5, 0))
    return curvature, steering, throttle, speed, pushed


def _steering(car: Vehicle, curvature: Array, steering: Array) -> dict[str, float]:
    if np.std(steering) < 0.02:
        return {}
    offset, slope = _least_squares(np.stack([np.ones(len(steering)), steering], axis=1), curvature)
    if slope <= 0.0:
        raise CalibrationError(
            f"car '{car.name}': steering commands above zero turn it to the right; headings and steering must grow to the "
            "left: say sign = [1, -1] for the command (throttle, steering) in the mapping, or sign = -1 for the heading"
        )
    angle = float(np.arctan(slope * car.wheelbase))
    return {"steering_left": angle, "steering_right": angle, "steering_offset": float(offset / slope)}


def _least_squares(table: Array, wanted: Array) -> Array:
    """With outliers of more than three robust standard deviations left out, twice."""
    kept = np.ones(len(wanted), dtype=bool)
    values = np.zeros(table.shape[1])
    for _ in range(3):
        values = np.linalg.lstsq(table[kept], wanted[kept], rcond=None)[0]
        off = np.abs(table @ values - wanted)
        kept = off <= 3.0 * 1.4826 * np.median(off) + 1e-12
    return np.asarray(values, dtype=np.float64)
