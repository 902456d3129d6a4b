# SPDX-License-Identifier: Apache-2.0
"""A path: dense points in the plane with arc length, heading, curvature and target speed. Immutable."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trueup.arrays import Array
from trueup.errors import RecordingError, unknown_name
from trueup.paths.speed import SpeedLimits, speed_profile
from trueup.rounding import ROUNDED, first_step
from trueup.samples import between, way_along
from trueup.trial import Reference

SPACING = 0.05
"""Default distance between dense points, in m."""

LABELS = ("x", "y", "heading", "curvature", "speed")
_UNITS = ("m", "m", "rad", "1/m", "m/s")


@dataclass(frozen=True, eq=False)
class Path:
    """Dense points of a path, in the order of driving. Raises RecordingError where the arrays cannot be a path."""

    name: str
    points: Array
    """(N, 2) in m."""
    heading: Array
    """(N,) in rad, continuous (no jumps of a turn)."""
    curvature: Array
    """(N,) in 1/m, positive where the path turns left."""
    speed: Array
    """(N,) target speed in m/s, positive."""
    arc: Array
    """(N,) arc length from the first point, in m, along the straight pieces between points; made if empty."""

    def __post_init__(self) -> None:
        """Copies, checks and freezes the arrays."""
        points = np.array(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 2 or not np.isfinite(points).all():
            raise RecordingError(f"path '{self.name}' needs at least two finite points (N, 2); got {points.shape}")
        steps = np.hypot(*np.diff(points, axis=0).T)
        if (steps <= 0.0).any():
            raise RecordingError(f"path '{self.name}': points {steps.argmin()} and {steps.argmin() + 1} coincide")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "arc", np.concatenate([[0.0], np.cumsum(steps)]))
        for field in ("heading", "curvature", "speed"):
            values = np.array(getattr(self, field), dtype=np.float64)
            if values.shape != (len(points),) or not np.isfinite(values).all():
                raise RecordingError(f"path '{self.name}': {field} must be ({len(points)},) and finite")
            object.__setattr__(self, field, values)
        if (self.speed <= 0.0).any():
            raise RecordingError(
                f"path '{self.name}': target speed at point {self.speed.argmin()} is {self.speed.min():.3g} m/s; it must be "
                "positive: paths are driven forward and without a stop. Give each section that is as a path of its own"
            )
        for array in (self.points, self.heading, self.curvature, self.speed, self.arc):
            array.setflags(write=False)

    @classmethod
    def from_points(
        cls, name: str, points: ArrayLike, *, speed: ArrayLike | float = 0.5, limits: SpeedLimits | None = None,
        spacing: float = SPACING,
    ) -> Path:  # fmt: skip
        """From points (N, 2) in m joined by straight pieces, refilled at `spacing` m. Corners stay corners.

        `speed` (N,) or one number, in m/s, is what is wanted; `limits` lower it where curves or accelerations forbid it.
        """
        given = np.asarray(points, dtype=np.float64)
        if given.ndim != 2 or given.shape[1:] != (2,):
            raise RecordingError(f"path '{name}' needs points (N, 2); got an array of {given.shape}")
        keep = np.concatenate([[True], np.hypot(*np.diff(given, axis=0).T) > ROUNDED])
        wanted = np.broadcast_to(np.asarray(speed, dtype=np.float64), (len(given),))[keep]
        given = given[keep]
        if len(given) < 2 or not np.isfinite(given).all():
            raise RecordingError(f"path '{name}' needs at least two different finite points")
        arc = way_along(given)
        dense = _refilled(arc, spacing)
        xy = between(dense, arc, given)
        return cls.from_dense(name, xy, np.interp(dense, arc, wanted), limits=limits)

    @classmethod
    def from_spline(
        cls, name: str, waypoints: ArrayLike, *, speed: float = 0.5, limits: SpeedLimits | None = None,
        spacing: float = SPACING, closed: bool = False,
    ) -> Path:  # fmt: skip
        """A cubic spline through waypoints (N, 2) in m, by chord length; `closed`: the last leads back to the first."""
        from scipy.interpolate import CubicSpline

        given = np.asarray(waypoints, dtype=np.float64)
        if given.ndim != 2 or given.shape[1:] != (2,) or len(given) < 3 or not np.isfinite(given).all():
            raise RecordingError(f"path '{name}': a spline needs at least three finite waypoints (N, 2)")
        if closed:
            given = np.concatenate([given, given[:1]])
        chord = way_along(given)
        if (np.diff(chord) <= 0.0).any():
            raise RecordingError(f"path '{name}': two waypoints in a row coincide")
        curve = CubicSpline(chord, given, bc_type="periodic" if closed else "natural")
        fine = curve(np.linspace(0.0, chord[-1], max(200, int(20 * chord[-1] / spacing))))
        return cls.from_points(name, fine, speed=speed, limits=limits, spacing=spacing)

    @classmethod
    def from_dense(
        cls, name: str, points: Array, speed: ArrayLike | float, *, heading: Array | None = None,
        curvature: Array | None = None, limits: SpeedLimits | None = None,
    ) -> Path:  # fmt: skip
        """From points (N, 2) that are dense already; heading and curvature by central differences unless they are given."""
        steps = np.hypot(*np.diff(points, axis=0).T)
        arc = np.concatenate([[0.0], np.cumsum(steps)])
        if heading is None:
            pieces = np.unwrap(np.arctan2(*np.diff(points, axis=0).T[::-1]))
            # At a point: the mean of the pieces that meet there, the shorter one counting more (it is nearer).
            inner = (pieces[:-1] * steps[1:] + pieces[1:] * steps[:-1]) / (steps[1:] + steps[:-1])
            heading = np.concatenate([pieces[:1], inner, pieces[-1:]])
        bend = np.asarray(np.gradient(heading, arc) if curvature is None else curvature, dtype=np.float64)
        wanted = np.array(np.broadcast_to(np.asarray(speed, dtype=np.float64), (len(points),)))
        if limits is not None:
            wanted = speed_profile(arc, bend, wanted, limits)
        return cls(name, points, np.asarray(heading, dtype=np.float64), bend, wanted, arc)

    @classmethod
    def of(cls, reference: Reference, name: str = "path") -> Path:
        """The path that a trial's reference holds. Raises UnknownNameError where x or y is missing."""
        for label in ("x", "y"):
            if label not in reference.labels:
                raise unknown_name("column", label, reference.labels, f"the reference '{name}'")
        columns = {label: reference.values[:, k] for k, label in enumerate(reference.labels)}
        points = np.stack([columns["x"], columns["y"]], axis=1)
        if all(label in columns for label in LABELS):
            return cls(name, points, columns["heading"], columns["curvature"], columns["speed"], np.zeros(0))
        return cls.from_points(name, points, speed=columns.get("speed", 0.5))

    def reference(self) -> Reference:
        """The same as a table for `Trial.references`."""
        columns = (*self.points.T, self.heading, self.curvature, self.speed)
        return Reference(LABELS, _UNITS, np.stack(columns, axis=1))

    @property
    def length(self) -> float:
        """In m."""
        return float(self.arc[-1])

    @property
    def duration(self) -> float:
        """Time to drive it at its target speed, in s."""
        return float(np.sum(np.diff(self.arc) * 2.0 / (self.speed[1:] + self.speed[:-1])))

    def replace(self, **changes: Any) -> Path:
        """A copy with some fields changed; checked like a new one."""
        fields = {f: getattr(self, f) for f in ("name", "points", "heading", "curvature", "speed", "arc")}
        return Path(**{**fields, **changes})

    def limited(self, limits: SpeedLimits) -> Path:
        """The same path, slower where `limits` demand it."""
        return self.replace(speed=speed_profile(self.arc, self.curvature, self.speed, limits))

    def at(self, arc: ArrayLike) -> tuple[Array, Array]:
        """Points (n, 2) in m and headings (n,) in rad at arc lengths (n,) in m, clipped to the path."""
        s = np.atleast_1d(np.asarray(arc, dtype=np.float64))
        points = between(s, self.arc, self.points)
        return points, np.interp(s, self.arc, self.heading)


def _refilled(arc: Array, spacing: float) -> Array:
    """Arc lengths at which to place points: all the given ones, and between them at most `spacing` apart."""
    pieces = [np.linspace(a, b, max(1, first_step(b - a, spacing)), endpoint=False) for a, b in pairwise(arc.tolist())]
    return np.concatenate([*pieces, arc[-1:]])
