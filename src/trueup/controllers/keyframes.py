# SPDX-License-Identifier: Apache-2.0
"""Motions by sparse keyframes: poses and the times between them are searched, the first and the last pose are given.

J. Tan, Z. Xie, B. Boots and C. K. Liu, "Simulation-based design of dynamic controllers for humanoid balancing", IROS 2016,
section V-A: keyframes at free times, linear between them, symmetric legs. Smooth motions, and feedback from the torso's
tilt (their future work), are additions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from trueup.arrays import Array
from trueup.articulated.pose import angles_of
from trueup.controllers.controller import Observation
from trueup.errors import ParameterError, unknown_name
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel
from trueup.rounding import ROUNDED

INTERPOLATIONS = ("linear", "smooth")
_PEAK = {"linear": 1.0, "smooth": 1.5}
"""Largest speed between two poses over the mean one (of a cubic from rest to rest)."""

Tilt = Callable[[Observation], tuple[Array, Array]]
"""From an observation: how far the torso is tilted forward (b,) in rad, and how fast that grows (b,) in rad/s."""


@dataclass(frozen=True)
class Degree:
    """One searched angle of a pose, shared by joints on both sides; `signs` are -1 where a side turns the other way."""

    name: str
    joints: tuple[str, ...]
    signs: tuple[float, ...] = ()

    def sign(self, i: int) -> float:
        """The factor of joint i."""
        return self.signs[i] if self.signs else 1.0


@dataclass(frozen=True, eq=False)
class Motion:
    """What is known of a motion before its search. Arrays over joints are (k,), in rad, in the order of `joints`.

    Raises ParameterError for arrays that do not fit and for a keyframe beyond its joint's range, UnknownNameError for a
    degree of a joint that is not commanded.
    """

    joints: tuple[str, ...]
    """All that are commanded, in the order in which the robot takes its commands."""
    first: Array
    last: Array
    degrees: tuple[Degree, ...]
    """What is searched of the poses between; joints that no degree names go evenly from first to last."""
    seeds: Array
    """(n, d) the degrees' nominal angles at the keyframes between, in rad; (0, d) where only the time is searched."""
    intervals: Array
    """(n + 1,) nominal times from one keyframe to the next, in s."""
    lower: Array
    upper: Array
    """Range of each joint."""
    reach: float = 0.7
    """Half width of the search around the seeds, in rad."""
    shortest: float = 0.05
    longest: float = 0.8
    """Of an interval, in s."""
    interpolation: str = "linear"
    """'linear' (the paper), or 'smooth': through all keyframes with continuous speed, from rest to rest."""
    feedback: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Degree to the largest gains that are searched on top of the motion: rad per rad of tilt, rad per rad/s."""
    speeds: Array | None = None
    """(k,) what each joint's servo can do, in rad/s: intervals that ask for more are stretched."""

    def __post_init__(self) -> None:
        """Checks shapes, names and ranges."""
        if self.interpolation not in INTERPOLATIONS:
            raise unknown_name("interpolation", self.interpolation, INTERPOLATIONS, "what keyframes know")
        k, names = len(self.joints), [d.name for d in self.degrees]
        for name in ("first", "last", "lower", "upper"):
            if np.shape(getattr(self, name)) != (k,):
                raise ParameterError(f"{name} has shape {np.shape(getattr(self, name))}; {k} joints are commanded")
        if np.shape(self.seeds)[1:] != (len(names),) or len(self.intervals) != len(self.seeds) + 1:
            raise ParameterError(
                f"seeds of shape {np.shape(self.seeds)} and {len(self.intervals)} intervals: {len(names)} degrees need "
                "(n, degrees) seeds and n + 1 intervals"
            )
        for degree in self.degrees:
            for joint in degree.joints:
                if joint not in self.joints:
                    raise unknown_name("joint", joint, self.joints, f"what is commanded (degree '{degree.name}')")
        for name in self.feedback:
            if name not in names:
                raise unknown_name("degree", name, names, "this motion")
        self._check_speeds()
        for number, pose in enumerate(self.knots(self.nominal[None])[0][0]):
            for joint, value, low, high in zip(self.joints, pose, self.lower, self.upper, strict=True):
                if not low <= value <= high:
                    raise ParameterError(
                        f"keyframe {number}: joint '{joint}' at {value:.4g} rad is outside its range "
                        f"{low:.4g} ... {high:.4g} rad"
                    )

    @property
    def nominal(self) -> Array:
        """(m,) seeds, intervals and no feedback."""
        return np.concatenate([np.ravel(self.seeds), self.intervals, np.zeros(2 * len(self.feedback))])

    def parameters(self) -> ParameterSpace:
        """What is searched: 'keyframe1.thigh' in rad, 'interval1' in s, 'feedback.heel.tilt', 'feedback.heel.rate' in s."""
        rows = []
        for number, seeds in enumerate(self.seeds, 1):
            for degree, seed in zip(self.degrees, seeds, strict=True):
                low, high = self._range(degree)
                low, high = max(low, seed - self.reach), min(high, seed + self.reach)
                rows.append(Parameter(f"keyframe{number}.{degree.name}", "rad", float(seed), low, high))
        for number, interval in enumerate(self.intervals, 1):
            rows.append(Parameter(f"interval{number}", "s", float(interval), self.shortest, self.longest, scale="log"))
        for name, (tilt, rate) in self.feedback.items():
            rows.append(Parameter(f"feedback.{name}.tilt", "1", 0.0, -tilt, tilt))
            rows.append(Parameter(f"feedback.{name}.rate", "s", 0.0, -rate, rate))
        return ParameterSpace(tuple(rows))

    def knots(self, values: Array) -> tuple[Array, Array]:
        """(b, n + 2, k) poses in rad and (b, n + 2) times in s, from 0, of values (b, m)."""
        n, d = np.shape(self.seeds)
        searched = values[:, : n * d].reshape(len(values), n, d)
        intervals = values[:, n * d : n * d + n + 1]
        times = np.concatenate([np.zeros((len(values), 1)), intervals.cumsum(axis=1)], axis=1)
        share = (times / times[:, -1:])[:, :, None]
        poses = (1.0 - share) * self.first + share * self.last
        poses[:, 0], poses[:, -1] = self.first, self.last
        for column, degree in enumerate(self.degrees):
            for i, joint in enumerate(degree.joints):
                poses[:, 1:-1, self.joints.index(joint)] = degree.sign(i) * searched[:, :, column]
        if self.speeds is not None:
            times[:, 1:] = np.maximum(intervals, self._least(poses)).cumsum(axis=1)
        return poses, times

    def arrivals(self, values: Array) -> Array:
        """(b,) when motions of values (b, m) reach their last pose, in s."""
        if self.speeds is not None:
            return self.knots(values)[1][:, -1]
        first = np.size(self.seeds)
        return values[:, first : first + len(self.intervals)].sum(axis=1)

    @property
    def latest(self) -> float:
        """When the slowest motion arrives, in s."""
        stretched = 0.0
        if self.speeds is not None:
            stretched = float((_PEAK[self.interpolation] * (self.upper - self.lower) / self.speeds).max())
        return len(self.intervals) * max(self.longest, stretched)

    def _least(self, poses: Array) -> Array:
        """(b, n + 1) shortest times in which the servos get from pose to pose, in s."""
        speeds = np.inf if self.speeds is None else self.speeds
        return (_PEAK[self.interpolation] * np.abs(np.diff(poses, axis=1)) / speeds).max(axis=2)

    def _check_speeds(self) -> None:
        """Raises ParameterError where the nominal motion is faster than a servo."""
        if self.speeds is None:
            return
        poses, _ = self.knots(self.nominal[None])
        for number, given in enumerate(self.intervals):
            needed = _PEAK[self.interpolation] * np.abs(poses[0, number + 1] - poses[0, number]) / given
            worst = int(np.argmax(needed / self.speeds))
            if needed[worst] > self.speeds[worst] * (1.0 + ROUNDED):
                raise ParameterError(
                    f"interval {number + 1} of {given:.3g} s is too short: joint '{self.joints[worst]}' would need "
                    f"{needed[worst]:.3g} rad/s, its servo can do {self.speeds[worst]:.3g} rad/s; give at least "
                    f"{given * needed[worst] / self.speeds[worst]:.2g} s"
                )

    def controller(self, values: Array, *, period: float = 0.008, tilt: Tilt | None = None) -> Keyframes:
        """The controller of b copies with values (b, m). Raises ParameterError for feedback without `tilt`."""
        if self.feedback and tilt is None:
            raise ParameterError("feedback needs to know the torso's tilt")
        values = np.atleast_2d(np.asarray(values, dtype=np.float64))
        gains = self._gains(values) if self.feedback else None
        return Keyframes(*self.knots(values), period, self.interpolation, gains, tilt, (self.lower, self.upper))

    def command(self, candidate: Array, *, rate: float = 125.0, lasting: float = 0.0) -> Channel:
        """What a robot is sent for one candidate (m,) at `rate` Hz, without feedback; at last held for `lasting` s."""
        poses, times = self.knots(np.asarray(candidate, dtype=np.float64)[None])
        time = np.arange(int(np.ceil((times[0, -1] + lasting) * rate)) + 1) / rate
        return Channel("command", self.joints, "rad", time, _between(poses, times, time, self.interpolation)[0])

    def fastest(self, candidate: Array) -> dict[str, float]:
        """Joint to the fastest speed that a motion asks of it, in rad/s: what a servo must be able to follow."""
        poses, times = self.knots(np.asarray(candidate, dtype=np.float64)[None])
        speed = np.abs(np.diff(poses[0], axis=0)) / np.diff(times[0])[:, None]
        return dict(zip(self.joints, (_PEAK[self.interpolation] * speed.max(axis=0)).tolist(), strict=True))

    def _range(self, degree: Degree) -> tuple[float, float]:
        """The range that all joints of a degree allow."""
        ends = []
        for i, joint in enumerate(degree.joints):
            j = self.joints.index(joint)
            ends.append(sorted((degree.sign(i) * self.lower[j], degree.sign(i) * self.upper[j])))
        return float(max(e[0] for e in ends)), float(min(e[1] for e in ends))

    def _gains(self, values: Array) -> Array:
        """(b, 2, k) what one rad of tilt and one rad/s of its rate add to each joint."""
        gains = np.zeros((len(values), 2, len(self.joints)))
        names = [d.name for d in self.degrees]
        first = values.shape[1] - 2 * len(self.feedback)
        for column, name in enumerate(self.feedback):
            degree = self.degrees[names.index(name)]
            for i, joint in enumerate(degree.joints):
                own = values[:, first + 2 * column : first + 2 * column + 2]
                gains[:, :, self.joints.index(joint)] = degree.sign(i) * own
        return gains


class Keyframes:
    """A Controller: b motions in lockstep, each held at its last pose once it has arrived there."""

    def __init__(
        self, poses: Array, times: Array, period: float, interpolation: str = "linear", gains: Array | None = None,
        tilt: Tilt | None = None, ranges: tuple[Array, Array] = (np.array(-np.inf), np.array(np.inf)),
    ) -> None:  # fmt: skip
        """`poses` (b, n, k) in rad at `times` (b, n) in s from 0; `gains` (b, 2, k) of `tilt` and of its rate.

        Feedback leads no further than `ranges`, (k,) and (k,) in rad.
        """
        self.period = period
        self._poses, self._times, self._interpolation = poses, times, interpolation
        self._gains, self._tilt, self._ranges = gains, tilt, ranges

    def reset(self, observation: Observation) -> None:
        """Nothing to forget: the motion depends on time, the feedback on the present state."""

    def command(self, observation: Observation) -> Array:
        """(b, k) in rad."""
        wanted = _between(self._poses, self._times, np.array([observation.time]), self._interpolation)[:, 0]
        if self._tilt is None or self._gains is None:
            return wanted
        tilt, rate = self._tilt(observation)
        return np.clip(wanted + tilt[:, None] * self._gains[:, 0] + rate[:, None] * self._gains[:, 1], *self._ranges)

    def ahead(self, times: Array) -> Array | None:
        """See Foretold: (b, n, k) in rad, None with feedback."""
        if self._tilt is not None and self._gains is not None:
            return None
        return _between(self._poses, self._times, times, self._interpolation)


def _between(poses: Array, times: Array, now: Array, interpolation: str) -> Array:
    """(b, m, k) where motions through `poses` (b, n, k) at `times` (b, n) are at instants (m,)."""
    rows, right = np.arange(len(poses))[:, None], np.sum(times[:, None] <= now[:, None], axis=2)
    left = (right := np.minimum(right, times.shape[1] - 1)) - 1
    length = (times[rows, right] - times[rows, left])[:, :, None]
    share = np.clip((now - times[rows, left])[:, :, None] / length, 0.0, 1.0)
    before, after = poses[rows, left], poses[rows, right]
    if interpolation == "linear":
        return before + share * (after - before)
    slopes = _slopes(poses, times)
    # Cubic Hermite polynomial on the unit interval.
    m0, m1 = slopes[rows, left] * length, slopes[rows, right] * length
    s2, s3 = share**2, share**3
    return (2 * s3 - 3 * s2 + 1) * before + (s3 - 2 * s2 + share) * m0 + (3 * s2 - 2 * s3) * after + (s3 - s2) * m1


def _slopes(poses: Array, times: Array) -> Array:
    """(b, n, k) speeds at the keyframes that never overshoot them, zero at both ends.

    F. N. Fritsch and J. Butland, SIAM J. Sci. Stat. Comput. 5(2), 1984: a weighted harmonic mean of the neighbouring
    slopes where they have one sign, else zero.
    """
    steps = np.diff(times, axis=1)[:, :, None]
    secant = np.diff(poses, axis=1) / steps
    slopes = np.zeros_like(poses)
    before, after = secant[:, :-1], secant[:, 1:]
    w0, w1 = 2.0 * steps[:, 1:] + steps[:, :-1], steps[:, 1:] + 2.0 * steps[:, :-1]
    same = before * after > 0.0
    safe0, safe1 = np.where(same, before, 1.0), np.where(same, after, 1.0)
    slopes[:, 1:-1] = np.where(same, (w0 + w1) / (w0 / safe0 + w1 / safe1), 0.0)
    return slopes


def pitch_of(base: int = 3, joint: int = 3) -> Tilt:
    """The forward tilt of a free base whose x axis points forward, from its quaternion (w first) at `base` of the positions
    and its angular velocity in its own frame at `joint` of the velocities, as MuJoCo has them.
    """

    def tilt(seen: Observation) -> tuple[Array, Array]:
        return angles_of(seen.position[:, base : base + 4])[:, 1], np.array(seen.velocity[:, joint + 1])

    return tilt


def mirrored(names: Sequence[str], left: str, right: str) -> tuple[Degree, ...]:
    """Degrees of joints named alike but for their side's prefix, which turn the same way on both sides."""
    return tuple(Degree(name, (f"{left}{name}", f"{right}{name}"), (1.0, 1.0)) for name in names)
