# SPDX-License-Identifier: Apache-2.0
"""Residuals of a robot with a free base: joint angles, where the torso is, and above all how it is turned.

J. Tan et al., "Simulation-based design of dynamic controllers for humanoid balancing", IROS 2016, equation 4, whose weights
"heavily penalize the difference in the torso orientation".
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.articulated.pose import ANGLES, ORIENTATION, near, quaternion_of, rotation_between
from trueup.discrepancies.discrepancy import by_samples, measured_at
from trueup.engines.simulator import Rollout
from trueup.recording import Recording

SCALES = {"base_orientation": 0.1, "base_position": 0.05, "position": 0.3}
"""rad, m, rad that count as one: a torso that leans 0.1 rad more is about to fall, a joint that lags as much is not."""


class WholeBody:
    """(simulated - measured) / scale; of the torso's orientation the rotation that leads from one to the other.

    Angles of roll, pitch and yaw jump where a robot goes head over; the rotation vector between two orientations, (3,) in
    rad in the measured torso's axes, does not.
    """

    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        """(k,) see Discrepancy."""
        return np.full(len(labels), SCALES.get(channel, 1.0))

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        """See Discrepancy."""
        return by_samples(self, real, simulated, _apart)


def _apart(name: str, labels: tuple[str, ...], measured: Array, values: Array) -> Array:
    turned = name == ORIENTATION and labels == ANGLES
    return _turn(measured, values) if turned else values - measured


def _turn(first: Array, second: Array) -> Array:
    """(..., 3) rotation vectors in rad that lead from the first roll, pitch, yaw (..., 3) to the second, in its axes."""
    return rotation_between(quaternion_of(first), quaternion_of(second))


def in_nearest_angles(channel: str, labels: tuple[str, ...], measured: Array, values: Array) -> Array:
    """(T, k) values as they are; a torso's roll, pitch and yaw in the way to say the same orientation that is nearest to what
    was measured (T, k). Where robots pitch over, roll and yaw of the first to do so are half a turn from the other's.
    """
    if channel != ORIENTATION or labels != ANGLES:
        return values
    other = values * np.array([1.0, -1.0, 1.0]) + np.pi
    ways = np.stack([near(values, measured), near(other, measured)])
    away = np.sum((ways - measured) ** 2, axis=-1)
    return np.where((away[1] < away[0])[..., None], ways[1], ways[0])


def orientation_error(real: Sequence[Recording], simulated: Sequence[Rollout]) -> float:
    """Root mean square angle in rad between the torso's measured and simulated orientation, over all recordings."""
    squares, count = 0.0, 0
    for recording, rollout in zip(real, simulated, strict=True):
        held = rollout.held()
        observed = held.trial.observed[ORIENTATION]
        measured = measured_at(recording, ORIENTATION, observed.labels, observed.time)
        angle = np.linalg.norm(_turn(measured, held.channels[ORIENTATION][0]), axis=-1)
        squares, count = squares + float(np.nansum(angle**2)), count + int(np.isfinite(angle).sum())
    return float(np.sqrt(squares / max(count, 1)))
