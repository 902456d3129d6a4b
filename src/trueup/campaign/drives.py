# SPDX-License-Identifier: Apache-2.0
"""Drives commanded by speed, calibrated instant by instant in windows, each of which begins anew from a measurement."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.calibration import Calibration, Estimate
from trueup.discrepancies.rigid import RigidlyAligned
from trueup.engines.family import Family, Fit
from trueup.engines.simulator import Simulator
from trueup.engines.vehicle.localisation import with_noise
from trueup.evidence import half_interval
from trueup.recording import Recording
from trueup.tracking.channels import CHANNELS
from trueup.tracking.windows import LENGTH, noise_of, windows

DOUBT = {
    "speed_delay": 0.03, "speed_lag": 0.03, "steering_delay": 0.03, "steering_lag": 0.03, "steering_scale": 0.02,
    "steering_slack": 0.01, "understeer": 0.03, "localisation_latency": 0.01, "wheel_scale": 0.003,
    "steering_offset": 0.003, "rear_slip": 0.003, "relaxation": 0.03,
}  # fmt: skip
"""Least standard deviation that tuning reckons with, in the parameters' units: the vehicle is no bicycle. Least squares
tells a parameter far better than this, but only as far as the model's structure is right. The last four were chosen on the
robots of `benchmarks/template.py`, those of the tyres on its robot 3 alone."""
EARNING_NOTHING = ("profiles",)
"""Stages of the search (`loop.fit`): on seven robots of `benchmarks/template.py` half of the CPU, for no better gains."""
_DOUBTED_LIMITS = 0.25  # the same for limits, as a share of their value
_NOTE = "intervals hold more doubt than the residuals show: the vehicle is no bicycle, and tuning reckons with that"


@dataclass(frozen=True)
class Drives(Family):
    """Vehicles commanded by speed and steering, fitted to windows of `length` s, each with a start pose of its own.

    Of more than `most` windows evenly spaced ones are taken, so that many drives cost hardly more than two.
    """

    length: float = LENGTH
    most: int = 42

    def calibrate(
        self, simulator: Simulator, training: Sequence[Recording], held_out: Sequence[Recording], fit: Fit
    ) -> Calibration:
        """See Family; as unsure of itself as tuning should be.

        Raises RecordingError where nothing moves, and what `fit` raises.
        Speed and turn rate come at once and the pose late: together they tell the latency of the localisation from a
        delay of the command, which a controller that looks ahead in time would not forgive.
        """
        pieces, kept = ([p for r in rs for p in windows(r, self.length)] for rs in (training, held_out))
        pieces = [pieces[k] for k in np.unique(np.linspace(0, len(pieces) - 1, self.most).round().astype(int))]
        measure = RigidlyAligned.estimated(pieces, list(CHANNELS))
        found = doubted(
            fit(simulator, pieces, kept, discrepancy=measure, cross_validate=False, without=EARNING_NOTHING)
        )
        return with_noise(in_words(found), noise_of(training))


def in_words(calibration: Calibration) -> Calibration:
    """The same with a note on tyres that slip, if it has them, in place of the one on the structure's evidence."""
    tyres = {e.name: e.value for e in calibration.estimates if e.fitted and e.name in ("rear_slip", "relaxation")}
    if not tyres.get("rear_slip"):
        return calibration
    kept = "tyres kept: with it"
    shown = [": with that" + n.removeprefix(kept) for n in calibration.notes if n.startswith(kept)]
    said = (
        f"tyres take {tyres.get('relaxation', 0.0):.2g} m of way to take up a turn, and slip behind by "
        f"{tyres['rear_slip']:.2g} rad for each m/s^2 sideways" + "".join(shown)
    )
    others = tuple(n for n in calibration.notes if not n.startswith(kept))
    return dataclasses.replace(calibration, notes=(said, *others))


def doubted(calibration: Calibration) -> Calibration:
    """The same values with a wider covariance, because the structure is surely wrong somewhere (`DOUBT`).

    A delay may also be a lag instead, their sum the same, as far as both are in doubt: smooth driving hardly tells them
    apart, but a controller that is pushed to its limit becomes unstable with the one sooner than with the other.
    """
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
            traded = DOUBT[f"{kind}_delay"] + DOUBT[f"{kind}_lag"]
            covariance[np.ix_(pair, pair)] += traded**2 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    widened = dict(zip(place, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    return dataclasses.replace(
        calibration, covariance=covariance, notes=(*calibration.notes, _NOTE),
        estimates=tuple(_widened(e, widened[e.name]) if e.name in widened else e for e in calibration.estimates),
    )  # fmt: skip


def _widened(estimate: Estimate, deviation: float) -> Estimate:
    """With the 95 % interval of a greater standard deviation (in its unit), within its bounds; limits on a log scale."""
    half = half_interval() * deviation
    if estimate.name.endswith("_limit"):
        factor = math.exp(half / estimate.value)
        low, high = estimate.value / factor, estimate.value * factor
    else:
        low, high = estimate.value - half, estimate.value + half
    low, high = max(min(low, estimate.low), estimate.lower_bound), min(max(high, estimate.high), estimate.upper_bound)
    return dataclasses.replace(estimate, low=low, high=high)
