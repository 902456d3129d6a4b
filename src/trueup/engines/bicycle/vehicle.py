# SPDX-License-Identifier: Apache-2.0
"""What is known of a vehicle, and what may be calibrated in it: name, unit, bounds, and the value that means 'absent'."""

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
class VehicleQuantity:
    """One number of the vehicle that may be calibrated."""

    name: str
    unit: str
    absent: float
    """The value at which it has no effect."""
    start: float
    """Where a calibration starts unless the vehicle says otherwise."""
    lower: float
    upper: float
    scale: str
    about: str
    shown_by: str


_CURVES = "curves taken at several speeds"
_STARTS = "starts, stops and changes of speed"

QUANTITIES = (
    VehicleQuantity("speed_delay", "s", 0.0, 0.0, 0.0, 1.0, "linear", "pure delay of the speed command (beta_1)", _STARTS),
    VehicleQuantity("steering_delay", "s", 0.0, 0.0, 0.0, 1.0, "linear", "pure delay of the steering command (beta_2)",
                    "quick changes of steering"),
    VehicleQuantity("acceleration_limit", "m/s^2", 1e3, 0.5, 0.1, 2.0, "log", "greatest change of speed (beta_3)", _STARTS),
    VehicleQuantity("yaw_rate_limit", "rad/s", 1e3, 1.0, 0.2, 2.0, "log", "greatest turn rate (beta_4)",
                    "sharp curves at speed"),
    VehicleQuantity("yaw_acceleration_limit", "rad/s^2", 1e3, 1.0, 0.1, 5.0, "log", "greatest change of turn rate (beta_5)",
                    "sharp curves at speed"),
    VehicleQuantity("speed_lag", "s", 0.0, 0.05, 0.0, 1.0, "linear", "first-order lag of the speed", _STARTS),
    VehicleQuantity("steering_lag", "s", 0.0, 0.05, 0.0, 1.0, "linear", "first-order lag of the steering",
                    "quick changes of steering"),
    VehicleQuantity("steering_rate_limit", "rad/s", 1e3, 1.0, 0.1, 10.0, "log", "greatest steering speed",
                    "large, quick changes of steering"),
    VehicleQuantity("wheel_scale", "", 1.0, 1.0, 0.7, 1.3, "linear", "speed over ground / speed of the wheels",
                    "driving straight on"),
    VehicleQuantity("steering_scale", "", 1.0, 1.0, 0.6, 1.5, "linear", "steering angle / commanded angle", _CURVES),
    VehicleQuantity("steering_offset", "rad", 0.0, 0.0, -0.15, 0.15, "linear", "steering angle at zero command",
                    "driving straight on"),
    VehicleQuantity("steering_slack", "rad", 0.0, 0.01, 0.0, 0.15, "linear", "play of the steering, end to end",
                    "slow changes of steering to and fro"),
    VehicleQuantity("understeer", "s^2/m^2", 0.0, 0.0, -0.3, 1.0, "linear", "turn rate falls by 1 + K v^2", _CURVES),
    VehicleQuantity("position_noise", "m", 0.0, 0.005, 0.0, 0.1, "linear", "localisation noise, standard deviation",
                    "closed-loop driving"),
    VehicleQuantity("heading_noise", "rad", 0.0, 0.003, 0.0, 0.1, "linear", "localisation noise of the heading",
                    "closed-loop driving"),
    VehicleQuantity("localisation_latency", "s", 0.0, 0.0, 0.0, 0.5, "linear", "age of the pose that is seen",
                    "quick changes of heading"),
)  # fmt: skip
"""Everything that may be calibrated, in the order of the compiled model's columns."""

BETAS = tuple(q.name for q in QUANTITIES[:5])
"""The five parameters of the paper's Table II, in its order."""

_NAMES = tuple(q.name for q in QUANTITIES)


@dataclass(frozen=True)
class Vehicle:
    """A vehicle as its maker describes it. Raises ParameterError for impossible sizes, UnknownNameError for other values."""

    name: str
    wheelbase: float
    """Rear axle, whose pose is observed, to front axle, which is steered, in m."""
    max_steering: float
    """In rad, to either side."""
    values: Mapping[str, float] = field(default_factory=dict)
    """Quantities as shipped; those that are not named are absent."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        for name in ("wheelbase", "max_steering"):
            if not 0.0 < getattr(self, name) < 100.0:
                raise ParameterError(f"vehicle '{self.name}': {name} is {getattr(self, name)}; it must be positive")
        for name in self.values:
            if name not in _NAMES:
                raise unknown_name("quantity", name, _NAMES, f"vehicle '{self.name}'")
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))

    @property
    def row(self) -> Array:
        """(2 + len(QUANTITIES),) wheelbase, greatest steering angle, quantities as shipped."""
        return np.array([self.wheelbase, self.max_steering, *(self.values.get(q.name, q.absent) for q in QUANTITIES)])


def vehicle_space(vehicle: Vehicle, names: Iterable[str] = BETAS, **nominal: float) -> ParameterSpace:
    """Parameters for the quantities `names`, starting at the vehicle's own values where it has them.

    Raises UnknownNameError for a name that is not in QUANTITIES.
    """
    parameters = []
    for name in names:
        if name not in _NAMES:
            raise unknown_name("quantity", name, _NAMES, "what a vehicle may be calibrated in")
        q = QUANTITIES[_NAMES.index(name)]
        start = float(nominal.get(name, vehicle.values.get(name, q.start)))
        parameters.append(
            Parameter(q.name, q.unit, min(max(start, q.lower), q.upper), q.lower, q.upper, q.scale, source=q.about,
                      shown_by=q.shown_by)
        )  # fmt: skip
    return ParameterSpace(tuple(parameters))


def columns_of(space: ParameterSpace) -> NDArray[np.intp]:
    """(n,) the column of the compiled model that each parameter writes. Raises UnknownNameError."""
    for name in space.names:
        if name not in _NAMES:
            raise unknown_name("quantity", name, _NAMES, "what a vehicle may be calibrated in")
    return np.array([2 + _NAMES.index(name) for name in space.names], dtype=np.intp)
