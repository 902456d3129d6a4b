# SPDX-License-Identifier: Apache-2.0
"""Simulated cars that are commanded by speed, or throttle, and steering, and their logs as several programs write them.

Each is a dynamic bicycle with tyres that saturate (M. Althoff, M. Koschi, S. Manzinger, CommonRoad: Composable benchmarks,
IV 2017, has such a model of F1TENTH's car), a speed controller with an integral part and limits of acceleration and braking,
a steering that is late, slow and a little crooked, and a robot with two driven wheels: structure that trueup's cars do not
have.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trueup.engines.vehicle import VehicleSimulator
from trueup.engines.vehicle.prediction import prediction_errors
from trueup.recording import Recording

Array = NDArray[np.float64]

_STEP = 2e-3  # s


@dataclass(frozen=True)
class Car:
    """What is true of one car; lengths in m, angles in rad, SI throughout."""

    name: str
    wheelbase: float
    speeds: tuple[float, float]
    """Between which it is commanded, in m/s."""
    rate: float
    """Of its log, in Hz."""
    header: tuple[str, ...]
    """Of its log: time, command of speed and of steering, then what `row` gives."""
    row: Callable[[Array], list[float]]
    """The cells of a header from t, speed and angle commanded, x, y, heading, speed, yaw rate."""
    steers: float = 0.4
    """Most that is commanded."""
    delays: tuple[float, float] = (0.05, 0.05)
    """Of speed and steering."""
    gains: tuple[float, float] = (4.0, 0.5)
    """Of the speed controller, proportional and integral."""
    limits: tuple[float, float] = (4.0, 6.0)
    """Of acceleration and braking."""
    turns: float = 3.2
    """Most that the steering turns, in rad/s."""
    lag: float = 0.04
    """Of the steering."""
    scale: tuple[float, float] = (1.0, 0.95)
    """Wheel angle for a commanded angle, to the left and to the right."""
    offset: float = 0.01
    wheels: float = 0.97
    """Speed over ground for a commanded speed."""
    stiffness: tuple[float, float] = (50.0, 60.0)
    """Of the axles' tyres over the mass that each carries, in m/s^2 for a rad."""
    friction: float = 8.0
    """At most, in m/s^2."""
    inertia: float = 0.9
    """Yaw inertia over mass and the axles' distances."""
    noise: tuple[float, float] = (0.002, 0.002)
    """Of position and heading."""
    spins: bool = False
    """Whether it turns by two driven wheels: its second command is a turn rate."""
    motor: tuple[float, float, float, float, float] | None = None
    """By throttle, whose range is then `speeds`: m/s^2 for a throttle of one more, its dead zone, the share that is lost with
    each m/s, m/s^2 of dry friction, 1/s of losses; steering is a share of `steers` then.
    """
    weight: float = 0.5
    """Share of it on the front axle."""
    tracked: float = 0.0
    """m of the tracked point before the rear axle."""

    def reached(self, told: float) -> float:
        """m/s that a command leads to in the end."""
        if self.motor is None:
            return told
        drive, dead, fade, friction, loss = self.motor
        more = drive * max(told - dead, 0.0)
        return max(more - friction, 0.0) / (loss + fade * more)


def _commands(car: Car, seconds: float, rng: np.random.Generator) -> Callable[[float], tuple[float, float]]:
    """Speeds held for some seconds, steering that swings, jumps and rests."""
    low, high = car.speeds
    count = int(seconds) + 3
    speeds = np.repeat(rng.uniform(low, high, count), rng.integers(1, 4, count))
    turns = np.cumsum(rng.uniform(0.3, 1.6, 4 * count))
    angles = rng.uniform(-1.0, 1.0, 4 * count)
    calm = min(1.0, 0.7 * car.friction * car.wheelbase / car.reached(high) ** 2 / math.tan(car.steers)) * car.steers
    swing, phase = rng.uniform(0.15, 0.8), rng.uniform(0.0, 6.0)
    smooth = rng.random() < 0.5

    def at(t: float) -> tuple[float, float]:
        v = float(speeds[int(t) % len(speeds)])
        most = min(car.steers, max(calm, math.atan(0.7 * car.friction * car.wheelbase / max(car.reached(v), 0.5) ** 2)))
        share = math.sin(phase + 6.28 * swing * t) if smooth else float(angles[int(np.searchsorted(turns, t))])
        return v, most * share / (car.steers if car.motor else 1.0)

    return at


def driven(car: Car, seconds: float, rng: np.random.Generator) -> Array:
    """(T, 8) t, commanded speed and angle, x, y, heading of the rear axle, speed and yaw rate, as logged from rest on."""
    told, every = _commands(car, seconds, rng), max(1, round(1.0 / car.rate / _STEP))
    steps, late = round(seconds / _STEP), [round(d / _STEP) for d in car.delays]
    held_for = every if car.motor else 10  # 50 orders a second, held, or one a sample
    orders = np.array([told(_STEP * (k - k % held_for)) for k in range(steps + 1)])
    x = y = psi = v = u = r = wheel = lagged = integral = 0.0
    ahead, behind = (1.0 - car.weight) * car.wheelbase, car.weight * car.wheelbase
    full = car.steers if car.motor else 1.0
    rows = []
    for k in range(steps + 1):
        if k % every == 0:
            at = x + car.tracked * math.cos(psi), y + car.tracked * math.sin(psi)
            rows.append([k * _STEP, *orders[k], *at, psi, v, r])
        wanted = float(orders[max(k - late[0], 0), 0])
        asked = full * float(orders[max(k - late[1], 0), 1])
        if car.motor:
            drive, dead, fade, friction, loss = car.motor
            push = drive * max(wanted - dead, 0.0) * (1.0 - fade * v) - loss * v
            v = max(v + _STEP * (push - friction), 0.0) if v > 0.0 or push > friction else 0.0
        else:
            wanted *= car.wheels
            push = car.gains[0] * (wanted - v) + integral
            held = min(max(push, -car.limits[1]), car.limits[0])
            integral += _STEP * car.gains[1] * (wanted - v) if push == held else 0.0
            v += _STEP * held
        lagged += (asked - lagged) * (1.0 - math.exp(-_STEP / car.lag))
        wheel += min(max(lagged - wheel, -car.turns * _STEP), car.turns * _STEP)
        angle = car.scale[0 if wheel > 0.0 else 1] * wheel + car.offset
        if car.spins:
            r, side = angle, 0.0
        else:
            floor = max(v, 0.3)
            front = angle * min(v / 0.3, 1.0) - math.atan((u + ahead * r) / floor)
            rear = -math.atan((u - behind * r) / floor)
            f, b = (
                share * car.friction * math.tanh(c * a / car.friction)
                for share, c, a in zip((car.weight, 1.0 - car.weight), car.stiffness, (front, rear), strict=True)
            )
            u += _STEP * (f * math.cos(angle) + b - v * r)
            r += (
                _STEP
                * (ahead * f * (math.cos(angle) if car.motor else 1.0) - behind * b)
                / (car.inertia * ahead * behind)
            )
            # A controller of speed makes up for most of this, a motor does not.
            v -= _STEP * (f * math.sin(angle) - u * r if car.motor else 0.5 * f * math.sin(angle))
            side = u - behind * r
        x += _STEP * (v * math.cos(psi) - side * math.sin(psi))
        y += _STEP * (v * math.sin(psi) + side * math.cos(psi))
        psi += _STEP * r
    log = np.array(rows)
    log[:, 3:5] += rng.normal(0.0, car.noise[0], (len(log), 2))
    log[:, 5] += rng.normal(0.0, car.noise[1], len(log))
    log[:, 6] += rng.normal(0.0, 0.005 * car.reached(max(car.speeds)), len(log))
    log[:, 7] += rng.normal(0.0, 0.01, len(log))
    return log


def cut(log: Array, length: float, rng: np.random.Generator) -> Iterator[Array]:
    """Pieces of `length` s in which the car drives, each with a pose and a clock of its own."""
    per = round(length / float(np.median(np.diff(log[:, 0]))))
    for first in range(per // 3, len(log) - per, per):
        piece = np.array(log[first : first + per + 1])
        if np.abs(piece[0, 6]) > 0.1 * np.abs(log[:, 6]).max():
            piece[:, 0] += rng.uniform(0.0, 1e3) - piece[0, 0]
            yield piece


def written(car: Car, piece: Array, path: Path) -> Path:
    """As the car's program logs it."""
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(car.header)
        table.writerows(car.row(row) for row in piece)
    return path


def off(simulator: VehicleSimulator, values: Array, drives: list[Recording], ahead: tuple[float, float]) -> Array:
    """(2,) mean distances in m between predicted and tracked position `ahead` (s)."""
    errors = [prediction_errors(simulator, values, simulator.prepared(d), ahead) for d in drives]
    return np.asarray(np.nanmean(np.concatenate(errors), axis=0))


def _plain(r: Array) -> list[float]:
    return [*r[:6], r[6]]


def _ros(r: Array) -> list[float]:
    return [r[0], r[1], r[2], r[3], r[4], math.sin(r[5] / 2.0), math.cos(r[5] / 2.0), r[6], r[7]]


def _carla(r: Array) -> list[float]:
    turned = (math.degrees(r[5]) + 180.0) % 360.0 - 180.0
    return [r[0], 3.6 * r[1], math.degrees(r[2]), r[3], r[4], turned, 3.6 * r[6]]


CARS = (
    Car("RC", 0.26, (0.6, 2.5), 20.0, ("t", "cmd_speed_mps", "cmd_steer_rad", "x", "y", "yaw", "v"), _plain,
        delays=(0.08, 0.1), gains=(3.0, 0.3), limits=(2.0, 3.0), turns=4.0, lag=0.06, scale=(0.92, 1.05), offset=-0.02,
        wheels=0.94, friction=6.0),
    Car("F1TENTH", 0.33, (1.5, 6.0), 40.0,
        ("time", "drive.speed", "drive.steering_angle", "odom.pose.pose.position.x", "odom.pose.pose.position.y",
         "odom.pose.pose.orientation.z", "odom.pose.pose.orientation.w", "odom.twist.twist.linear.x",
         "odom.twist.twist.angular.z"), _ros,
        gains=(8.0, 0.0), limits=(5.0, 7.0), delays=(0.03, 0.03), lag=0.01, stiffness=(42.0, 48.0), friction=7.5),
    Car("CARLA", 2.87, (3.0, 14.0), 20.0,
        ("timestamp", "target_speed_kmh", "steering_angle_deg", "location_x", "location_y", "yaw_deg", "speed_kmh"), _carla,
        steers=0.6, gains=(1.2, 0.2), limits=(3.0, 6.0), turns=0.9, lag=0.1, offset=0.002, wheels=0.99,
        stiffness=(90.0, 100.0), friction=8.5, inertia=1.1, noise=(0.02, 0.003)),
    Car("full size", 2.7, (2.0, 9.0), 50.0,
        ("time_s", "ackermann_cmd_speed_mps", "ackermann_cmd_steering_angle_rad", "utm_easting_m", "utm_northing_m",
         "heading_rad", "wheel_speed_mps"), _plain,
        steers=0.5, delays=(0.3, 0.15), gains=(0.8, 0.1), limits=(1.2, 2.5), turns=0.5, lag=0.15, scale=(0.97, 0.97),
        wheels=1.02, stiffness=(70.0, 90.0), inertia=1.2, noise=(0.02, 0.002)),
    Car("two driven wheels", 0.4, (0.3, 1.2), 20.0,
        ("t", "cmd_vel.linear.x", "cmd_vel.angular.z", "odom_x", "odom_y", "odom_theta", "odom_v"), _plain,
        steers=1.5, delays=(0.1, 0.1), gains=(5.0, 0.2), limits=(1.0, 1.0), turns=3.0, lag=0.1, scale=(0.9, 0.9),
        offset=0.02, spins=True),
)  # fmt: skip
