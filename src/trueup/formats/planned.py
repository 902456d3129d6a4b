# SPDX-License-Identifier: Apache-2.0
"""ROS trajectories as the controller follows them: from where it is to each point at its time, until the next message."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.formats.messages import seconds_of
from trueup.samples import between
from trueup.units import size_of

KIND = "/JointTrajectory"
RATE = 100.0
"""Hz of what is written out, of plans read and of plans written: controllers interpolate between at their own rate."""


@dataclass(frozen=True, eq=False)
class Plan:
    """One message: points to pass after its start."""

    start: float
    """In s, on the clock of the bag."""
    joints: tuple[str, ...]
    after: Array
    """(n,) s from the start, increasing."""
    positions: Array
    """(n, k)."""
    velocities: Array | None
    """(n, k); None where the message has none: then it is followed on straight lines."""
    stamped: float | None = None
    """Its header's time in s; None for one that says: from now on."""
    received: float = 0.0

    def later(self, ahead: float) -> Plan:
        """The same plan with its header on a clock that is ahead by so many seconds."""
        return self if self.stamped is None else replace(self, start=self.start + ahead)

    def in_order(self, joints: Sequence[str]) -> Plan:
        """The same plan with its joints in this order."""
        columns = [self.joints.index(joint) for joint in joints]
        velocities = None if self.velocities is None else self.velocities[:, columns]
        return replace(self, joints=tuple(joints), positions=self.positions[:, columns], velocities=velocities)


def plan_of(message: Any, received: float, stamp: float | None) -> Plan | None:
    """The plan in a trajectory_msgs/JointTrajectory; None where it holds no positions for its joints.

    A header of zero means: from now on.
    """
    joints = tuple(message.joint_names)
    points = [p for p in message.points if joints and len(p.positions) == len(joints)]
    if not points:
        return None
    after = np.array([seconds_of(p.time_from_start) for p in points])
    later = np.concatenate([[True], np.diff(np.maximum.accumulate(after)) > 0.0])
    moving = all(len(p.velocities) == len(joints) for p in points)
    velocities = np.array([p.velocities for p in points])[later] if moving else None
    positions = np.array([p.positions for p in points])[later]
    return Plan(received if stamp is None else stamp, joints, after[later], positions, velocities, stamp, received)


def followed(plans: Sequence[Plan], measured: Callable[[float], Array | None]) -> tuple[Array, Array]:
    """(m,) s and (m, k): what the joints were to do, at 100 Hz while a plan is followed; held in between.

    Each plan takes over at its start from where the one before it was, the first from `measured` at that time (None:
    not known). Through points with velocities the way is a cubic, as ros2_control has it.
    """
    times: list[Array] = []
    values: list[Array] = []
    ordered = sorted(plans, key=lambda p: p.start)
    at = measured(ordered[0].start)
    speed = np.zeros(len(ordered[0].joints))
    for plan, following in zip(ordered, [*ordered[1:], None], strict=True):
        knots, points, slopes = _with_begin(plan, at, speed)
        end = knots[-1] if following is None else min(knots[-1], following.start - plan.start)
        instants = np.append(np.arange(knots[0], end, 1.0 / RATE), max(end, knots[0]))
        times.append(plan.start + instants)
        values.append(_passed(instants, knots, points, slopes))
        at = values[-1][-1]
        cut_off = end < knots[-1] and len(instants) > 2
        speed = (values[-1][-2] - values[-1][-3]) * RATE if cut_off else np.zeros(len(plan.joints))
    time, row = np.concatenate(times), np.concatenate(values)
    order = np.argsort(time, kind="stable")
    last_of = np.append(
        np.diff(time[order]) > size_of("ns"), True
    )  # where one plan ends as the next begins, the next counts
    return time[order][last_of], row[order][last_of]


def _with_begin(plan: Plan, begin: Array | None, speed: Array) -> tuple[Array, Array, Array | None]:
    """Knots, points and slopes of a plan that starts where its joints are, unless its first point is for now."""
    if begin is None or plan.after[0] <= 0.0:
        return plan.after, plan.positions, plan.velocities
    slopes = plan.velocities
    if slopes is not None:
        slopes = np.concatenate([[speed], slopes])
    return np.append(0.0, plan.after), np.concatenate([[begin], plan.positions]), slopes


def _passed(instants: Array, knots: Array, points: Array, slopes: Array | None) -> Array:
    """(m, k) on the way through the points: straight, or on cubics with these slopes (Hermite)."""
    if slopes is None or len(knots) < 2:
        return between(instants, knots, points)
    i = np.clip(np.searchsorted(knots, instants, side="right") - 1, 0, len(knots) - 2)
    length = (knots[i + 1] - knots[i])[:, None]
    x = np.clip((instants - knots[i])[:, None] / length, 0.0, 1.0)
    return (
        (1.0 + 2.0 * x) * (1.0 - x) ** 2 * points[i] + x * (1.0 - x) ** 2 * length * slopes[i]
        + x**2 * (3.0 - 2.0 * x) * points[i + 1] + x**2 * (x - 1.0) * length * slopes[i + 1]
    )  # fmt: skip
