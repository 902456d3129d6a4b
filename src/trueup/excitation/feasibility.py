# SPDX-License-Identifier: Apache-2.0
"""Whether an arm can perform a trajectory: range, speed, acceleration, torque, rest at both ends, collision, region."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.excitation.cell import Cell
from trueup.excitation.limits import JointLimits
from trueup.excitation.trajectories import SAMPLED, Trajectory
from trueup.identification.dynamic_model import DynamicModel
from trueup.instant import STILL
from trueup.rounding import NEGLIGIBLE, PRINTED
from trueup.samples import between, rms

_SLOWER = tuple(2.0 ** (k / 4) for k in range(9))


class Clearance(Protocol):
    """Tells how far the parts of an arm are from each other and from the floor."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What is checked, what is not, and which shapes are only estimated."""
        ...

    def distances(self, q: Array) -> tuple[Array, tuple[str, ...]]:
        """(S,) least distance [m] at postures q (S, n), negative where parts overlap; and which two parts they are."""
        ...

    def shapes(self) -> tuple[NDArray[Any], ...]:
        """What is checked as capsules and boxes, in the order of `trueup.excitation.proximity.Proxies`."""
        ...

    def reach(self) -> Array:
        """(n,) by how many m any two parts may come nearer when a joint moves by one rad (or one m)."""
        ...


@dataclass(frozen=True)
class Problem:
    """One limit that a trajectory breaks."""

    kind: str
    """'range', 'speed', 'acceleration', 'torque', 'root mean square torque', 'rest', 'collision' or 'region'."""
    where: str
    """The joint, or the two parts that meet."""
    value: float
    limit: float
    time: float
    """s at which it is worst."""
    unit: str

    def __str__(self) -> str:
        if self.kind == "collision":
            far = "overlap" if self.value < 0 else "come as near as"
            least = f"at least {100 * self.limit:.1f} cm"
            return f"{self.where} {far} {100 * abs(self.value):.1f} cm at {self.time:.2f} s ({least})"
        return f"{self.kind} of {self.where} {self.value:.4g} {self.unit} at {self.time:.2f} s (limit {self.limit:.4g})"


@dataclass(frozen=True, eq=False)
class Feasibility:
    """What a trajectory is held against; what is None is not checked."""

    limits: JointLimits
    clearance: Clearance | None = None
    margin: float = 0.02
    """m that parts must keep from each other."""
    model: DynamicModel | None = None
    parameters: Array | None = None
    """(p,) of the model, for the torque."""
    cell: Cell | None = None
    leeway: float = 0.0
    """m by which the tool may leave the box."""

    def problems(self, trajectory: Trajectory) -> tuple[Problem, ...]:
        """All limits that a trajectory breaks, worst moment of each; () if it can be performed."""
        return (*self.joint_problems(trajectory), *self._ends(trajectory), *self.space_problems(trajectory))

    def joint_problems(self, trajectory: Trajectory) -> tuple[Problem, ...]:
        """Range, speed, acceleration and torque of each joint, at every sample."""
        t, limits = trajectory, self.limits
        found = _over("range", "rad", t, np.abs(t.q - limits.middle), limits.half, shown=t.q)
        found += _over("speed", "rad/s", t, np.abs(t.qd), limits.speed)
        found += _over("acceleration", "rad/s^2", t, np.abs(t.qdd), limits.acceleration)
        if (torque := self.torque(t)) is not None:
            most, nominal = (np.where(np.isnan(x), np.inf, x) for x in (limits.peak, limits.torque))
            found += _over("torque", "N m", t, np.abs(torque), most)
            lasting = np.broadcast_to(rms(torque), torque.shape)
            found += _over("root mean square torque", "N m", t, lasting, nominal)
        return tuple(found)

    def space_problems(self, trajectory: Trajectory) -> tuple[Problem, ...]:
        """Collision and region, at postures no further apart than 0.02 rad in any joint."""
        time, q = spread(trajectory)
        found = []
        if self.clearance is not None:
            distance, parts, k = self.nearest(q)
            if distance < self.margin:
                found.append(Problem("collision", parts, distance, self.margin, float(time[k]), "m"))
        if self.cell is not None:
            box = self.cell.region
            outside = (np.abs(self.cell.chain.poses(q)[1] - box.centre) - 0.5 * box.size).max(axis=1)
            k = int(np.argmax(outside))
            if outside[k] > self.leeway + PRINTED:
                found.append(Problem("region", "tool outside", float(outside[k]), self.leeway, float(time[k]), "m"))
        return tuple(found)

    def nearest(self, q: Array, enough: float | None = None) -> tuple[float, str, int]:
        """The least distance [m] along neighbouring postures q (S, n), between which parts, and at which posture.

        A posture from which no part can have come as near as the least distance so far is skipped: no two parts approach
        faster than `Clearance.reach` allows. With `enough` it ends at the first distance below.
        """
        if self.clearance is None:
            return np.inf, "", 0
        way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)) @ self.clearance.reach())])
        best, parts, at, s = np.inf, "", 0, 0
        while s < len(q):
            distance, names = self.clearance.distances(q[s : s + 1])
            if distance[0] < best:
                best, parts, at = float(distance[0]), names[0], s
                if enough is not None and best < enough:
                    break
            least = best if enough is None else min(best, enough)
            s = max(s + 1, int(np.searchsorted(way, way[s] + float(distance[0]) - least)))
        return best, parts, at

    def slowed(self, motion: Trajectory) -> Trajectory | None:
        """The motion, slower where its torque asks for that; None where it collides, leaves the region or takes too much."""
        slower = self.within_torque(motion)
        if any(p.kind != "acceleration" for p in self.joint_problems(slower)):
            return None
        _, q = spread(slower)
        if self.cell is not None and not self.cell.region.holds(self.cell.chain.poses(q)[1], self.leeway).all():
            return None
        return slower if self.clearance is None or self.nearest(q, enough=self.margin)[0] >= self.margin else None

    def within_torque(self, motion: Trajectory) -> Trajectory:
        """The motion as fast as its torque allows, down to a quarter of its speed: dynamic torque falls with its square.

        As it is, where that does not help.
        """
        few = motion.thinned(SAMPLED)
        if self._strong(few.slower(_SLOWER[-1])):
            rate = (len(motion.time) - 1) / motion.duration
            for factor in _SLOWER:
                slower = motion if factor == 1.0 else motion.slower(factor)
                if self._strong(few.slower(factor)) and self._strong(slower):
                    return slower if factor == 1.0 else slower.sampled(rate)
        return motion

    def _strong(self, motion: Trajectory) -> bool:
        """Whether the drives are strong enough for it."""
        return not any("torque" in p.kind for p in self.joint_problems(motion))

    def clear_way(self, start: Array, end: Array) -> bool:
        """Whether the straight way of the joints from one posture to another meets nothing."""
        if self.clearance is None:
            return True
        count = int(np.ceil(np.abs(end - start).max() / STILL)) + 2
        return self.nearest(np.linspace(start, end, count), enough=self.margin)[0] >= self.margin

    def torque(self, trajectory: Trajectory) -> Array | None:
        """(S, n) torque of the model at its parameters; None where it has none."""
        if self.model is None or self.parameters is None:
            return None
        return self.model.regressor(trajectory.q, trajectory.qd, trajectory.qdd) @ self.parameters

    def _ends(self, trajectory: Trajectory) -> tuple[Problem, ...]:
        if trajectory.rests:
            return ()
        moving = np.abs(trajectory.qd[[0, -1]]).max(axis=0)
        joint = int(np.argmax(moving))
        return (Problem("rest", trajectory.joints[joint], float(moving[joint]), 0.0, 0.0, "rad/s"),)


def spread(trajectory: Trajectory) -> tuple[Array, Array]:
    """Instants (s,) and postures (s, n) of a trajectory such that no joint moves further than `STILL` in between."""
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(trajectory.q, axis=0)).max(axis=1))])
    count = max(2, int(np.ceil(way[-1] / STILL)) + 1)
    time = np.interp(np.linspace(0.0, way[-1], count), way + NEGLIGIBLE * np.arange(len(way)), trajectory.time)
    return time, between(time, trajectory.time, trajectory.q)


def _over(
    kind: str, unit: str, trajectory: Trajectory, values: Array, limits: Array, shown: Array | None = None
) -> list[Problem]:
    found = []
    for j in np.flatnonzero((values > limits * (1.0 + PRINTED)).any(axis=0)):
        k = int(np.argmax(values[:, j]))
        value = float((values if shown is None else shown)[k, j])
        limit = float(limits[j])
        found.append(Problem(kind, trajectory.joints[j], value, limit, float(trajectory.time[k]), unit))
    return found
