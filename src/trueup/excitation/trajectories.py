# SPDX-License-Identifier: Apache-2.0
"""Planned joint motion: many at once, as a search compares them, or one, as a robot is to perform it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Mask
from trueup.errors import RecordingError
from trueup.recording import Channel, Recording
from trueup.rounding import PRINTED, ROUNDED

RATE = 500.0
"""Hz at which trajectories are sampled unless another rate is asked for, as cyclic interfaces of arms take them."""
SAMPLED = 300
"""Samples of a motion by which it is judged what it tells, and first whether drives are strong enough."""


@dataclass(frozen=True, eq=False)
class Motions:
    """B motions of n joints at S instants each, spread evenly over a motion's own duration."""

    time: Array
    """(B, S) in s."""
    q: Array
    """(B, S, n) in rad (m), as `qd` per s and `qdd` per s^2."""
    qd: Array
    qdd: Array
    failure: tuple[str, ...] = ()
    """Why each is impossible, '' where it is not; () where none can be. The samples of an impossible one mean nothing."""

    @property
    def possible(self) -> Mask:
        """(B,) which of them can be performed."""
        if not self.failure:
            return np.ones(len(self.q), dtype=bool)
        return np.array([not reason for reason in self.failure])

    @property
    def duration(self) -> Array:
        """(B,) in s."""
        return self.time[:, -1] - self.time[:, 0]

    def single(self, row: int, joints: tuple[str, ...], name: str = "motion") -> Trajectory:
        """One of them. Raises RecordingError where it is impossible."""
        if self.failure and self.failure[row]:
            raise RecordingError(f"{name} is impossible: {self.failure[row]}")
        return Trajectory(name, joints, self.time[row], self.q[row], self.qd[row], self.qdd[row])


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One motion of n joints at S instants. Raises RecordingError where shapes disagree."""

    name: str
    joints: tuple[str, ...]
    time: Array
    """(S,) in s."""
    q: Array
    """(S, n) in rad (m), as `qd` per s and `qdd` per s^2."""
    qd: Array
    qdd: Array

    def __post_init__(self) -> None:
        """Checks the shapes."""
        shape = (len(self.time), len(self.joints))
        for name in ("q", "qd", "qdd"):
            if getattr(self, name).shape != shape:
                raise RecordingError(
                    f"{name} of trajectory '{self.name}' has shape {getattr(self, name).shape}, expected {shape}"
                )

    @property
    def duration(self) -> float:
        """In s."""
        return float(self.time[-1] - self.time[0])

    @property
    def rests(self) -> bool:
        """Whether it starts and ends at rest, to a thousandth of its own top speeds."""
        top = np.maximum(np.abs(self.qd).max(axis=0), ROUNDED)
        return bool((np.abs(self.qd[[0, -1]]) <= 1e-3 * top).all())

    def thinned(self, most: int) -> Trajectory:
        """Every so many-th of its samples, so that about `most` are left."""
        step = max(1, len(self.time) // most)
        return Trajectory(self.name, self.joints, *(x[::step] for x in (self.time, self.q, self.qd, self.qdd)))

    def slower(self, factor: float) -> Trajectory:
        """The same path in `factor` times the time: speeds fall by it, accelerations by its square."""
        time = self.time[0] + factor * (self.time - self.time[0])
        return Trajectory(self.name, self.joints, time, self.q, self.qd / factor, self.qdd / factor**2)

    def sampled(self, rate: float) -> Trajectory:
        """At `rate` Hz, by cubic interpolation that keeps position and speed."""
        from scipy.interpolate import CubicHermiteSpline

        time = np.linspace(self.time[0], self.time[-1], int(np.ceil(self.duration * rate)) + 1)
        way, speed = CubicHermiteSpline(self.time, self.q, self.qd), CubicHermiteSpline(self.time, self.qd, self.qdd)
        return Trajectory(self.name, self.joints, time, way(time), speed(time), speed(time, 1))

    def back(self) -> Trajectory:
        """The same path from its end to its start, as fast: speeds change their sign."""
        time = self.time[0] + self.time[-1] - self.time[::-1]
        return Trajectory(self.name, self.joints, time, self.q[::-1], -self.qd[::-1], self.qdd[::-1])

    def then(self, other: Trajectory) -> Trajectory:
        """This one and directly after it the other, whose first instant is this one's last (its first sample goes).

        Raises RecordingError where the other does not begin at the posture in which this one ends: no arm jumps.
        """
        gap, moved = np.abs(other.q[0] - self.q[-1]), np.abs(np.diff(self.q, axis=0)).max(axis=0)
        if (gap > PRINTED + moved).any():
            raise RecordingError(
                f"trajectory '{other.name}' begins {gap.max():.3g} rad from where '{self.name}' ends: arms do not jump"
            )
        time = np.concatenate([self.time, self.time[-1] + other.time[1:] - other.time[0]])
        q, qd, qdd = (np.concatenate([getattr(self, k), getattr(other, k)[1:]]) for k in ("q", "qd", "qdd"))
        return Trajectory(self.name, self.joints, time, q, qd, qdd)

    def recording(self, provenance: Mapping[str, str] | None = None) -> Recording:
        """As a recording with channels 'position', 'velocity' and 'acceleration'."""
        parts = {"position": ("rad", self.q), "velocity": ("rad/s", self.qd), "acceleration": ("rad/s^2", self.qdd)}
        channels = {k: Channel(k, self.joints, unit, self.time, values) for k, (unit, values) in parts.items()}
        return Recording(self.name, channels, dict(provenance or {}))
