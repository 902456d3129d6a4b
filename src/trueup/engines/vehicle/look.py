# SPDX-License-Identifier: Apache-2.0
"""A first look at recordings: rough values of a car by linear regression, for a calibration to start from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Integers
from trueup.engines.vehicle.vehicle import PURSUED, TURNED, Vehicle
from trueup.errors import CalibrationError
from trueup.evidence import FEWEST_PARTS, HALVED, STANDARD_ERRORS, evidence, without_each
from trueup.noise import spread
from trueup.recording import Recording
from trueup.rounding import NEGLIGIBLE
from trueup.samples import correlation
from trueup.tracking.commands import COMMAND
from trueup.tracking.past import MOVES, Past
from trueup.tracking.pursuit import pursuit
from trueup.tracking.windows import LENGTH
from trueup.trial import Trial

LATE = 0.12
"""In s: between command and effect, roughly, of small servos and drives; speeds gained are taken over as long."""
_SLIDES = 3.0
"""In m/s^2 sideways, a third of g. Below it a car hardly slips: what its tyres do at their limit does not show, and its
understeer is of the size of the play of a steering, so that it is asked about before it is believed. Chosen on JetRacer."""


@dataclass(frozen=True, eq=False)
class Look:
    """What a car did at (n,) instants in which it drove, LATE s apart, and what it had been told by then."""

    curvature: Array
    """In 1/m."""
    speed: Array
    """In m/s."""
    gained: Array
    """Acceleration in m/s^2."""
    throttle: Array
    steering: Array
    earlier: Array
    """(n, 2) speeds or throttles commanded twice and four times as long before as `throttle`: heavy vehicles still follow."""
    drives: tuple[Past, ...] = ()

    @classmethod
    def at(cls, recordings: Sequence[Recording]) -> Look:
        """At prepared recordings, see `Past.of`. Raises RecordingError for one without pose or command."""
        steps = 12  # of the grid within LATE
        parts = [np.zeros((7, 0))]
        pasts = [Past.of(Trial.of(r, ["position", "heading"]), LATE / steps, COMMAND) for r in recordings]
        for past in pasts:
            k = np.arange(past.earliest, len(past.known) - 1, steps)
            k = k[past.known[k] & (past.lengths[k] > steps) & (past.seen[k, 3] > MOVES)]
            speed = past.seen[k, 3]
            gained = (speed - past.seen[k - steps, 3]) / LATE  # half of LATE ago
            late = steps * 3 // 2
            asked = [past.commands[np.maximum(k - ago, 0), 0] for ago in (late, 2 * late, 4 * late)]
            parts.append(np.stack([past.seen[k, 4] / speed, speed, gained, past.commands[k - steps, 1], *asked]))
        curvature, speed, gained, steering, throttle, *earlier = np.concatenate(parts, axis=1)
        return cls(curvature, speed, gained, throttle, steering, np.stack(earlier, axis=1), tuple(pasts))

    def curve(self) -> tuple[float, float] | None:
        """Offset and slope of curvature over steering; None where they do not tell the slope from none."""
        if len(self.steering) <= STANDARD_ERRORS**2:
            return None
        offset, slope = _least_squares(np.stack([np.ones(len(self.steering)), self.steering], axis=1), self.curvature)
        alike = correlation(self.steering, self.curvature)
        return (float(offset), float(slope)) if abs(alike) > STANDARD_ERRORS / np.sqrt(len(self.steering)) else None

    def straight_on(self) -> float:
        """The steering command at which the car drives straight on; NaN where the recordings do not tell."""
        curve = self.curve()
        return float("nan") if curve is None else -curve[0] / curve[1]

    def starts(self, car: Vehicle) -> dict[str, float]:
        """Start values of steering and drive; nothing where the recordings say nothing.

        Curvature = a + b z over command z, and acceleration = drive * throttle - friction - loss * speed - curve loss.
        Raises CalibrationError where steering to the left turns the car to the right.
        """
        starts, curve = {}, self.curve()
        if car.drive == TURNED:
            return pursuit(self.drives, 0.0)
        if curve is not None:
            offset, slope = curve
            if slope <= 0.0:
                raise CalibrationError(
                    f"car '{car.name}': steering commands above zero turn it to the right; headings and steering must grow "
                    "to the left: say sign = [1, -1] for the command (throttle, steering) in the mapping, or sign = -1 for "
                    "the heading"
                )
            angle = float(np.arctan(slope * car.wheelbase))
            starts = {"steering_left": angle, "steering_right": angle, "steering_offset": offset / slope}
        if car.drive == PURSUED:
            return starts | pursuit(self.drives, car.wheelbase)
        table = np.stack(
            [self.throttle, -np.ones(len(self.speed)), -self.speed, -self.speed * self.curvature**2], axis=1
        )
        if len(table) > table.shape[1]:
            drive, friction, loss, curves = _least_squares(table, self.gained).tolist()
            if min(drive, loss) > 0.0:
                starts |= {"drive": drive, "friction": friction, "speed_loss": loss, "curve_loss": curves}
        return starts

    def driven_by_the_steered_wheel(self) -> bool:
        """Whether commanded speeds are those of a steered wheel: left-out speeds, as they follow late and slowly, are
        foretold clearly better by these times the cosine of the angle, which halves the error that any share of what it takes
        off would mend. Losses in curves are of the same form, but as large by chance only.
        """
        count = round(len(self.speed) * LATE / LENGTH)  # longer than a speed's errors last
        if count < FEWEST_PARTS:
            return False
        parts = np.array_split(np.arange(len(self.speed)), count)
        as_told = np.column_stack([self.throttle, self.earlier])
        slower = as_told * np.cos(self.steering)[:, None]
        plain, steered, any_share = (
            self._left_out(np.column_stack([*told, self.gained]), parts)
            for told in ((as_told,), (slower,), (as_told, slower))
        )
        left, mended = (float(np.mean(e**2 - any_share**2)) for e in (steered, plain))
        return evidence(plain, steered, plain**2 + steered**2).holds and left < HALVED**2 * mended

    def _left_out(self, table: Array, parts: Sequence[Integers]) -> Array:
        """(B,) errors in m/s of the speed in each part, by a regression on `table` (n, k) without it."""
        grams = np.array([table[p].T @ table[p] for p in parts])
        sums = np.array([table[p].T @ self.speed[p] for p in parts])
        found = [
            np.linalg.lstsq(g, s, rcond=None)[0] for g, s in zip(without_each(grams), without_each(sums), strict=True)
        ]
        return np.array(
            [np.sqrt(np.mean((self.speed[p] - table[p] @ c) ** 2)) for p, c in zip(parts, found, strict=True)]
        )

    def unseen(self) -> dict[str, str]:
        """Quantities of the tyres that these recordings are too calm to tell, each with the reason."""
        sideways = float(np.percentile(np.abs(self.curvature) * self.speed**2, 98)) if len(self.speed) else 0.0
        if sideways > _SLIDES:
            return {}
        reason = (
            f"is not looked for: the recorded curves reach {sideways:.1f} m/s^2 sideways, it shows above {_SLIDES:g}"
        )
        return {name: f"{name} {reason}" for name in ("understeer", "friction_limit", "grip")}


def _least_squares(table: Array, wanted: Array) -> Array:
    """With outliers of more than three robust standard deviations left out, twice."""
    kept = np.ones(len(wanted), dtype=bool)
    values = np.zeros(table.shape[1])
    for _ in range(3):
        values = np.linalg.lstsq(table[kept], wanted[kept], rcond=None)[0]
        off = np.abs(table @ values - wanted)
        kept = off <= 3.0 * spread(off) + NEGLIGIBLE
    return np.asarray(values, dtype=np.float64)
