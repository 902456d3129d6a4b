# SPDX-License-Identifier: Apache-2.0
"""What is known of a car that is driven by throttle and steering, and what may be calibrated in it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from trueup.errors import ParameterError, unknown_name
from trueup.parameters import Parameter, ParameterSpace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CarQuantity:
    """One number of the car: where a calibration starts, its bounds, what it is and what shows it."""

    name: str
    unit: str
    start: float
    lower: float
    upper: float
    scale: str
    about: str
    shown_by: str
    free: bool = True
    """Whether a calibration looks for it unless told otherwise."""


_QUICK, _CURVES, _FAST = "quick changes of steering", "curves to both sides", "curves at the speed where tyres slide"
_STARTS, _STRAIGHT = "changes of throttle", "driving straight on"

QUANTITIES = (
    CarQuantity("steering_delay", "s", 0.03, -0.1, 0.5, "linear",
                "pure delay of the steering command; below zero where its clock runs late", _QUICK),
    CarQuantity("steering_lag", "s", 0.05, 0.0, 0.5, "linear", "first-order lag of the steering servo", _QUICK),
    CarQuantity("steering_rate", "1/s", 50.0, 0.05, 50.0, "log", "greatest speed of the steering, in units of the command",
                _QUICK),
    CarQuantity("steering_play", "", 0.01, 0.0, 0.2, "linear", "half the play of the steering, in units of the command",
                "small changes of steering to and fro"),
    CarQuantity("steering_left", "rad", 0.4, 0.03, 1.2, "log", "wheel angle for a command of one, to the left", _CURVES),
    CarQuantity("steering_right", "rad", 0.4, 0.03, 1.2, "log", "wheel angle for a command of one, to the right", _CURVES),
    CarQuantity("steering_bend", "", 0.0, -0.3, 0.6, "linear", "share of the angle that is missing at a command of one",
                "gentle and sharp curves"),
    CarQuantity("steering_offset", "", 0.0, -0.3, 0.3, "linear", "added to the steering command", _STRAIGHT),
    CarQuantity("relaxation", "m", 0.05, 0.0, 1.0, "linear", "way rolled until the tyres take up a new wheel angle",
                "quick changes of steering at several speeds"),
    CarQuantity("understeer", "rad s^2/m", 0.005, -0.005, 0.05, "linear",
                "wheel angle that a curve needs beyond its geometry, per sideways acceleration", _FAST),
    CarQuantity("grip", "m/s^2", 200.0, 10.0, 400.0, "log", "cornering stiffness behind over half the mass, per rad", _FAST,
                False),
    CarQuantity("friction_limit", "m/s^2", 8.0, 2.0, 12.0, "log", "greatest sideways acceleration that the tyres give",
                _FAST),
    CarQuantity("weight_in_front", "", 0.5, 0.25, 0.75, "linear", "share of the weight on the front axle", _FAST, False),
    CarQuantity("yaw_inertia", "", 1.0, 0.3, 3.0, "log", "yaw inertia over mass and distances of the axles", _FAST, False),
    CarQuantity("throttle_delay", "s", 0.03, -0.1, 0.5, "linear",
                "pure delay of the throttle; below zero where its clock runs late", _STARTS),
    CarQuantity("throttle_lag", "s", 0.05, 0.0, 1.0, "linear", "first-order lag of the drive", _STARTS),
    CarQuantity("throttle_dead", "", 0.05, 0.0, 0.4, "linear", "throttle below which the motor does nothing", _STARTS),
    CarQuantity("drive", "m/s^2", 10.0, 0.3, 100.0, "log", "acceleration for a throttle of one more, at rest", _STARTS),
    CarQuantity("drive_fade", "s/m", 0.05, 0.0, 1.0, "linear", "share of the drive that is lost with each m/s", _STARTS),
    CarQuantity("braking", "", 1.0, 0.1, 20.0, "log", "deceleration for a throttle below zero, as a share of the drive",
                "braking"),
    CarQuantity("friction", "m/s^2", 1.0, 0.0, 10.0, "linear", "deceleration by dry friction", _STARTS),
    CarQuantity("speed_loss", "1/s", 1.0, 0.01, 10.0, "log", "deceleration per speed (motor and air)", _STARTS),
    CarQuantity("curve_loss", "m^2/s", 0.1, 0.0, 2.0, "linear", "deceleration per speed and squared curvature", _CURVES),
    CarQuantity("pose_ahead", "m", 0.0, -1.0, 1.0, "linear", "tracked point before the centre of mass", "tight curves"),
    CarQuantity("push_lasts", "", 0.5, 0.0, 1.0, "linear", "share of an unexplained acceleration just before that goes on",
                "long drives", False),
    CarQuantity("trim_lasts", "", 0.6, 0.0, 1.0, "linear", "share of an unexplained wheel angle just before that goes on",
                "long drives", False),
    CarQuantity("speed_kept", "", 0.0, 0.0, 1.0, "linear",
                "share of the last seconds, rather than the last samples, in the speed at the start of a prediction",
                "long drives", False),
    CarQuantity("pose_turn", "rad", 0.0, -0.2, 0.2, "linear", "direction of the car from the tracked heading", _STRAIGHT),
)  # fmt: skip
"""Everything that may be calibrated, in the order of the compiled model's columns after the wheelbase."""

_NAMES = tuple(q.name for q in QUANTITIES)
_AROUND = 4.0
"""A steering that was seen to be limited has its limit within this factor of what the first look says."""
_GROWS: Mapping[str, int] = MappingProxyType({"relaxation": 1, "pose_ahead": 1, "curve_loss": 2})
"""Bounds of cars with a wheelbase above a metre grow with this power of it."""


@dataclass(frozen=True)
class Car:
    """A car as its file describes it. Raises ParameterError for impossible sizes, UnknownNameError for other values."""

    name: str
    wheelbase: float
    """In m."""
    values: Mapping[str, float] = field(default_factory=dict)
    """Quantities that are known; the others are as `QUANTITIES` starts them."""
    enabled_by: str = ""
    """Label of a recorded signal without which the throttle is cut (a dead man's switch); '' finds one by its name."""
    middle: tuple[float, float] = (0.0, 0.0)
    """Recorded throttle and steering that stand for zero."""
    full: tuple[float, float] | None = None
    """How far beyond `middle` they stand for one, below zero where they grow backwards or to the right; None: 1."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not 0.0 < self.wheelbase < 100.0:
            raise ParameterError(f"car '{self.name}': wheelbase is {self.wheelbase} m; it must be positive")
        if not np.isfinite(self.middle).all() or not np.isfinite(self.full or 1.0).all() or 0.0 in (self.full or ()):
            raise ParameterError(f"car '{self.name}': full is {self.full}, middle {self.middle}; full must not be zero")
        for name, value in self.values.items():
            if name not in _NAMES:
                raise unknown_name("quantity", name, _NAMES, f"car '{self.name}'")
            if not np.isfinite(value):
                raise ParameterError(f"car '{self.name}': {name} is {value}; it must be a finite number")
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))

    @property
    def row(self) -> Array:
        """(1 + len(QUANTITIES),) wheelbase, then the quantities."""
        return np.array([self.wheelbase, *(self.values.get(q.name, q.start) for q in QUANTITIES)])


def car_space(
    car: Car, starts: Mapping[str, float] | None = None, names: Iterable[str] | None = None, steers: float = 1.0
) -> ParameterSpace:
    """Parameters of a car: all of QUANTITIES, those not in `names` frozen (None: those that are usually free).

    `steers` is the greatest steering command: where that is less than one (an angle in rad), a wheel may turn further for a
    command of one. They start at the car's own values, else at `starts` (what a look at the recordings suggests).
    Raises UnknownNameError.
    """
    wanted = {q.name for q in QUANTITIES if q.free} if names is None else set(names)
    for name in (*wanted, *(starts or {})):
        if name not in _NAMES:
            raise unknown_name("quantity", name, _NAMES, "what a car may be calibrated in")
    parameters = []
    for q in QUANTITIES:
        nominal = float(car.values.get(q.name, (starts or {}).get(q.name, q.start)))
        size = max(car.wheelbase, 1.0) ** _GROWS.get(q.name, 0)
        lower, upper = size * q.lower, size * q.upper
        if q.name in ("steering_left", "steering_right"):
            upper /= float(np.clip(steers, 0.1, 1.0))
        if q.name == "steering_rate" and nominal < upper:  # beyond, no slope would lead back
            upper = min(upper, _AROUND * nominal)
        parameters.append(
            Parameter(q.name, q.unit, float(np.clip(nominal, lower, upper)), lower, upper, q.scale,
                      frozen=q.name not in wanted, source=q.about, shown_by=q.shown_by)
        )  # fmt: skip
    return ParameterSpace(tuple(parameters))


def columns_of(space: ParameterSpace) -> NDArray[np.intp]:
    """(n,) the column of `Car.row` that each parameter writes. Raises UnknownNameError."""
    for name in space.names:
        if name not in _NAMES:
            raise unknown_name("quantity", name, _NAMES, "what a car may be calibrated in")
    return np.array([1 + _NAMES.index(name) for name in space.names], dtype=np.intp)
