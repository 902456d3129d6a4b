# SPDX-License-Identifier: Apache-2.0
"""Speeds and turn rates of which no word says whether they were commanded: those that the motion follows were.

A message of ROS for either (`Twist`: linear.x, angular.z) looks the same; but robots move after they are told to, and
are measured no sooner than they move.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.errors import RecordingError
from trueup.formats.mapping import TimeColumn
from trueup.formats.rules.names import PLAINLY_MEASURED, listed
from trueup.formats.rules.rule import Column
from trueup.formats.rules.sizes import instants_of, speed_of, usable
from trueup.formats.rules.vehicles import Signal
from trueup.inspection.alignment import LONGEST, averaged, lag
from trueup.inspection.relations import rate
from trueup.instant import usual_step
from trueup.recording import Channel
from trueup.rounding import NEGLIGIBLE, PRINTED
from trueup.samples import MOSTLY

_MEASURED = PLAINLY_MEASURED | listed(
    "odom odometry encoder wheel wheels imu gyro sensor sensors vicon mocap optitrack gps gnss truth gt est estimated "
    "estimate state vesc slam amcl ekf ukf pf"
)
"""Sources of what was measured."""


def leading(
    speeds: Sequence[Signal],
    turns: Sequence[Signal],
    place: Sequence[Signal],
    heading: Sequence[Signal],
    time: TimeColumn,
) -> tuple[Signal, Signal | None, float] | None:
    """A speed, the turn rate of its source if there is one, and by how many seconds the motion follows them; None where
    it follows none by more than half a sample.

    `place` are x and y, `heading` an angle, or z and w of a quaternion; empty where nothing tells it.
    """
    moved, turned = along(place, time), turning(heading, time)
    for speed in speeds:
        turn = next((w for w in turns if w.source == speed.source), None)
        if speed.source & _MEASURED or speed.column.clock or moved is None:
            continue
        behind = [
            late for signal, motion in ((speed, moved), (turn, turned))
            if signal is not None and motion is not None and (late := follows(signal, motion, time)) is not None
        ]  # fmt: skip
        if behind and max(behind) > 0.5 * usual_step(moved.time):
            return speed, turn, max(behind)
    return None


def follows(told: Signal, motion: Channel, time: TimeColumn) -> float | None:
    """How late a motion is behind a signal, in s; None where that is not to be told."""
    values = np.abs(told.column.values) if told.kind == "speed" else told.column.values
    return lateness(told.column, values, motion, time)


def lateness(column: Column, values: Array, motion: Channel, time: TimeColumn) -> float | None:
    """How late a motion is behind values (T,) at the instants of a column, in s; None where that is not to be told."""
    instants = instants_of(column, time)
    if not len(instants):
        return None
    good = usable(instants, values)
    if np.count_nonzero(good) < len(instants) // 2:
        return None
    try:
        return lag(averaged(instants[good], values[good]), motion, longest=LONGEST)
    except RecordingError:
        return None


def along(place: Sequence[Signal], time: TimeColumn) -> Channel | None:
    """The speed along x and y; None where these do not tell it."""
    if not place:
        return None
    (when, one), (other_when, other) = (speed_of(s.column, time) for s in place)
    if not len(one) or not len(other):
        return None
    return averaged(when, np.hypot(one, np.interp(when, other_when, other)))


def ahead(place: Sequence[Signal], heading: Sequence[Signal], time: TimeColumn) -> Channel | None:
    """The speed where a heading points, in rad or degrees, negative backwards; None where the robot does not drive there."""
    angles = _angles(heading, time)
    if not place or angles is None:
        return None
    instants, turned = angles
    (when, x), (other_when, other) = (speed_of(s.column, time) for s in place)
    if not len(x) or not len(other):
        return None
    y, shares = np.interp(when, other_when, other), {}
    for unit in (1.0, math.radians(1.0)):
        psi = unit * np.interp(when, instants, turned)
        on, beside = (averaged(when, v) for v in (x * np.cos(psi) + y * np.sin(psi), y * np.cos(psi) - x * np.sin(psi)))
        ways = np.sum(on.values**2), np.sum(beside.values**2)
        shares[ways[0] / max(sum(ways), NEGLIGIBLE)] = on
    return shares[max(shares)] if max(shares) > MOSTLY else None  # else the heading is any other angle


def turning(heading: Sequence[Signal], time: TimeColumn) -> Channel | None:
    """How fast a heading turns, in whatever unit."""
    angles = _angles(heading, time)
    if angles is None:
        return None
    when, turned = rate(angles[1], angles[0])
    return averaged(when, turned)


def _angles(heading: Sequence[Signal], time: TimeColumn) -> tuple[Array, Array] | None:
    """Instants and a heading that does not jump, in its unit; None where there is none at half of the instants."""
    columns = [signal.column for signal in heading]
    instants = instants_of(columns[0], time) if columns else np.zeros(0)
    if not len(instants) or any(len(instants_of(c, time)) != len(instants) for c in columns):
        return None
    angles = columns[0].values if len(columns) == 1 else 2.0 * np.arctan2(*(c.values for c in columns))
    good = usable(instants, angles)
    if np.count_nonzero(good) < len(instants) // 2:
        return None
    turn = math.degrees(math.tau) if np.abs(angles[good]).max() > math.tau * (1.0 + PRINTED) else math.tau
    return instants[good], np.unwrap(angles[good], period=turn)
