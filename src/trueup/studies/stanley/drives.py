# SPDX-License-Identifier: Apache-2.0
"""Calibrates the vehicle on recorded drives by least squares, instant by instant, in windows: beyond the paper."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from trueup.calibration import Calibration, TracePoint
from trueup.discrepancies.rigid import RigidlyAligned
from trueup.engines.simulator import Simulator
from trueup.engines.vehicle.windows import windows
from trueup.loop.calibrate import Options, calibrate
from trueup.noise import estimate_noise
from trueup.recording import Recording

Array = NDArray[np.float64]

CHANNELS = ("position", "heading", "speed", "yaw_rate")
"""Those of them that were recorded. Speed and turn rate come at once and the pose late: together they tell the latency of
the localisation from a delay of the command, which a controller that looks ahead in time would not forgive."""

DOUBT = {
    "speed_delay": 0.03, "speed_lag": 0.03, "steering_delay": 0.03, "steering_lag": 0.03, "steering_scale": 0.02,
    "steering_slack": 0.01, "understeer": 0.03, "localisation_latency": 0.01,
}  # fmt: skip
"""Least standard deviation that tuning reckons with, in the parameters' units: the vehicle is no bicycle. Least squares
tells a parameter far better than this, but only as far as the model's structure is right."""
_DOUBTED_LIMITS = 0.25  # the same for limits, as a share of their value
_TRADED = 0.06
"""Standard deviation in s by which a delay may be a lag instead, their sum the same: smooth driving hardly tells them
apart, but a controller that is pushed to its limit becomes unstable with the one sooner than with the other."""


def calibrate_drives(
    recordings: Sequence[Recording], simulator: Simulator, held_out: Sequence[Recording] = (),
    progress: Callable[[TracePoint], None] | None = None, length: float = 6.0, most: int = 42,
) -> Calibration:  # fmt: skip
    """Fits the simulator to recorded drives cut into windows of `length` s, each with a start pose of its own.

    Of more than `most` windows evenly spaced ones are taken, so that many drives cost hardly more than two.
    Raises RecordingError where nothing moves, CalibrationError where nothing can be fitted.
    """
    pieces = [p for r in recordings for p in windows(r, length)]
    pieces = [pieces[k] for k in np.unique(np.linspace(0, len(pieces) - 1, most).round().astype(int))]
    kept = [p for r in held_out for p in windows(r, length)]
    channels = tuple(name for name in CHANNELS if all(p.has(name) for p in (*pieces, *kept)))
    return calibrate(
        simulator, pieces, kept, options=Options(channels=channels, cross_validate=False),
        discrepancy=RigidlyAligned.estimated(pieces, channels), progress=progress,
    )  # fmt: skip


def noise_of(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Localisation noise that the recordings show: standard deviations of position in m and of heading in rad."""
    found = [
        [float(np.median(estimate_noise(c.values, c.time))) for c in (r.channel("position"), r.channel("heading"))]
        for r in recordings
    ]
    position, heading = np.median(found, axis=0)
    return float(position), float(heading)


def calibrate_under_doubt(
    recordings: Sequence[Recording], simulator: Simulator, held_out: Sequence[Recording] = (),
    progress: Callable[[TracePoint], None] | None = None, length: float = 6.0, most: int = 42,
) -> Calibration:  # fmt: skip
    """`calibrate_drives`, as unsure of itself as tuning should be: for plans."""
    return doubted(calibrate_drives(recordings, simulator, held_out, progress, length, most))


def doubted(calibration: Calibration) -> Calibration:
    """The same values with a wider covariance, because the structure is surely wrong somewhere (`DOUBT`, delay or lag)."""
    fitted = [e for e in calibration.estimates if e.fitted]
    place = {e.name: row for row, e in enumerate(fitted)}
    known = np.diag(calibration.covariance)
    least = np.array(
        [_DOUBTED_LIMITS * e.value if e.name.endswith("_limit") else DOUBT.get(e.name, 0.0) for e in fitted]
    )
    covariance = calibration.covariance + np.diag(np.maximum(least**2 - known, 0.0))
    for kind in ("speed", "steering"):
        if f"{kind}_delay" in place and f"{kind}_lag" in place:
            pair = [place[f"{kind}_delay"], place[f"{kind}_lag"]]
            covariance[np.ix_(pair, pair)] += _TRADED**2 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    note = "tuning reckons with more doubt than the intervals say: the vehicle is no bicycle"
    return dataclasses.replace(calibration, covariance=covariance, notes=(*calibration.notes, note))
