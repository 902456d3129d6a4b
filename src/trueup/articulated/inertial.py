# SPDX-License-Identifier: Apache-2.0
"""Inertial units in whatever unit: gravity tells that of an accelerometer, an orientation beside it that of a gyro."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.articulated.pose import ANGLES, AXES, QUATERNION, quaternion_of, rotation_between
from trueup.evidence import STANDARD_ERRORS
from trueup.inspection.relations import CORRELATED, nearest
from trueup.inspection.sensors import is_accelerometer, is_gyro
from trueup.inspection.sliding import STRIDE
from trueup.reckoned import reckoned_of
from trueup.recording import Channel, Recording
from trueup.rounding import TINY
from trueup.samples import between, is_unit
from trueup.units import GRAVITY, numbers_of, to_si

CALM = 1.0  # s over which steps and pushes average out, and gravity stays
_FASTEST = 35.0
"""rad/s, 2000 degrees per second: the widest range of the gyros that robots carry."""
_IN_G = GRAVITY * numbers_of("g0")
_ACCELERATIONS = {"m/s^2": GRAVITY, "g0": _IN_G, "mg": _IN_G * numbers_of("permille")}
RATES = {unit: numbers_of(unit) for unit in ("rad/s", "deg/s", "rev/s", "rpm")}
_NAMES = {"g0": "g", "mg": "thousandths of g"}


@dataclass(frozen=True, eq=False)
class Together:
    """How turns (T, 3) by a gyro go with those by an orientation."""

    factor: float
    """How many times as large they are."""
    axes: Array
    """(3, 3) orthogonal: turns in the gyro's frame of those in the body's; a mirror where its determinant is -1."""
    fits: float
    """Correlation of both with these axes."""
    shares: Array
    """(3,) of the strongest to the weakest direction in the turns: about one axis alone nothing tells the others."""

    @property
    def is_mirrored(self) -> bool:
        """Whether no way to mount it turns like that."""
        return float(np.linalg.det(self.axes)) < 0.0


def with_inertial_units(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings whose accelerometers and gyros of an unknown unit are in SI where numbers tell it, and notes that say what
    to write: without it they are not compared, since what is guessed should not weigh on a fit.
    """
    notes, result = list[str](), list(recordings)
    names = dict.fromkeys(name for r in recordings for name, c in r.channels.items() if _is_open(c))
    for name in names:
        of = [r for r in recordings if name in r.channels and _is_open(r.channels[name])]
        unit, why = _acceleration(name, of) if is_accelerometer(of[0].channels[name]) else _rate(name, of)
        notes += [f"{name}: {'unit unknown; ' * (not unit)}{why}"] if why else []
        if unit:
            si, factor = ("m/s^2", GRAVITY / _ACCELERATIONS[unit]) if unit in _ACCELERATIONS else to_si(unit)[:2]
            result = [_scaled(r, name, si, factor) if name in r.channels else r for r in result]
    return result, notes


def together(gyro: Channel, orientation: Channel) -> Together | None:
    """How a gyro's turns go with those of a quaternion w, x, y, z; None where either hardly turns."""
    good = np.isfinite(gyro.values).all(axis=1)
    time = np.arange(
        max(gyro.time[0], orientation.time[0]), min(gyro.time[-1], orientation.time[-1]) - STRIDE, 0.5 * STRIDE
    )
    if np.count_nonzero(good) < 3 or len(time) < 20:
        return None
    values = gyro.values[good] - np.median(gyro.values[good], axis=0)
    angles = _summed(gyro.time[good], values)
    by_gyro = between(time + STRIDE, gyro.time[good], angles) - between(time, gyro.time[good], angles)
    by_pose = _turns(orientation, time)
    known = np.isfinite(by_pose).all(axis=1)
    if np.count_nonzero(known) < 20:
        return None
    a, b = (x[known] - np.median(x[known], axis=0) for x in (by_gyro, by_pose))
    left, strengths, right = np.linalg.svd(a.T @ b)
    sizes = math.sqrt(float(np.sum(a**2) * np.sum(b**2)))
    if sizes == 0.0:
        return None
    size = math.sqrt(float(np.sum(a**2) / np.sum(b**2)))
    return Together(size, left @ right, float(strengths.sum() / sizes), strengths / strengths.sum())


def orientations(recording: Recording) -> dict[str, Channel]:
    """Its orientations as quaternions w, x, y, z, by their channels' names; not what was reckoned from a gyro itself."""
    found, gone = {}, reckoned_of(recording)
    for name, c in recording.channels.items():
        if name in gone:
            continue
        if set(c.labels) == set(ANGLES) and c.unit == "rad":
            found[name] = c.replace(labels=QUATERNION, unit="", values=quaternion_of(c.select(ANGLES).values))
        elif set(c.labels) == set(QUATERNION) and is_unit(c.values[np.isfinite(c.values).all(axis=1)]):
            found[name] = c.select(QUATERNION)
    return found


def _is_open(channel: Channel) -> bool:
    of_sensor = is_accelerometer(channel) or is_gyro(channel.name)
    return of_sensor and not channel.unit and not channel.units and _has_axes(channel)


def _has_axes(channel: Channel) -> bool:
    """Whether its columns are x, y and z, or those of a sensor along these (gyro.x)."""
    return tuple(label[-1:] for label in sorted(channel.labels)) == AXES


def _along_axes(channel: Channel) -> Array:
    """(T, 3) its values along x, y and z."""
    return channel.select(sorted(channel.labels)).values


def _acceleration(name: str, recordings: Sequence[Recording]) -> tuple[str, str]:
    """The unit of an accelerometer ('' if unknown), and why: what stays of it over a second is gravity."""
    seen = float(np.median(np.concatenate([_calm(r.channels[name]) for r in recordings])))
    unit = nearest(seen, _ACCELERATIONS)
    if unit:
        return (
            unit,
            f"{seen:.4g} stays over a second, which is gravity in {_NAMES.get(unit, unit)}: {_say(unit)}",
        )
    if seen > GRAVITY:  # in the smallest unit in which it is no thousandths: raw numbers of a converter
        return (
            "",
            f'{seen:.5g} stays over a second. If that is gravity, give unit = "m/s^2", scale = {GRAVITY / seen:.5g}',
        )
    return "", f"{seen:.3g} stays over a second, which is gravity in no unit: is it without gravity?"


def _calm(channel: Channel) -> Array:
    """(n,) lengths of an accelerometer's mean over stretches of a second; (1,) over all of a shorter one."""
    pieces = np.floor((channel.time - channel.time[0]) / CALM).astype(int)
    means = [np.nanmean(channel.values[pieces == k], axis=0) for k in np.unique(pieces)]
    return np.linalg.norm(means, axis=1)


def _rate(name: str, recordings: Sequence[Recording]) -> tuple[str, str]:
    """The unit of a gyro ('' if unknown), and why."""
    seen = [
        (found.factor, other) for r in recordings for other, c in orientations(r).items()
        if (found := together(r.channels[name], c)) is not None and found.fits > CORRELATED
    ]  # fmt: skip
    if seen:
        size = float(np.median([factor for factor, _ in seen]))
        unit = nearest(size, RATES)
        if unit:
            return (
                unit,
                f"it turns {size:.3g} times as far as '{seen[0][1]}' does in rad, as a gyro in {unit}: {_say(unit)}",
            )
        return "", f"it turns {size:.3g} times as far as '{seen[0][1]}' does in rad"
    unit, beside = _by_gravity(name, recordings)
    if unit:
        return (
            unit,
            f"what '{beside}' shows of gravity turns as it does in {unit}: {_say(unit)}",
        )
    largest = max(float(np.nanmax(np.abs(r.channels[name].values), initial=0.0)) for r in recordings)
    if largest > _FASTEST:
        return (
            "deg/s",
            f"it reaches {largest:.4g}, and gyros of robots {_FASTEST:g} rad/s: {_say('deg/s')}",
        )
    return "", ""


def _by_gravity(name: str, recordings: Sequence[Recording]) -> tuple[str, str]:
    """The unit of a gyro by how the gravity turns that an accelerometer beside it shows, and that; '' where nothing tells.

    Least squares of the changes from stride to stride, of which the mean over each is taken: units are so far apart that a
    slope which is not clearly zero, and is pushed about by what else accelerates, still tells them.
    """
    turned, seen, beside = [], [], ""
    for r in recordings:
        others = [n for n, c in r.channels.items() if n != name and _shows_gravity(c) and _has_axes(c)]
        gyro = r.channels[name]
        if (
            len(others) != 1
            or not np.isfinite(gyro.values).all()
            or not np.isfinite(r.channels[others[0]].values).all()
        ):
            continue
        beside, pulls = others[0], r.channels[others[0]]
        time = np.arange(max(gyro.time[0], pulls.time[0]), min(gyro.time[-1], pulls.time[-1]) - STRIDE, STRIDE)
        if len(time) < 3:
            continue
        up = between(gyro.time, pulls.time, _along_axes(pulls) / np.median(_calm(pulls)))
        turns = _along_axes(gyro)
        rates = np.cross(up, turns - np.median(turns, axis=0))
        turned.append(np.diff(_means(time, gyro.time, _summed(gyro.time, rates)), axis=0).ravel())
        seen.append(np.diff(_means(time, gyro.time, up), axis=0).ravel())
    if not turned:
        return "", ""
    x, y = np.concatenate(turned), np.concatenate(seen)
    slope = float(x @ y) / max(float(x @ x), TINY)
    error = math.sqrt(float(np.sum((y - slope * x) ** 2)) / max(float(x @ x), TINY) / len(x))
    if slope < STANDARD_ERRORS * error:
        return "", ""
    return min(("rad/s", "deg/s"), key=lambda unit: abs(math.log(slope * RATES[unit]))), beside


def _shows_gravity(channel: Channel) -> bool:
    return is_accelerometer(channel) or "gravity" in channel.name


def _summed(time: Array, rates: Array) -> Array:
    """(T, 3) what rates (T, 3) come to since the first instant."""
    steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(time)[:, None]
    return np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])


def _means(begins: Array, time: Array, values: Array) -> Array:
    """(n, 3) means of values (T, 3) over a stride from each instant on."""
    sums = _summed(time, values)
    return (between(begins + STRIDE, time, sums) - between(begins, time, sums)) / STRIDE


def _say(unit: str) -> str:
    """What to write into a mapping, which knows thousandths of g by a scale alone."""
    said = f'unit = "m/s^2", scale = {GRAVITY / _ACCELERATIONS[unit]:.5g}' if unit == "mg" else f'unit = "{unit}"'
    return f"say {said} of it in the mapping, and it is compared, too"


def _scaled(recording: Recording, name: str, unit: str, factor: float) -> Recording:
    channel = recording.channels[name]
    return recording.with_channel(channel.replace(unit=unit, values=factor * channel.values))


def _turns(orientation: Channel, time: Array) -> Array:
    """(n, 3) rotation vectors in rad, in the body's frame, from each instant to `STRIDE` later."""
    q = orientation.values / np.linalg.norm(orientation.values, axis=1, keepdims=True)
    # From one sample to the next a quaternion may change its sign, which is the same orientation.
    signs = np.cumprod(np.concatenate([[1.0], np.where(np.nansum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)]))
    good = np.isfinite(q).all(axis=1)
    first, second = (between(t, orientation.time[good], (q * signs[:, None])[good]) for t in (time, time + STRIDE))
    return rotation_between(first, second)
