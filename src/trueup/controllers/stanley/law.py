# SPDX-License-Identifier: Apache-2.0
"""Steers the front axle onto a path (Thrun et al. 2006), with gains by speed range; plain numpy, b copies in lockstep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.controllers.controller import Observation
from trueup.errors import ParameterError, RecordingError, unknown_name
from trueup.parameters import Parameter, ParameterSpace
from trueup.paths import Path

_OPTIONS = (
    Parameter("k1", "1/s", 1.0, 0.05, 5.0, "log", source="cross-track gain below 0.5 m/s"),
    Parameter("k2", "1/s", 1.0, 0.05, 5.0, "log", source="cross-track gain from 0.5 to 0.8 m/s"),
    Parameter("k3", "1/s", 1.0, 0.05, 5.0, "log", source="cross-track gain above 0.8 m/s"),
    Parameter("softening", "m/s", 0.2, 0.02, 2.0, "log", source="added to the speed under the arc tangent"),
    Parameter("heading_gain", "", 1.0, 0.2, 2.0, source="on the heading error"),
    Parameter("yaw_damping", "s", 0.0, -0.5, 0.5, source="on the path's turn rate minus the robot's"),
    Parameter("lead", "s", 0.0, 0.0, 1.0, source="the law acts on the pose expected so much later"),
)

_SLOWEST = 1.0  # s between two commands: a vehicle that is steered less often is not kept on a path
GAINS = ("k1", "k2", "k3")
"""The three gains of the paper (its Table I), one for each speed range."""


@dataclass(frozen=True)
class StanleySettings:
    """What is known of the vehicle and of the controller, the same for all copies."""

    wheelbase: float = 0.55
    """From the rear axle, whose pose is measured, to the front axle, which is steered onto the path, in m."""
    max_steering: float = 0.698
    """In rad, to either side."""
    max_speed: float = 1.0
    """In m/s."""
    edges: tuple[float, float] = (0.5, 0.8)
    """Speeds at which the gain changes, in m/s (Table I of the paper)."""
    hysteresis: float = 0.02
    """A range is left this far beyond its edge, in m/s."""
    ahead: float = 0.6
    """The nearest point is looked for this far ahead of the last one, never behind it, in m."""
    period: float = 0.02
    """Between two commands, in s."""

    def __post_init__(self) -> None:
        """Checks the numbers. Raises ParameterError."""
        low, high = self.edges
        for name, value, fits, wanted in (
            ("wheelbase", self.wheelbase, 0.0 < self.wheelbase < np.inf, "must be positive, in m"),
            ("max_steering", self.max_steering, self.max_steering > 0.0, "must be positive, in rad"),
            ("max_speed", self.max_speed, 0.0 < self.max_speed < np.inf, "must be positive, in m/s"),
            ("edges", list(self.edges), 0.0 <= low <= high < np.inf, "must be two speeds in m/s, the lower one first"),
            (
                "period",
                self.period,
                0.0 < self.period < _SLOWEST,
                f"must be above 0 and below {_SLOWEST:g} s; is it in ms?",
            ),
        ):
            if not fits:
                raise ParameterError(f"the path follower's {name} is {value}; it {wanted}")

    @property
    def row(self) -> Array:
        """(7,) for the compiled law."""
        return np.array(
            [self.wheelbase, self.max_steering, self.max_speed, *self.edges, self.hysteresis, self.ahead],
            dtype=np.float64,
        )


def gain_space(
    names: tuple[str, ...] = GAINS, edges: tuple[float, float] = (0.5, 0.8),
    ranges: Mapping[str, tuple[float, float]] | None = None, /, **nominal: float,
) -> ParameterSpace:  # fmt: skip
    """The parameters `names` of the controller, whose gain changes at the speeds `edges` in m/s, with other nominal values
    and `ranges` (lowest and highest) where given. Raises UnknownNameError, ParameterError.
    """
    everything = ParameterSpace(_OPTIONS)
    for name in names:
        if name not in everything.names:
            raise unknown_name("parameter", name, everything.names, "the path follower")
    widths = dict(ranges or {})
    for name in (*nominal, *widths):
        if name not in names:
            raise unknown_name(
                "range of parameter" if name in widths else "nominal parameter", name, names, "what is tuned"
            )
    low, high = (f"{edge:.4g}" for edge in edges)
    speeds = {"k1": f"below {low}", "k2": f"from {low} to {high}", "k3": f"above {high}"}
    means = {k: f"cross-track gain {at} m/s" for k, at in speeds.items()}
    return ParameterSpace(tuple(
        p.replace(
            nominal=float(nominal.get(p.name, p.nominal)), source=means.get(p.name, p.source),
            lower=float(widths.get(p.name, (p.lower,))[0]), upper=float(widths.get(p.name, (p.upper,))[-1]),
        )
        for p in (everything[name] for name in names)
    ))  # fmt: skip


class Stanley:
    """A Controller for b vehicles: commands (b, 2) are speed in m/s and steering angle in rad, left positive.

    delta = g (theta_path - theta) + atan(k e / (v + v_soft)) + k_yaw (kappa v - omega), with e positive where the path
    lies to the left of the front axle: eq. (2) of the paper with the signs that make its eq. (1) stable. k is k1, k2 or
    k3 by measured speed. With a `lead` the law acts on the pose that is expected then at the present speed and turn rate,
    which makes up for delays. `values` (b, m) are the parameters `names`; all others keep their nominal value. The path
    is given, or comes with the trial (reference 'path').
    """

    def __init__(
        self, values: Array, settings: StanleySettings | None = None, *, names: tuple[str, ...] = GAINS,
        path: Path | None = None,
    ) -> None:  # fmt: skip
        self.settings = settings or StanleySettings()
        self.period = self.settings.period
        given = np.atleast_2d(np.asarray(values, dtype=np.float64))
        if given.shape[1] != len(names):
            raise ParameterError(f"the Stanley controller was given {given.shape[1]} values for {', '.join(names)}")
        everything = ParameterSpace(_OPTIONS)
        self.gains = np.tile(everything.nominal, (len(given), 1))
        """(b, 7): k1, k2, k3, softening, heading_gain, yaw_damping, lead."""
        self.gains[:, [everything.index(name) for name in names]] = given
        self._given = path

    def path_of(self, observation: Observation) -> Path:
        """The path that is to be followed. Raises RecordingError where there is none."""
        if self._given is not None:
            return self._given
        trial = observation.trial
        if trial is None or "path" not in trial.references:
            name = "a trial" if trial is None else f"trial '{trial.name}'"
            raise RecordingError(f"{name} has no reference 'path', and the Stanley controller was given none")
        return Path.of(trial.references["path"], trial.name)

    def reset(self, observation: Observation) -> None:
        """Goes back to the start of the path."""
        self.path = self.path_of(observation)
        copies = len(self.gains)
        self._segment = np.zeros(copies, dtype=np.intp)
        self.arc = np.zeros(copies)
        """(b,) how far each copy has come, in m."""
        self._range = np.zeros(copies, dtype=np.intp)

    def command(self, observation: Observation) -> Array:
        """(b, 2) speed and steering; positions are (b, 3) x, y, heading of the rear axle, velocities speed, yaw rate."""
        x, y, theta = observation.position.T
        speed, yaw_rate = observation.velocity.T
        s, path, lead = self.settings, self.path, self.gains[:, 6]
        gone, half = speed * lead, 0.5 * yaw_rate * lead
        x, y, theta = x + gone * np.cos(theta + half), y + gone * np.sin(theta + half), theta + yaw_rate * lead
        front = np.stack([x + s.wheelbase * np.cos(theta), y + s.wheelbase * np.sin(theta)], axis=1)
        foot = self._advance(front)
        along = self.arc
        heading = np.interp(along, path.arc, path.heading)
        left = -np.sin(heading) * (foot[:, 0] - front[:, 0]) + np.cos(heading) * (foot[:, 1] - front[:, 1])
        turn = heading - theta
        turn = turn - 2.0 * np.pi * np.floor((turn + np.pi) / (2.0 * np.pi))
        soft, g, damping = self.gains[:, 3], self.gains[:, 4], self.gains[:, 5]
        k = self.gains[np.arange(len(along)), self._in_range(speed)]
        steering = g * turn + np.arctan(k * left / (np.maximum(speed, 0.0) + soft))
        steering = steering + damping * (np.interp(along, path.arc, path.curvature) * speed - yaw_rate)
        steering = np.clip(steering, -s.max_steering, s.max_steering)
        wanted = np.minimum(np.interp(along, path.arc, path.speed), s.max_speed)
        moving = along < path.length - 1e-3
        return np.stack([np.where(moving, wanted, 0.0), np.where(moving, steering, 0.0)], axis=1)

    def _in_range(self, speed: Array) -> NDArray[np.intp]:
        """(b,) index of the speed range, left only beyond its edge plus hysteresis."""
        low, high = self.settings.edges
        margin = self.settings.hysteresis
        up = (speed >= low + margin).astype(np.intp) + (speed >= high + margin)
        down = (speed >= low - margin).astype(np.intp) + (speed >= high - margin)
        self._range = np.clip(self._range, up, down)
        return self._range

    def _advance(self, front: Array) -> Array:
        """(b, 2) foot of each front axle on the path, from the last one onward; moves `arc` on."""
        path = self.path
        steps = np.diff(path.points, axis=0)
        squares = np.sum(steps**2, axis=1)
        last = np.searchsorted(path.arc, self.arc + self.settings.ahead, side="left") - 1
        last = np.clip(last, self._segment, len(squares) - 1)
        reach = int((last - self._segment).max()) + 1
        index = np.minimum(self._segment[:, None] + np.arange(reach), last[:, None])  # (b, reach)
        toward = front[:, None] - path.points[index]
        part = np.clip(np.sum(toward * steps[index], axis=2) / squares[index], 0.0, 1.0)
        apart = np.sum((toward - part[:, :, None] * steps[index]) ** 2, axis=2)
        best = apart.argmin(axis=1)
        rows = np.arange(len(best))
        self._segment = index[rows, best]
        i, t = self._segment, part[rows, best]
        length = path.arc[i + 1] - path.arc[i]
        t = np.maximum(t, (self.arc - path.arc[i]) / length)  # never backward
        self.arc = path.arc[i] + t * length
        return path.points[i] + t[:, None] * steps[i]
