# SPDX-License-Identifier: Apache-2.0
"""What may be calibrated in vehicles, in one table: by what commands them."""

from __future__ import annotations

from dataclasses import dataclass

PURSUED, TURNED = "pursued speed", "pursued speed and turn rate"
"""What may command a vehicle beside 'speed' and 'throttle', see `Vehicle.drive`."""


@dataclass(frozen=True)
class Quantity:
    """One number of a vehicle: its bounds, what it is, what shows it, and where the compiled model holds it."""

    of: tuple[str, ...]
    """What commands the vehicles that have it."""
    name: str
    unit: str
    absent: float
    """The value of a vehicle that does not name it: without effect where it can be, else that of a usual small car."""
    start: float
    """Where a calibration starts unless the vehicle says otherwise."""
    lower: float
    upper: float
    scale: str
    about: str
    shown_by: str
    column: str = ""
    """Its place in `kernels.COLUMNS`; '': that of its name."""
    free: bool = True
    """Whether a calibration looks for it unless told otherwise."""
    grows: int = 0
    """Bounds of vehicles with a wheelbase above a metre grow with this power of it."""
    per_command: bool = False
    """Whether its upper bound is that of a full command."""
    unidentified: float | None = None
    """The value where drives do not identify it (see `Parameter.unidentified`); a limit that was not met is absent."""
    optional: str = ""
    """Structure that a vehicle may do without: kept where left-out drives are foretold clearly better with it."""

    @property
    def is_limit(self) -> bool:
        """Whether more of it than its upper bound is as if there were none."""
        return self.absent >= self.upper and self.lower > 0.0

    def __post_init__(self) -> None:
        """Fills in the column."""
        object.__setattr__(self, "column", self.column or self.name)


_STRAIGHT, _STARTS = "driving straight on", "starts, stops and changes of speed"
_QUICK, _SLOW = "quick changes of steering", "slow changes of steering to and fro"
_CURVES, _FAST = "curves taken at several speeds", "curves at the speed where tyres slide"
_TIGHT = "tight curves to both sides"
_ROLLING, _BY_THROTTLE, _BY_ANGLE, _TWO_WHEELS = ("speed",), ("throttle",), (PURSUED,), (TURNED,)
_ON_TYRES, _PURSUING = (*_BY_THROTTLE, *_BY_ANGLE), (*_BY_ANGLE, *_TWO_WHEELS)
_DRIVING = (*_BY_THROTTLE, *_PURSUING)
_LEFT, _RIGHT = (f"wheel angle for a command of one, to the {side}" for side in ("left", "right"))
_GRIP, _WEIGHT = "cornering stiffness behind over half the mass, per rad", "share of the weight on the front axle"
_INERTIA, _POSE_LEFT = "yaw inertia over mass and distances of the axles", "tracked point to the left of the middle"

LASTING = ("push_lasts", "trim_lasts", "speed_kept")
"""How much of what a car showed beyond its model just before a prediction goes on: told by its own drives."""
NOISES = ("position_noise", "heading_noise")
"""What a vehicle shows of its localisation without being simulated; it acts in closed loop only."""


def _usual(
    of: tuple[str, ...], name: str, unit: str, usual: float, lower: float, upper: float, scale: str, about: str,
    shown_by: str, column: str = "", *, start: float | None = None, free: bool = True, grows: int = 0,
    per_command: bool = False, optional: str = "",
) -> Quantity:  # fmt: skip
    """A quantity that every car has: one that is not named is as a usual small car has it."""
    return Quantity(
        of, name, unit, usual, usual if start is None else start, lower, upper, scale, about, shown_by, column, free, grows,
        per_command, optional=optional,
    )  # fmt: skip


QUANTITIES = (
    # Speed of the wheels in m/s and the angle of the front wheels in rad; wheels roll where they point, unless their tyres
    # are found to slip. Delays, lags and the latency start as measured on small real vehicles: a fit that starts without any
    # delay easily ends in a lag or a latency that stands for it, and a controller near its limit tells these apart.
    Quantity(_ROLLING, "speed_delay", "s", 0.0, 0.1, 0.0, 1.0, "linear", "pure delay of the speed command (beta_1)",
             _STARTS, "drive_delay"),
    Quantity(_ROLLING, "steering_delay", "s", 0.0, 0.15, 0.0, 1.0, "linear", "pure delay of the steering command (beta_2)",
             _QUICK),
    Quantity(_ROLLING, "acceleration_limit", "m/s^2", 1e3, 0.5, 0.1, 2.0, "log", "greatest change of speed (beta_3)",
             _STARTS),
    Quantity(_ROLLING, "yaw_rate_limit", "rad/s", 1e3, 1.0, 0.2, 2.0, "log", "greatest turn rate (beta_4)",
             "sharp curves at speed"),
    Quantity(_ROLLING, "yaw_acceleration_limit", "rad/s^2", 1e3, 1.0, 0.1, 5.0, "log",
             "greatest change of turn rate (beta_5)", "sharp curves at speed"),
    Quantity(_ROLLING, "speed_lag", "s", 0.0, 0.1, 0.0, 1.0, "linear", "first-order lag of the speed", _STARTS,
             "drive_lag"),
    Quantity(_ROLLING, "steering_lag", "s", 0.0, 0.1, 0.0, 1.0, "linear", "first-order lag of the steering", _QUICK),
    Quantity(_ROLLING, "steering_rate_limit", "rad/s", 1e3, 1.0, 0.1, 10.0, "log", "greatest steering speed",
             "large, quick changes of steering"),
    Quantity(_ROLLING, "wheel_scale", "", 1.0, 1.0, 0.7, 1.3, "linear", "speed over ground / speed of the wheels",
             _STRAIGHT),
    Quantity(_ROLLING, "steering_scale", "", 1.0, 1.0, 0.6, 1.5, "linear", "steering angle / commanded angle", _CURVES),
    Quantity(_ROLLING, "steering_offset", "rad", 0.0, 0.0, -0.15, 0.15, "linear", "steering angle at zero command",
             _STRAIGHT, "angle_offset"),
    Quantity(_ROLLING, "steering_slack", "rad", 0.0, 0.01, 0.0, 0.15, "linear", "play of the steering, end to end", _SLOW),
    Quantity(_ROLLING, "understeer", "s^2/m^2", 0.0, 0.0, -0.3, 1.0, "linear", "turn rate falls by 1 + K v^2", _CURVES),
    Quantity(_ROLLING, "position_noise", "m", 0.0, 0.005, 0.0, 0.1, "linear", "localisation noise, standard deviation",
             "closed-loop driving"),
    Quantity(_ROLLING, "heading_noise", "rad", 0.0, 0.003, 0.0, 0.1, "linear", "localisation noise of the heading",
             "closed-loop driving"),
    Quantity(_ROLLING, "localisation_latency", "s", 0.0, 0.03, 0.0, 0.5, "linear", "age of the pose that is seen",
             "quick changes of heading"),
    Quantity(_ROLLING, "rear_slip", "s^2/m", 0.0, 0.0, 0.0, 0.15, "linear",
             "slip angle of the rear tyres per sideways acceleration", _CURVES, "rear_compliance", optional="tyres"),
    Quantity(_ROLLING, "relaxation", "m", 0.0, 0.0, 0.0, 1.0, "linear", "way rolled until the tyres take up a slip angle",
             "quick changes of steering at several speeds", "slip_relaxation", optional="tyres"),
    Quantity(_ROLLING, "friction_limit", "m/s^2", 1e3, 8.0, 0.5, 12.0, "log",
             "greatest sideways acceleration that the tyres give", _FAST, free=False),
    Quantity(_ROLLING, "weight_in_front", "", 0.5, 0.5, 0.25, 0.75, "linear", "share of the weight on the front axle",
             _FAST, free=False),
    Quantity(_ROLLING, "yaw_inertia", "", 1.0, 1.0, 0.3, 3.0, "log", "yaw inertia over mass and distances of the axles",
             _FAST, free=False),
    # How a car on tyres steers; steering is a share of the full command, or an angle in rad.
    _usual(_ON_TYRES, "steering_delay", "s", 0.03, -0.1, 0.5, "linear",
           "pure delay of the steering command; below zero where its clock runs late", _QUICK),
    _usual(_ON_TYRES, "steering_lag", "s", 0.05, 0.0, 0.5, "linear", "first-order lag of the steering servo", _QUICK),
    # Begun at what a usual servo makes, 0.1 s for half of its range: from a limit that is never met no slope leads away.
    _usual(_ON_TYRES, "steering_rate_limit", "1/s", 50.0, 0.05, 50.0, "log",
           "greatest speed of the steering, in units of the command", _QUICK, start=10.0),
    _usual(_ON_TYRES, "steering_slack", "", 0.02, 0.0, 0.4, "linear",
           "play of the steering, end to end, in units of the command", _SLOW),
    Quantity(_ON_TYRES, "steering_dead", "", 0.0, 0.0, 0.0, 0.3, "linear",
             "steering command below which the wheels stay in the middle", "gentle curves to both sides",
             optional="dead zone of the steering"),
    _usual(_BY_THROTTLE, "steering_left", "rad", 0.4, 0.03, 1.2, "log", _LEFT, _CURVES, per_command=True),
    _usual(_BY_ANGLE, "steering_left", "rad", 1.0, 0.03, 1.2, "log", _LEFT, _CURVES, per_command=True),
    _usual(_BY_THROTTLE, "steering_right", "rad", 0.4, 0.03, 1.2, "log", _RIGHT, _CURVES, per_command=True),
    _usual(_BY_ANGLE, "steering_right", "rad", 1.0, 0.03, 1.2, "log", _RIGHT, _CURVES, per_command=True),
    _usual(_ON_TYRES, "steering_falloff", "", 0.0, -0.3, 0.6, "linear",
           "share of the angle that is missing at a command of one", "gentle and sharp curves"),
    _usual(_ON_TYRES, "steering_offset", "", 0.0, -0.3, 0.3, "linear", "added to the steering command", _STRAIGHT,
           "command_offset"),
    _usual(_ON_TYRES, "relaxation", "m", 0.05, 0.0, 1.0, "linear", "way rolled until the tyres take up a new wheel angle",
           "quick changes of steering at several speeds", grows=1),
    _usual(_ON_TYRES, "understeer", "rad s^2/m", 0.005, -0.005, 0.05, "linear",
           "wheel angle that a curve needs beyond its geometry, per sideways acceleration", _FAST, "front_compliance"),
    _usual(_BY_THROTTLE, "grip", "m/s^2", 200.0, 10.0, 400.0, "log", _GRIP, _FAST),
    # Tyres that slip behind look like a lag, an understeer or a tracked point elsewhere unless they are asked about.
    _usual(_BY_ANGLE, "grip", "m/s^2", 200.0, 10.0, 400.0, "log", _GRIP, _FAST, optional="softer or stiffer rear tyres"),
    _usual(_ON_TYRES, "friction_limit", "m/s^2", 8.0, 2.0, 12.0, "log",
           "greatest sideways acceleration that the tyres give", _FAST),
    _usual(_BY_THROTTLE, "weight_in_front", "", 0.5, 0.25, 0.75, "linear", _WEIGHT, _FAST),
    _usual(_BY_ANGLE, "weight_in_front", "", 0.5, 0.25, 0.75, "linear", _WEIGHT, _FAST, free=False),
    _usual(_BY_THROTTLE, "yaw_inertia", "", 1.0, 0.3, 3.0, "log", _INERTIA, _FAST),
    _usual(_BY_ANGLE, "yaw_inertia", "", 1.0, 0.3, 3.0, "log", _INERTIA, _FAST, free=False),
    # How it drives by shares of the full throttle.
    _usual(_BY_THROTTLE, "throttle_delay", "s", 0.03, -0.1, 0.5, "linear",
           "pure delay of the throttle; below zero where its clock runs late", _STARTS, "drive_delay"),
    _usual(_BY_THROTTLE, "throttle_lag", "s", 0.05, 0.0, 1.0, "linear", "first-order lag of the drive", _STARTS,
           "drive_lag"),
    _usual(_BY_THROTTLE, "throttle_dead", "", 0.05, 0.0, 0.4, "linear", "throttle below which the motor does nothing",
           _STARTS),
    _usual(_BY_THROTTLE, "drive", "m/s^2", 10.0, 0.3, 100.0, "log", "acceleration for a throttle of one more, at rest",
           _STARTS),
    _usual(_BY_THROTTLE, "drive_fade", "s/m", 0.05, 0.0, 1.0, "linear", "share of the drive that is lost with each m/s",
           _STARTS),
    _usual(_BY_THROTTLE, "braking", "", 1.0, 0.1, 20.0, "log",
           "deceleration for a throttle below zero, as a share of the drive", "braking"),
    _usual(_BY_THROTTLE, "friction", "m/s^2", 1.0, 0.0, 10.0, "linear", "deceleration by dry friction", _STARTS),
    _usual(_BY_THROTTLE, "speed_loss", "1/s", 1.0, 0.01, 10.0, "log", "deceleration per speed (motor and air)", _STARTS),
    # How a controller of the vehicle's own pursues a commanded speed.
    _usual(_PURSUING, "speed_delay", "s", 0.03, -0.1, 1.0, "linear",
           "pure delay of the speed command; below zero where its clock runs late", _STARTS, "drive_delay"),
    Quantity(_PURSUING, "speed_lag", "s", 0.05, 0.05, 0.0, 1.0, "linear", "first-order lag of the speed command", _STARTS,
             "drive_lag", unidentified=0.0),  # the controller is one, too
    _usual(_PURSUING, "speed_scale", "m/s", 1.0, 0.01, 100.0, "log", "speed over ground that a command of one leads to",
           "steady driving", "drive"),
    _usual(_PURSUING, "speed_gain", "1/s", 5.0, 0.2, 50.0, "log", "acceleration for each m/s that is missing", _STARTS),
    Quantity(_PURSUING, "acceleration_limit", "m/s^2", 1e3, 10.0, 0.2, 50.0, "log", "greatest acceleration",
             "large steps of speed"),
    Quantity(_PURSUING, "braking_limit", "m/s^2", 1e3, 10.0, 0.2, 50.0, "log", "greatest deceleration",
             "large steps of speed downwards"),
    # How two driven wheels turn it, by a commanded turn rate in rad/s.
    _usual(_TWO_WHEELS, "turn_delay", "s", 0.03, -0.1, 1.0, "linear",
           "pure delay of the commanded turn rate; below zero where its clock runs late", _QUICK, "steering_delay"),
    _usual(_TWO_WHEELS, "turn_lag", "s", 0.05, 0.0, 1.0, "linear", "first-order lag of the turn rate", _QUICK,
           "steering_lag"),
    Quantity(_TWO_WHEELS, "turn_change_limit", "rad/s^2", 1e3, 50.0, 0.05, 50.0, "log", "greatest change of the turn rate",
             _QUICK, "steering_rate_limit"),
    _usual(_TWO_WHEELS, "turn_left", "rad/s", 1.0, 0.1, 10.0, "log", "turn rate for a command of one, to the left", _CURVES,
           "steering_left"),
    _usual(_TWO_WHEELS, "turn_right", "rad/s", 1.0, 0.1, 10.0, "log", "turn rate for a command of one, to the right",
           _CURVES, "steering_right"),
    _usual(_TWO_WHEELS, "turn_offset", "rad/s", 0.0, -0.3, 0.3, "linear", "added to the commanded turn rate", _STRAIGHT,
           "command_offset"),
    _usual(_TWO_WHEELS, "veer", "rad/m", 0.0, -1.0, 1.0, "linear", "turn with the way driven: one wheel is larger",
           _STRAIGHT, free=False),
    Quantity(_TWO_WHEELS, "wheel_dead", "", 0.0, 0.0, 0.0, 0.4, "linear",
             "share of a wheel's command below which it stands still", _STARTS, "throttle_dead", free=False,
             optional="dead zone of the wheels"),
    _usual(_TWO_WHEELS, "pose_ahead", "m", 0.0, -1.0, 1.0, "linear", "tracked point before the axle of the wheels",
           "tight curves", grows=1),
    # What curves cost it, where it is tracked, and what of the unexplained goes on.
    _usual(_ON_TYRES, "curve_loss", "m^2/s", 0.1, 0.0, 2.0, "linear", "deceleration per speed and squared curvature",
           _CURVES, grows=2),
    _usual(_ON_TYRES, "pose_at", "", 0.5, -3.0, 3.0, "linear",
           "where the tracked point is: 0 over the rear axle, 1 over the front axle", "tight curves"),
    # Not looked for: asked about it, searches on JetRacer end where left-out drives are foretold 3 % worse.
    _usual(_BY_THROTTLE, "pose_left", "m", 0.0, -1.0, 1.0, "linear", _POSE_LEFT, _TIGHT, free=False, grows=1),
    _usual(_PURSUING, "pose_left", "m", 0.0, -1.0, 1.0, "linear", _POSE_LEFT, _TIGHT, grows=1,
           optional="tracked point aside"),
    _usual(_DRIVING, "push_lasts", "", 0.5, 0.0, 1.0, "linear",
           "share of an unexplained acceleration just before that goes on", "long drives", free=False),
    _usual(_DRIVING, "trim_lasts", "", 0.6, 0.0, 1.0, "linear",
           "share of an unexplained wheel angle just before that goes on", "long drives", free=False),
    _usual(_DRIVING, "speed_kept", "", 0.0, 0.0, 1.0, "linear",
           "share of the last seconds, rather than the last samples, in the speed at the start of a prediction",
           "long drives", free=False),
    _usual(_DRIVING, "pose_turn", "rad", 0.0, -0.2, 0.2, "linear", "direction of the car from the tracked heading",
           _STRAIGHT),
    # What a controller that follows a path sees beside the pose; how late it sees that is in the delays that its drives show.
    Quantity(_DRIVING, "position_noise", "m", 0.0, 0.0, 0.0, 1.0, "linear", "localisation noise, standard deviation",
             "closed-loop driving", free=False),
    Quantity(_DRIVING, "heading_noise", "rad", 0.0, 0.0, 0.0, 0.5, "linear", "localisation noise of the heading",
             "closed-loop driving", free=False),
    _usual(_TWO_WHEELS, "turns", "", 1.0, 0.0, 1.0, "linear", "that it is turned by two driven wheels", "nothing",
           free=False),
)  # fmt: skip
"""In the order in which calibrations have them."""


def quantities_of(drive: str) -> tuple[Quantity, ...]:
    """What may be calibrated in vehicles that are commanded so."""
    return tuple(q for q in QUANTITIES if drive in q.of)
