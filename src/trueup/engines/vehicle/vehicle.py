# SPDX-License-Identifier: Apache-2.0
"""What is known of a vehicle that steers its front axle, and the space of what is calibrated in it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from trueup.arrays import Array
from trueup.engines.vehicle.kernels import COLUMNS, STEERING_LEFT, STEERING_RIGHT, STEERING_SCALE, SWINGS
from trueup.engines.vehicle.quantities import PURSUED, TURNED, Quantity, quantities_of
from trueup.errors import ParameterError, unknown_name
from trueup.parameters import Parameter, ParameterSpace
from trueup.tracking.sense import Sense, Source
from trueup.tracking.wheels import Wheels
from trueup.units import FULL_LOCK

DRIVES: Mapping[str, tuple[Quantity, ...]] = MappingProxyType(
    {drive: quantities_of(drive) for drive in ("speed", "throttle", PURSUED, TURNED)}
)
"""What may command a vehicle beside its steering, and what may be calibrated in it then."""
HORIZONS = (1.0, 3.0)
"""How far ahead predictions are judged, in s."""


@dataclass(frozen=True)
class Vehicle:
    """A vehicle as its maker or its file describes it.

    Raises ParameterError for impossible numbers, UnknownNameError for other values.
    """

    name: str
    wheelbase: float
    """Rear axle to front axle, which is steered, in m."""
    max_steering: float = np.inf
    """In rad, to either side."""
    values: Mapping[str, float] = field(default_factory=dict)
    """Quantities that are known; the others are absent, or in a vehicle driven by throttle as a usual small car has them."""
    drive: str = "speed"
    """What is commanded: 'speed' in m/s with steering in rad to wheels that roll where they point, 'throttle' with steering,
    both as shares -1 ... 1, to wheels on tyres, or to such a 'pursued speed', which a controller reaches by and by; or to two
    driven wheels a 'pursued speed and turn rate'."""
    enabled_by: str = ""
    """Label of a recorded signal without which the throttle is cut (a dead man's switch); '' finds one by its name."""
    middle: tuple[float, float] = (0.0, 0.0)
    """Recorded throttle and steering that stand for zero."""
    full: tuple[float, float] | None = None
    """How far beyond `middle` they stand for one, below zero where they grow backwards or to the right; None: 1."""

    wheels: Wheels | None = None
    """Of a robot on two driven wheels: how commands of a left and a right wheel become a speed and a turn rate."""
    in_si: bool = False
    """Whether its commands are known to be m/s and rad, so that a car of which nothing else is known can drive them."""
    declared: bool = True
    """Whether its file says what is commanded; recordings tell it otherwise."""
    driven: str = ""
    """Which axle is told the speed, 'rear' or the steered one, 'front'; '': what recordings tell, else 'rear'."""
    headings: Mapping[Source, Sense] = field(default_factory=dict)
    """In which sense its recordings tell the heading, by where it comes from; of the others each is asked alone."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        who = f"vehicle '{self.name}'"
        if self.drive not in DRIVES:
            raise unknown_name("drive", self.drive, DRIVES, who)
        if not 0.0 < self.wheelbase < np.inf:
            raise ParameterError(f"{who}: wheelbase is {self.wheelbase}; it must be positive, in m")
        if not (0.0 < self.max_steering <= FULL_LOCK or self.max_steering == np.inf):
            degrees = f"; {self.max_steering:g} degrees are {np.radians(self.max_steering):.4g} rad"
            raise ParameterError(
                f"{who}: max_steering is {self.max_steering}; it must be positive, in rad, and at most a right angle"
                + (degrees if self.max_steering > 0.0 else "")
            )
        if not np.isfinite(self.middle).all() or not np.isfinite(self.full or 1.0).all() or 0.0 in (self.full or ()):
            raise ParameterError(f"{who}: full is {self.full}, middle {self.middle}; full must not be zero")
        for name, value in self.values.items():
            if name not in self.names:
                raise unknown_name("quantity", name, self.names, who)
            if not np.isfinite(value):
                raise ParameterError(f"{who}: {name} is {value}; it must be a finite number")
        if self.values.get("wheel_dead") and not self.told_shares:
            raise ParameterError(
                f"{who}: wheel_dead is a share of what a left and a right wheel are told; its commands are none: it needs a "
                f"track, and the same full for both (full is {self.full})"
            )
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))

    @property
    def told_shares(self) -> bool:
        """Whether two wheels are told shares of one full command, so that mean and difference tell each wheel's own."""
        one_full = self.full is not None and abs(self.full[0]) == abs(self.full[1])
        return self.wheels is not None and one_full and not self.in_si

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What may be calibrated in it."""
        return DRIVES[self.drive]

    @property
    def pursues(self) -> bool:
        """Whether it is commanded by a speed that it reaches by and by."""
        return self.drive in (PURSUED, TURNED)

    @property
    def step(self) -> float:
        """In s: what tyres and controllers of its own are integrated with; twice that, the period of usual controllers, where
        wheels roll as they are told (on JetRacer predictions are off by a twentieth more with the coarser one).
        """
        return 2.0 * SWINGS if self.drive == "speed" else SWINGS

    @property
    def horizon(self) -> float:
        """How long it is simulated from what was measured, in s: without end where wheels roll as they are told; else as far
        as predictions are judged, by throttle half as far: a car under throttle alone drifts away from any simulation.
        Chosen on JetRacer: all of it, each drive cut in three ways, did no better for three times the simulations.
        """
        if self.drive == "speed":
            return np.inf
        return max(HORIZONS) if self.pursues else 0.5 * max(HORIZONS)

    @property
    def steered_over(self) -> float:
        """The wheelbase in m over which a commanded turn rate is steered; 0 where it is turned by driven wheels."""
        return 0.0 if self.drive == TURNED else self.wheelbase

    @property
    def in_metres(self) -> bool:
        """Whether it is commanded by a speed in m/s and an angle of its front wheels in rad."""
        return self.drive == "speed" or (self.drive == PURSUED and set(np.abs(self.full or (1.0, 1.0))) == {1.0})

    @property
    def steered_by_angle(self) -> bool:
        """Whether such a speed and angle are those that its wheels get, as they are."""
        return self.in_metres and self.driven != "front"

    def unsteered(self, orders: Array) -> Array:
        """(b, 2) speed and steering that its unsteered axle gets: of a speed told to the steered wheel less, by the cosine of
        the angle.
        """
        if self.driven != "front":
            return orders
        return np.stack([orders[:, 0] * np.cos(orders[:, 1]), orders[:, 1]], axis=1)

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(q.name for q in self.quantities)

    @property
    def row(self) -> Array:
        """(len(COLUMNS),) the numbers that the compiled model reads."""
        row = np.zeros(len(COLUMNS))
        row[[STEERING_LEFT, STEERING_RIGHT, STEERING_SCALE]] = 1.0
        for q in (*DRIVES["speed"], *self.quantities):
            row[COLUMNS.index(q.column)] = q.absent
        row[:2] = self.wheelbase, self.max_steering
        row[self.columns(self.values)] = list(self.values.values())
        return row

    def columns(self, names: Iterable[str]) -> NDArray[np.intp]:
        """(n,) the column of `row` that each quantity writes. Raises UnknownNameError."""
        return np.array([COLUMNS.index(self.quantity(name).column) for name in names], dtype=np.intp)

    def quantity(self, name: str) -> Quantity:
        """One of its quantities. Raises UnknownNameError, which lists them."""
        if name not in self.names:
            raise unknown_name("quantity", name, self.names, "what a vehicle may be calibrated in")
        return self.quantities[self.names.index(name)]

    def space(
        self, names: Iterable[str] | None = None, starts: Mapping[str, float] | None = None, steers: float = 1.0
    ) -> ParameterSpace:
        """All its quantities as parameters, those frozen that are not in `names` (None: those that are usually free).

        They start at the vehicle's own values, else at `starts` (what a look at recordings suggests). `steers` is the
        greatest steering command: where that is less than one (an angle in rad), a wheel may turn further for a command
        of one. Raises UnknownNameError.
        """
        known = {**(starts or {}), **self.values}
        free = {q.name for q in self.quantities if q.free} if names is None else set(names)
        for name in (*free, *known):
            self.quantity(name)
        return ParameterSpace(tuple(self._parameter(q, known, q.name in free, steers) for q in self.quantities))

    def _parameter(self, q: Quantity, known: Mapping[str, float], free: bool, steers: float) -> Parameter:
        size = max(self.wheelbase, 1.0) ** q.grows  # bounds hold up to a wheelbase of a metre
        lower, upper = size * q.lower, size * q.upper / (steers if q.per_command and 0.0 < steers < 1.0 else 1.0)
        nominal = float(np.clip(known.get(q.name, q.start), lower, upper))
        unidentified = q.absent if q.absent > upper and q.name not in known else q.unidentified  # a limit not met
        return Parameter(
            q.name, q.unit, nominal, lower, upper, q.scale, frozen=not free, source=q.about, shown_by=q.shown_by,
            optional=q.optional, absent=q.absent if q.optional or q.is_limit else None,
            unidentified=None if q.name in self.values else unidentified,
            vanishes=lower == 0.0,
        )  # fmt: skip


BETAS = ("speed_delay", "steering_delay", "acceleration_limit", "yaw_rate_limit", "yaw_acceleration_limit")
"""The five parameters of the paper's Table II, in its order."""


def vehicle_space(vehicle: Vehicle, names: Iterable[str] = BETAS, **nominal: float) -> ParameterSpace:
    """Parameters for the quantities `names` alone, in their order, starting at the vehicle's own values where it has them.

    Raises UnknownNameError for a name that is not a quantity of the vehicle.
    """
    whole = vehicle.space(names)
    return ParameterSpace(tuple(_starting(whole[name], nominal) for name in names))


def _starting(parameter: Parameter, nominal: Mapping[str, float]) -> Parameter:
    start = nominal.get(parameter.name, parameter.nominal)
    return parameter.replace(nominal=min(max(float(start), parameter.lower), parameter.upper))
