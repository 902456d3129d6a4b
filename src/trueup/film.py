# SPDX-License-Identifier: Apache-2.0
"""A robot in motion as plain numbers, for pictures: what its bodies look like, and where they were."""

from __future__ import annotations

from dataclasses import dataclass

from trueup.arrays import Array


@dataclass(frozen=True, eq=False)
class Shape:
    """The convex hull of points (n, 3) in its body's frame, thickened by `radius`, in m (of a capsule's two points)."""

    body: int
    points: Array
    radius: float
    colour: tuple[float, float, float]
    """Red, green, blue from 0 to 1."""


@dataclass(frozen=True, eq=False)
class Film:
    """One run. Body 0 is the world: what does not move has its shapes there."""

    name: str
    """What is shown: 'simulation', 'robot'."""
    shapes: tuple[Shape, ...]
    time: Array
    """(T,) in s since the run's start."""
    position: Array
    """(T, n, 3) of each body, in m."""
    orientation: Array
    """(T, n, 4) w, x, y, z."""
    floor: float | None
    """Height of the floor in m; None where there is none."""
    followed: int
    """The body that a view keeps in its middle."""
