# SPDX-License-Identifier: Apache-2.0
"""Signals of vehicles: throttle, steering, place, heading, speed and turn rate, and what each name says of its source."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from trueup.arrays import Array
from trueup.formats.rules.names import COMMANDED, PLAINLY_MEASURED, TRACKERS, listed, words
from trueup.formats.rules.rule import Column, Example, Rule
from trueup.units import canonical, size_of, to_si


def _on_a_globe(values: Array) -> bool:
    """Degrees of latitude or longitude."""
    return bool(np.abs(values).max(initial=0.0) <= math.degrees(math.pi))


def _quaternion(axis: str) -> str:
    """The names of one of its four parts."""
    return ", ".join(f"{whose} {axis}" for whose in ("orientation", "quat", "quaternion", "q", "rotation", "rot"))


RULES = (
    Rule(
        "throttle",
        "throttle, thr, gas, accelerator, esc, drive, duty, duty cycle, accel pedal, accelerator pedal, gas pedal, "
        "throttle pedal, pedal",
        (
            Example("t,actuator_controls.throttle,actuator_controls.steering,vehicle_local_position.x,vehicle_local_position.y",
                    "0 .1 .2 1 2|.1 .2 .2 1.1 2|.2 0 .3 1 2", "command[] throttle steering; position[m] x y"),
            Example("t,rc_throttle,rc_steer,gps_x,gps_y,imu_yaw", "0 1500 1600 1 2 0|.1 1510 1600 1 2 0|.2 1500 1600 1 2 1",
                    "command[] throttle steering; position[m] x y; heading[rad] heading"),
            Example("t,gas_percent,steer,x,y,yaw", "0 10 .1 1 2 .1|.1 20 .1 1.1 2 .1|.2 30 .2 1.2 2 .2",
                 "command[] throttle steering; position[m] x y; heading[rad] heading"),
         Example("t,x,y,yaw,v,steering_angle,accel_cmd", "0 1 2 .1 1 .1 .5|.1 1.1 2 .1 1 .2 .5|.2 1.2 2 .2 1 .1 .4",
                 "command[] throttle steering; position[m] x y; heading[rad] heading; speed[m/s] speed"),
         Example("t,x,y,drive.steering_angle,drive.speed,drive.acceleration", "0 1 2 .1 1 0|.1 1.1 2 .1 2 0|.2 1.2 2 .2 1 0",
                 "command[] speed steering; position[m] x y"),
         Example("t,thr_us,str_us,x,y,theta", "0 1500 1500 1 2 .1|.1 1550 1600 1.1 2 .1|.2 1550 1500 1.2 2 .1",
                 "command[] throttle steering; position[m] x y; heading[rad] heading"),
         Example("t,servo_us,motor_us,x,y,theta", "0 1500 1500 1 2 .1|.1 1600 1550 1.1 2 .1|.2 1500 1550 1.2 2 .1",
                 "command[] throttle steering; position[m] x y; heading[rad] heading"),
         Example("time_ms,drive_setpoint_mm_s,steer_setpoint_deg,drive_actual_mm_s,nav_x_mm,nav_y_mm,nav_theta_deg",
                 "0 100 20 90 1 2 50|100 200 21 190 9 2 51|200 100 22 90 19 2 52",
                 "command[m/s,rad] speed steering; position[m] x y; heading[rad] heading; speed[m/s] speed"),
        ),
    ),
    Rule("brake", "brake, braking, brake pedal",
         (Example("t,throttle,brake,steering", "0 .1 0 .1|.1 .2 0 .1|.2 0 1 .2", "command[] throttle steering brake"),)),
    Rule("steering", "steer, steering, str, delta, swa, servo, lenkwinkel, lenkung",
         (Example("t,v_cmd,delta_cmd_deg", "0 1 20|.1 2 21|.2 1 22", "command[] speed steering"),
          Example("t_ms,speed_kmh_set,steer_norm,x_mm_cam,y_mm_cam,yaw_deg_cam", "0 1 .1 1 2 3|100 2 .2 9 3 4",
                  "command[m/s,] speed steering; position[m] x y; heading[rad] heading"),
          Example("t,SetSteerAngle,ActualSteerAngle,Speed,x,y", "0 10 9 1 1 2|.1 20 11 2 1.1 2|.2 15 19 1 1.3 2",
                  "command[m/s,rad] speed steering; position[m] x y; actual_steer_angle[] actual_steer_angle"),
          Example("t,v_mps_cmd,servo_ticks,x,y", "0 1 370 1 2|.1 2 390 9 3", "command[m/s,] speed steering; position[m] x y"),
          Example("t,longitudinal.velocity,lateral.steering_tire_angle,drive.speed,x,y",
                  "0 1 .1 1 0 0|.1 2 .2 1 1 0|.2 1 .1 2 2 0", "command[] speed steering; position[m] x y"),), also=("rad",)),
    # Taken for steering only beside a place, where no joint has a position.
    Rule(
        "angle", "angle",
        (
            Example("t,user/angle,user/throttle,pos/x,pos/y,pos/yaw", "0 .1 .2 1 2 .1|.1 .2 .2 1.1 2 .1|.2 0 .3 1 2 0",
                    "command[] throttle steering; position[m] x y; heading[rad] heading"),
            Example("t,target_speed,target_angle_deg,x,y", "0 1 20 1 2|.1 2 21 1.1 2|.2 1 22 1 2",
                    "command[] speed steering; position[m] x y"),
            Example("t,angle,duty", "0 .1 .2|.1 .2 .3|.2 .1 .2", "position[rad] joint_1"),
        ),
        also=("rad",),
    ),
    Rule("curvature", "curvature, kappa", (Example("t,speed_cmd,curvature_cmd,x,y", "0 1 .2 1 2|.1 2 .3 1.1 2|.2 1 .4 1 2",
                                                   "command[] speed curvature; position[m] x y"),), unit="1/m"),
    Rule("erpm", "erpm, rpm", (Example("t,erpm_cmd,servo_cmd", "0 900 .5|.1 950 .6|.2 960 .5",
                                       "command[] speed steering"),)),
    Rule("x", "x, px, x east, y east", (Example("t,throttle,steer,odom_x,odom_y,vicon_x,vicon_y",
                                           "0 0 0 1 2 3 4|.1 1 0 1 3 3 4", "command[] throttle steering; position[m] x y"),),
         unit="m"),
    Rule("y", "y, py, x north, y north",
         (Example("t,/limo/cmd_vel/linear/x,/limo/cmd_vel/angular/z,/limo/fused/pose/x,/limo/fused/pose/y,/goal/x,/goal/y",
                  "0 1 0 1 2 5 5|.1 1 0 1 2 5 5|.2 1 0 2 2 5 5", "command[] speed turn; position[m] x y; goal[] x y"),
          Example("t,throttle,steer,x_north_m,y_east_m", "0 0 0 1 2|.1 1 0 1 2|.2 1 0 2 2",
                  "command[] throttle steering; position[m] x y"),), unit="m"),
    Rule("east", "e, east, easting, pe",
         (Example("t,throttle,steer,pos_e,pos_n,n", "0 0 0 1 2 0|.1 1 0 1 2 1|.2 1 0 2 2 2",
                  "command[] throttle steering; position[m] x y"),), unit="m"),
    Rule("north", "n, north, northing, pn", (Example("t,throttle,steer,E,N,psi", "0 0 0 1 2 .1|.1 1 0 1 2 .1|.2 1 0 2 2 .2",
                                         "command[] throttle steering; position[m] x y; heading[rad] heading"),), unit="m"),
    Rule("latitude", "lat, latitude, breitengrad",
         (Example("t,throttle,steer,gps_lat,gps_lon", "0 0 0 48 11|.1 1 0 48 11|.2 1 0 49 11",
                  "command[] throttle steering; position[deg] latitude longitude"),),
         unit="deg", possible=_on_a_globe),
    Rule("longitude", "lon, lng, longitude, langengrad, laengengrad",
         (Example("t,throttle,steer,gps_lat,gps_long", "0 0 0 48 11|.1 1 0 48 12",
                  "command[] throttle steering; position[deg] latitude longitude"),),
         unit="deg", possible=_on_a_globe),
    Rule(
        "heading",
        "heading, yaw, theta, psi, hdg, azimuth, orientation, orientation yaw, euler yaw, rpy yaw, rotation yaw, rot yaw, "
        "orientation theta, compass, compass heading, bearing, course, course over, th, rz, rotz, euler z, gierwinkel, phi, "
        "fahrtrichtung, kurs",
        (Example("t,throttle,steer,COG_deg,SOG_kmh", "0 0 0 350 36|.1 1 0 355 36|.2 1 0 2 40|.3 1 0 5 40",
                 "command[] throttle steering; heading[rad] heading; speed[m/s] speed"),
         Example("t,phi,theta,psi,throttle,steer,x,y", "0 0 0 1 0 0 1 2|.1 0 0 2 1 0 1 2|.2 0 .1 3 1 0 2 2",
                 "command[] throttle steering; position[m] x y; heading[rad] heading; phi[] phi; theta[] theta"),
         Example("t,v_soll,w_soll,x_ist,y_ist,phi_ist", "0 0 0 1 2 0|.1 1 0 1 2 0|.2 1 1 2 2 .1",
                 "command[] speed turn; position[m] x y; heading[rad] heading"),
         Example("Zeit,Breitengrad,Längengrad,Kurs_Grad,Geschwindigkeit_Soll_kmh,Lenkung_Soll_Prozent",
                 "0 48 11 350 1 9|.1 48 11 355 2 8|.2 48 11 2 3 7|.3 48 11 5 2 6",
                 "command[m/s,] speed steering; position[deg] latitude longitude; heading[rad] heading"),
         Example("t,throttle,steer,compass", "0 0 0 350|.1 1 0 355|.2 1 0 2|.3 1 0 5",
                 "command[] throttle steering; heading[rad] heading"),), unit="rad",
    ),
    *(
        Rule(f"q{axis}", f"q{axis}, {_quaternion(axis)}",
             (Example("t,throttle,steer,rb_rot_x,rb_rot_y,rb_rot_z,rb_rot_w", "0 0 0 0 0 0 1|.1 1 0 0 0 .6 .8|.2 1 0 0 0 1 0",
                      "command[] throttle steering; orientation[] qx qy qz qw"),))
        for axis in ("x", "y", "z", "w")
    ),
    Rule(
        "speed",
        "v, vx, vel, velocity, speed, vel x, velocity x, linear x, linear, linear velocity, linear velocity x, lin, lin x, "
        "lin vel, lin vel x, trans vel, translational velocity, groundspeed, forward speed, forward velocity, v x, sog, "
        "speed over, spd, geschwindigkeit",
        (Example("t,throttle,steer,wheel_speed_kmh", "0 0 0 36|.1 1 0 36|.2 1 0 72",
                 "command[] throttle steering; speed[m/s] speed"),),
        unit="m/s",
    ),
    Rule("sideways", "vy, v y, vel y, velocity y, linear y, linear velocity y, lin y, lin vel y",
         (Example("t,cmd_vel.linear.x,cmd_vel.linear.y,cmd_vel.angular.z,x,y", "0 1 .1 0 1 2|.1 1 .1 0 1 2|.2 1 .2 0 1 2",
                  "command[] speed turn sideways; position[m] x y"),), unit="m/s"),
    Rule(
        "yaw_rate",
        "w, wz, wimu, omega, omega z, yaw rate, yawrate, yaw vel, yaw velocity, yaw speed, yawvel, yawspeed, gyro z, gyroz, "
        "angular, angular z, angular velocity, angular velocity z, omegaz, angularvelocityz, turn rate, turnrate, turn, "
        "heading rate, gyro, ang z, ang vel, ang vel z, ang velocity, rot vel, rotational velocity, vel theta, theta vel, "
        "theta dot, yaw dot, psi dot, gierrate, drehrate",
        (Example("t,cmd_lin,cmd_ang,x,y,yaw", "0 0 0 0 0 0|.1 1 1 0 0 0|.2 1 2 0 0 0",
                 "command[] speed turn; position[m] x y; heading[rad] heading"),
         Example("t,throttle,steer,gyro_dps", "0 0 0 36|.1 1 0 36|.2 1 0 72",
                 "command[] throttle steering; yaw_rate[rad/s] yaw_rate"),),
        unit="rad/s",
    ),
)  # fmt: skip
BY_KIND: Mapping[str, Rule] = MappingProxyType({rule.kind: rule for rule in RULES})
_CORES: Mapping[frozenset[str], str] = MappingProxyType(
    {frozenset(core.split()): rule.kind for rule in RULES for core in rule.names.split(", ")}
)

_ASKED = COMMANDED | listed("input ackermann teleop guidance nav user pilot joy joystick rc")
_WHOSE = (
    _ASKED
    | PLAINLY_MEASURED
    | TRACKERS
    | listed(
        "pos position pose loc rtk ins car vehicle robot rover cart "
        "truck world map base link center centre cg cog rear front axle wheel wheels road tire tyre hand "
        "real true ground truth gt est estimated estimate long longitudinal motor state states pwm actuation "
        "sent norm normalized ticks tick angle ratio value percentage data msg stamped twist vesc sensors sensor core "
        "pf particle filter filtered amcl slam ekf ukf localization localisation fused utm local global enu current drive "
        "csv npz topic inferred imu raw body fix navsat apriltag tag aruco marker beacon lidar tracker tracked tracking "
        "line controller output field location ned rb rigid ego agent hero player actuator actuators"
    )
)
_IF_ASKED: Mapping[frozenset[str], str] = MappingProxyType(
    {frozenset(["ang"]): "yaw_rate", frozenset(["rot"]): "yaw_rate"}
)
"""Kinds that words are too short for where they are not those of a command."""
"""Words beside a signal's own that do not change what it is."""
PLACES = ("x", "y", "east", "north")
"""Kinds that are metres on a floor."""
_POSES = (*PLACES, "latitude", "longitude", "heading", "qx", "qy", "qz", "qw")
"""Kinds that no pilot commands: nav_x and nav_y are where a navigation sees the vehicle."""
_PIECES = re.compile(r"[/.]")
"""Between the parts of a topic's name."""
_OF_SOMETHING_ELSE = listed(
    "joint joints wheel wheels arm gripper camera lidar obstacle obstacles object objects person ball waypoint waypoints "
    "path plan lookahead landmark target goal marker error"
)
"""Parts of a topic's name below which nothing is the vehicle's own."""
_EULER = ("psi", "theta", "phi")
"""Letters of a heading: the latter are pitch and roll beside the first. Each source takes a rank, these a part of it."""
_OF_AN_IMU = frozenset(("imu", "acc", "accel", "acceleration", "gyro", "mag"))
_ACCELERATIONS = frozenset(["accel", "acceleration", "acc"])
"""What drives a vehicle where it is commanded."""
_OF_A_MOTOR = frozenset(["motor", "pwm", "drive"])
_OF_WHEELS = frozenset(("wheel", "encoder", "imu", "gyro"))
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


@dataclass(frozen=True, eq=False)
class Signal:
    """A column as a signal of a vehicle."""

    column: Column
    kind: str
    """Of one of the rules."""
    factor: float | None
    """What one of its numbers is in SI, as its name says; None where it does not."""
    commanded: bool
    rank: float
    """Lower is to be trusted more, among those of one kind."""
    source: frozenset[str]
    """The words that say where it comes from."""


def read(column: Column) -> Signal | None:
    """What a column says of a vehicle; None where it is something else, by its words or by its numbers."""
    factor, plain = _unit(column)
    everything = [*words(column.file), *plain]
    there = set(everything)
    kind, named = _kind(plain, everything), True
    if not kind:
        kind, named = _below(column, plain, everything), False
    if not kind or column.values.ndim > 1 or (kind in PLACES and _OF_AN_IMU & there):
        return None
    possible = BY_KIND[kind].possible
    if possible is not None and not possible(column.known):
        return None
    unit = column.parts.bracketed or column.parts.tail
    if kind == "throttle" and factor is not None and to_si(unit)[0] == "m/s":  # drive_setpoint_mm_s
        kind = "speed"
    commanded = bool((COMMANDED if kind in _POSES else _ASKED) & there)
    commanded |= "drive" in there and not PLAINLY_MEASURED & there and kind in ("speed", "steering")
    commanded = commanded or (kind == "speed" and factor == size_of("%"))  # nobody measures a speed in percent
    rank = next((i for i, group in enumerate(_TRUSTED) if group & there), 2)
    if kind in ("speed", "yaw_rate"):  # the wheels know the speed and gyroscopes the turn rate, not the tracker
        rank = 0 if _OF_WHEELS & there else 1
    elif kind in ("steering", "angle", "curvature", "throttle"):
        rank = (0 if commanded else 1) + 2 * (kind == "steering" and "servo" in plain)
    elif kind == "heading":
        rank += max((_EULER.index(word) / len(_EULER) for word in _EULER if word in plain), default=0.0)
    rank += 0 if named else len(RULES)  # behind all whose whole name is known
    return Signal(column, kind, factor, commanded, rank, frozenset(there & _WHOSE - {"long"}))


def best(signals: Sequence[Signal]) -> Signal | None:
    """The most trusted, of these the first."""
    return min(signals, key=lambda s: s.rank, default=None)


def _kind(plain: list[str], everything: list[str]) -> str:
    """What its words name, those left out that only say whose it is."""
    core = frozenset(w for w in plain if w not in _WHOSE) or frozenset(w for w in everything if w not in _WHOSE)
    kind = _CORES.get(core, "")
    if not kind:  # cmd_vel.linear.x says twice that it is a velocity
        once = _CORES.get(core - {"vel", "velocity"}, "")
        kind = once if once in ("speed", "sideways", "yaw_rate") else ""
    if _ASKED & set(everything):
        kind = "throttle" if core and core <= _ACCELERATIONS else kind or _IF_ASKED.get(core, "")
    if core == {"lateral", "steering"}:  # beside longitudinal.velocity, as Autoware commands both
        kind = "steering"
    if not core:  # only words that say whose it is
        driven = ("drive" in plain and len(plain) < 3) or ("motor" in plain and set(plain) <= _OF_A_MOTOR | _ASKED)
        kind = "throttle" if driven else ""
        kind = "heading" if plain == ["cog"] else kind  # course over ground; a centre of gravity has axes
        kind = "angle" if "angle" in plain else kind
        kind = "longitude" if "long" in plain and {"gps", "gnss"} & set(everything) else kind
    return kind


def _below(column: Column, plain: list[str], everything: list[str]) -> str:
    """What a name says behind the robot's own, or a node's: /limo/odom/pose/pose/position/x; '' for nothing.

    A speed by itself is as likely a wheel's as the robot's.
    """
    pieces = [words(piece) for piece in _PIECES.split(column.parts.text) if piece]
    for i in range(1, len(pieces)):
        if _OF_SOMETHING_ELSE & set(pieces[i - 1]):
            return ""
        kind = _kind(plain[sum(map(len, pieces[:i])) :], everything)
        if kind and (i + 1 < len(pieces) or kind not in ("speed", "yaw_rate")):
            return kind
    return ""


def _unit(column: Column) -> tuple[float | None, list[str]]:
    """What one of its numbers is in SI as its name says it, and the words without the unit; single letters are signals."""
    name = column.parts
    if name.bracketed:
        return size_of(name.bracketed), name.words
    unit = {"ms": "m/s"}.get(name.tail, name.tail)
    if not unit or canonical(unit) is None or name.words[-1] in ("a", "c", "k", "n", "v") or name.words[-1].isdigit():
        return None, name.words
    return size_of(unit), name.bare
