# SPDX-License-Identifier: Apache-2.0
"""Courses to drive: the 14 m x 2 m hairpin circuit of the Stanley study, and others to train on or to hold out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from trueup.paths.path import SPACING, Path
from trueup.paths.speed import SpeedLimits
from trueup.rounding import first_step

LIMITS = SpeedLimits(lateral=0.9, acceleration=0.25, deceleration=0.25, highest=1.0, start=0.1, stop=0.1)
"""For a carrying robot of 50 kg at walking pace."""

LAPS = (0.4, 0.68, 0.95)
"""Cruising speed of the three laps, in m/s: one in each of the controller's three ranges."""

Piece = tuple[float, float]
"""Length in m and curvature in 1/m."""


def from_pieces(name: str, laps: Sequence[tuple[Sequence[Piece], float]], limits: SpeedLimits = LIMITS) -> Path:
    """Straights and arcs one after the other, from the origin along x; `laps`: pieces and their speed in m/s.

    Heading and curvature are exact: nothing is smoothed.
    """
    x, y, heading = 0.0, 0.0, 0.0
    points, headings, curvatures, speeds = [(x, y)], [heading], [laps[0][0][0][1]], [laps[0][1]]
    for pieces, speed in laps:
        for length, curvature in pieces:
            count = max(1, first_step(length, SPACING))
            for s in (np.arange(1, count + 1) * (length / count)).tolist():
                dx, dy = _along(s, curvature)
                points.append((x + dx * math.cos(heading) - dy * math.sin(heading),
                               y + dx * math.sin(heading) + dy * math.cos(heading)))  # fmt: skip
                headings.append(heading + curvature * s)
                curvatures.append(curvature)
                speeds.append(speed)
            (x, y), heading = points[-1], headings[-1]
    exact = {"heading": np.array(headings), "curvature": np.array(curvatures)}
    return Path.from_dense(name, np.array(points), np.array(speeds), **exact, limits=limits)


def hairpin(laps: Sequence[float] = LAPS, *, limits: SpeedLimits = LIMITS) -> Path:
    """The circuit of the Stanley study: two straights joined by two half circles, one lap for each speed (m/s).

    The paper shows a 14 m x 2 m area, two straights, two sharp curves and 170 s a run, without speeds; 12 m and 1 m fill
    the area, and three laps at these speeds take 150 s (a robot that is slower than commanded still finishes in 170 s)
    and use each of its three speed ranges. Laps begin in the middle of a straight: both curves are at the lap's speed.
    """
    half = (math.pi, 1.0)
    lap = [(6.0, 0.0), half, (12.0, 0.0), half, (6.0, 0.0)]
    return from_pieces("hairpin", [(lap, speed) for speed in laps], limits)


def figure_eight() -> Path:
    """A left circle, then a right one, for each speed."""
    radius = 1.6
    turn = 2.0 * math.pi * radius
    lap = [(turn, 1.0 / radius), (turn, -1.0 / radius)]
    return from_pieces("figure_eight", [([(1.0, 0.0)], LAPS[0]), *((lap, v) for v in LAPS), ([(1.0, 0.0)], LAPS[-1])])


def rounded_rectangle() -> Path:
    """A rectangle of 5 m by 3 m with rounded corners, driven to the right."""
    corner = (0.5 * math.pi, -1.0)
    lap = [p for side in (5.0, 3.0, 5.0, 3.0) for p in ((side, 0.0), corner)]
    return from_pieces("rounded_rectangle", [*((lap, v) for v in LAPS), ([(1.0, 0.0)], LAPS[-1])])


def chicane() -> Path:
    """Lane changes left and right by arcs of 60 degrees, with straights in between."""
    radius = 1.2
    arc = math.radians(60.0) * radius
    left, right = (arc, 1.0 / radius), (arc, -1.0 / radius)
    lap = [(2.0, 0.0), left, right, (2.0, 0.0), right, left]
    return from_pieces("chicane", [*((lap * 2, v) for v in LAPS), ([(1.0, 0.0)], LAPS[-1])])


def slalom() -> Path:
    """Swings left and right without a straight in between: arcs of 100 degrees."""
    radius = 1.5
    arc = math.radians(100.0) * radius
    swing = [(0.5 * arc, 1.0 / radius), (arc, -1.0 / radius), (0.5 * arc, 1.0 / radius)]
    return from_pieces("slalom", [([(1.0, 0.0)], LAPS[0]), *((swing * 3, v) for v in LAPS)])


def loops() -> Path:
    """A smooth closed curve with bends of many radii, for each speed."""
    angle = np.linspace(0.0, 2.0 * math.pi, 41)[:-1]
    reach = 2.6 + 0.35 * np.cos(3.0 * angle)
    lap = np.stack([1.4 * reach * np.cos(angle), reach * np.sin(angle)], axis=1)
    smooth = Path.from_spline("loops", np.concatenate([np.tile(lap, (len(LAPS), 1)), lap[:1]]))
    speeds = np.asarray(LAPS)[np.minimum((smooth.arc / smooth.length * len(LAPS)).astype(int), len(LAPS) - 1)]
    return smooth.replace(speed=speeds).limited(LIMITS)


COURSES: Mapping[str, Callable[[], Path]] = MappingProxyType(
    {
        "hairpin": hairpin,
        "figure_eight": figure_eight,
        "rounded_rectangle": rounded_rectangle,
        "chicane": chicane,
        "slalom": slalom,
        "loops": loops,
    }
)
"""Name to course, for plans."""


def _along(s: float, curvature: float) -> tuple[float, float]:
    """Where a piece that starts at the origin along x is after s m."""
    if curvature == 0.0:
        return s, 0.0
    return math.sin(curvature * s) / curvature, (1.0 - math.cos(curvature * s)) / curvature
