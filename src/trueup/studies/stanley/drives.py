# SPDX-License-Identifier: Apache-2.0
"""Calibrates the vehicle on recorded drives by least squares, instant by instant, in windows: beyond the paper."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from trueup.calibration import Calibration, TracePoint
from trueup.discrepancies.rigid import RigidlyAligned
from trueup.loop.belief import Belief
from trueup.loop.calibrate import Options, calibrate
from trueup.noise import estimate_noise
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.simulators.bicycle.windows import windows
from trueup.simulators.simulator import Simulator

Array = NDArray[np.float64]

CHANNELS = ("position", "heading", "speed")

DOUBT = {
    "speed_delay": 0.03, "speed_lag": 0.03, "steering_delay": 0.03, "steering_lag": 0.03, "steering_scale": 0.02,
    "steering_slack": 0.01, "understeer": 0.03,
}  # fmt: skip
"""Least standard deviation that tuning reckons with, in the parameters' units: the vehicle is no bicycle. Least squares
tells a parameter far better than this, but only as far as the model's structure is right."""
_DOUBTED_LIMITS = 0.25  # the same for limits, as a share of their value


def calibrate_drives(
    recordings: Sequence[Recording], simulator: Simulator, held_out: Sequence[Recording] = (),
    progress: Callable[[TracePoint], None] | None = None, length: float = 6.0,
) -> Calibration:  # fmt: skip
    """Fits the simulator to recorded drives cut into windows of `length` s, each with a start pose of its own.

    Of more than `most` windows evenly spaced ones are taken, so that many drives cost hardly more than two.
    Raises RecordingError where nothing moves, CalibrationError where nothing can be fitted.
    """
    pieces = [p for r in recordings for p in windows(r, length)]
    pieces = [pieces[k] for k in np.unique(np.linspace(0, len(pieces) - 1, most).round().astype(int))]
    kept = [p for r in held_out for p in windows(r, length)]
    return calibrate(
        simulator, pieces, kept, options=Options(channels=CHANNELS, cross_validate=False),
        discrepancy=RigidlyAligned.estimated(pieces, CHANNELS), progress=progress,
    )  # fmt: skip


def noise_of(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Localisation noise that the recordings show: standard deviations of position in m and of heading in rad."""
    found = [
        [float(np.median(estimate_noise(c.values, c.time))) for c in (r.channel("position"), r.channel("heading"))]
        for r in recordings
    ]
    position, heading = np.median(found, axis=0)
    return float(position), float(heading)


def doubted(calibration: Calibration, space: ParameterSpace) -> Belief:
    """What a calibration leaves to believe, less sure of itself where the structure is surely wrong (`DOUBT`)."""
    belief = Belief.of(calibration, space)
    spread = np.sqrt(np.diag(belief.covariance)).copy()
    least = np.zeros(len(spread))
    for row, index in enumerate(belief.unsure):
        p = space.parameters[index]
        if p.name.endswith("_limit"):
            least[row] = _DOUBTED_LIMITS / np.log(p.upper / p.lower)
        elif p.name in DOUBT:
            least[row] = DOUBT[p.name] / (p.upper - p.lower)
    more = np.maximum(least**2 - spread**2, 0.0)
    return Belief(belief.space, belief.values, belief.unsure, belief.covariance + np.diag(more))
