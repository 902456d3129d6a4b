# SPDX-License-Identifier: Apache-2.0
"""What the name of a column says about a vehicle: throttle, steering, position, heading, speed, turn rate; units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from trueup.formats.words import words

_CORES: Mapping[str, str] = MappingProxyType(
    {
        "throttle": "throttle, gas, accelerator, esc, drive, duty, duty cycle, accel pedal, accelerator pedal, gas pedal, "
        "throttle pedal, pedal",
        "brake": "brake, braking, brake pedal",
        "steering": "steer, steering, delta, swa, servo",
        "erpm": "erpm, rpm",
        "x": "x, px, easting, east",
        "y": "y, py, northing, north",
        "latitude": "lat, latitude",
        "longitude": "lon, lng, longitude",
        "heading": "heading, yaw, theta, psi, hdg, azimuth, orientation, orientation yaw, euler yaw, "
        "rpy yaw, rotation yaw, rot yaw, orientation theta, compass, compass heading, bearing, course",
        "qx": "qx, orientation x, quat x, quaternion x, q x, rotation x, rot x",
        "qy": "qy, orientation y, quat y, quaternion y, q y, rotation y, rot y",
        "qz": "qz, orientation z, quat z, quaternion z, q z, rotation z, rot z",
        "qw": "qw, orientation w, quat w, quaternion w, q w, rotation w, rot w",
        "speed": "v, vx, vel, velocity, speed, vel x, velocity x, linear x, linear, linear velocity, linear velocity x, "
        "groundspeed, forward speed, forward velocity, v x",
        "yaw_rate": "w, wz, wimu, omega, omega z, yaw rate, yawrate, yaw vel, yaw velocity, yaw speed, yawvel, yawspeed, "
        "gyro z, gyroz, angular, angular z, angular velocity, angular velocity z, omegaz, angularvelocityz, turn rate, "
        "turnrate, turn, heading rate, gyro",
    }
)  # fmt: skip
_KIND = {frozenset(core.split()): kind for kind, cores in _CORES.items() for core in cores.split(", ")}
_ASKED = (
    "cmd cmds command commands commanded desired des target ref reference setpoint sp u goal input request requested "
    "ackermann teleop nav"
)
_ANYONES = (
    "pos position pose vicon mocap optitrack qualisys odom odometry gps gnss rtk ins car vehicle robot rover cart truck "
    "world map base link center centre cg cog rear front axle wheel wheels road tire tyre hand encoder measured meas "
    "actual real true ground truth gt est estimated estimate long longitudinal motor state states pwm actuation control "
    "ctrl sent norm normalized angle ratio value percentage data msg feedback fb stamped twist vesc sensors sensor core "
    "pf particle filter filtered amcl slam ekf ukf localization localisation fused utm local global enu current drive "
    "csv npz topic inferred imu raw body fix navsat uwb apriltag tag aruco marker beacon lidar tracker tracked tracking "
    "field location ned rb rigid ego agent hero player"
)
_COMMANDED = frozenset(_ASKED.split())
_WHOSE = _COMMANDED | frozenset(_ANYONES.split())
"""Words beside a signal's own that do not change what it is."""
_OF_AN_IMU = frozenset(("imu", "acc", "accel", "acceleration", "gyro", "mag"))
_UNITS: tuple[tuple[tuple[str, ...], str, float], ...] = (
    (("km", "h"), "m/s", 1 / 3.6), (("m", "s"), "m/s", 1.0), (("cm", "s"), "m/s", 0.01), (("mm", "s"), "m/s", 1e-3),
    (("rad", "s"), "rad/s", 1.0), (("deg", "s"), "rad/s", math.pi / 180.0),
    (("kmh",), "m/s", 1 / 3.6), (("kph",), "m/s", 1 / 3.6), (("kmph",), "m/s", 1 / 3.6), (("mph",), "m/s", 0.44704),
    (("mps",), "m/s", 1.0), (("ms",), "m/s", 1.0), (("rads",), "rad/s", 1.0), (("radps",), "rad/s", 1.0),
    (("dps",), "rad/s", math.pi / 180.0), (("degs",), "rad/s", math.pi / 180.0), (("degps",), "rad/s", math.pi / 180.0),
    (("m",), "m", 1.0), (("cm",), "m", 0.01), (("mm",), "m", 1e-3), (("km",), "m", 1e3), (("rad",), "rad", 1.0),
    (("deg",), "rad", math.pi / 180.0), (("degrees",), "rad", math.pi / 180.0), (("percent",), "", 0.01),
    (("pct",), "", 0.01), (("us",), "", 1.0),
)  # fmt: skip
"""Words at the end of a name: the unit in SI, and what one of it is."""
_TRUSTED: tuple[frozenset[str], ...] = tuple(
    frozenset(group.split())
    for group in (
        "vicon mocap optitrack qualisys truth gt",
        "pf amcl slam ekf ukf localization localisation fused filtered rtk ins",
        "",
        "odom odometry encoder wheel imu",
    )
)
"""Where a pose may come from, the most exact first."""


@dataclass(frozen=True)
class Said:
    """What a column's name says."""

    kind: str
    """A key of the kinds above."""
    unit: str
    """In SI, '' where the name says none."""
    factor: float
    """What one of the column's unit is in `unit`."""
    commanded: bool
    rank: int
    """Lower is to be trusted more, among those of one kind."""
    source: frozenset[str]
    """The words that say where it comes from."""


def said(column: str, file: str = "") -> Said | None:
    """What a column (in a file or topic, where there are several) says of a vehicle; None where it is something else."""
    plain = words(column)
    unit, factor, count = _unit(plain)
    bare = plain[: len(plain) - count]
    everything = [*words(file), *bare]
    core = frozenset(w for w in bare if w not in _WHOSE) or frozenset(w for w in everything if w not in _WHOSE)
    kind = _KIND.get(core, "")
    if not kind:  # cmd_vel.linear.x says twice that it is a velocity
        once = _KIND.get(core - {"vel", "velocity"}, "")
        kind = once if once in ("speed", "yaw_rate") else ""
    if not core:  # only words that say whose it is
        kind = next((k for w, k in (("drive", "throttle"),) if w in bare and len(bare) < 3), "")
        if "long" in bare and {"gps", "gnss"} & set(everything):
            kind = "longitude"
    if not kind or (kind in ("x", "y") and _OF_AN_IMU & set(everything)):
        return None
    there = set(everything)
    commanded = bool(_COMMANDED & there) or ("drive" in there and kind in ("speed", "steering"))
    commanded = commanded or (kind == "speed" and (unit, factor) == ("", 0.01))  # nobody measures a speed in percent
    rank = next((i for i, group in enumerate(_TRUSTED) if group & there), 2)
    if kind in ("speed", "yaw_rate"):  # the wheels know the speed and gyroscopes the turn rate, not the tracker
        rank = 0 if {"wheel", "encoder", "imu", "gyro"} & there else 1
    if kind == "steering":
        rank = (0 if commanded else 1) + 2 * ("servo" in core)
    if kind == "throttle":
        rank = 0 if commanded else 1
    return Said(kind, unit, factor, commanded, rank, frozenset(w for w in everything if w in _WHOSE))


def _unit(plain: list[str]) -> tuple[str, float, int]:
    """Unit in SI, factor and number of words at the end that say it; a name is more than its unit."""
    for tail, unit, factor in _UNITS:
        if len(plain) > len(tail) and tuple(plain[-len(tail) :]) == tail:
            return unit, factor, len(tail)
    return "", 1.0, 0
