# SPDX-License-Identifier: Apache-2.0
"""How a robot was turned all along: as its inertial unit says, or by a gyro and an accelerometer."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array, Mask
from trueup.articulated.inertial import CALM
from trueup.articulated.pose import (
    ANGLES,
    AXES,
    ORIENTATION,
    QUATERNION,
    angles_of,
    headed,
    product,
    quaternion_of,
    quaternions_of_vectors,
    rates_of,
    up_of,
)
from trueup.ends import TILT
from trueup.formats.rules.bases import OTHERS, SOURCES, TURNS
from trueup.formats.rules.names import words
from trueup.inspection.sensors import is_gyro
from trueup.instant import MOVING
from trueup.noise import FEWEST, estimate_noise
from trueup.recording import Channel, Recording
from trueup.rounding import TINY
from trueup.samples import between, is_unit, unwound
from trueup.units import GRAVITY, hardly_radians

BEGINNING = 0.1
"""s in which a robot rests that begins at rest."""
_TURNS = TURNS | {"q"}
"""Names that say by themselves how something was turned."""
_ROUNDS = 3  # of what the accelerometer mends, each of which leaves the cube of the tilt


def smoothed_attitude(time: Array, rates: Array, pulls: Array) -> tuple[Array, Array]:
    """(T, 3) roll, pitch, yaw and (T, 3) how fast they change, by a gyro (T, 3) in rad/s and an accelerometer (T, 3) in m/s^2
    about the axes of what they are on, at instants (T,) in s.

    The gyro tells all that is quick. What it drifts is drawn, by a smoothing spline (C. H. Reinsch, Numerische Mathematik 10,
    1967), to where the accelerometer has what is up, before and after each instant: by what it measures as it is and not by
    the direction of that, since forces of many steps add up to the weight, their directions do not. A rest at the beginning
    counts as much more as it scatters less.
    """
    rates, rests = _from_rest(time, rates)
    up = pulls[rests if rests.any() else time <= time[0] + CALM].mean(axis=0)
    rates = rates + _drift(time, rates, pulls, up)
    turns = _turned(time, rates, _upright(up))
    calm = np.var(pulls[rests], axis=0).sum() if rests.any() else 1.0
    weights = np.where(rests, np.var(pulls, axis=0).sum() / max(calm, TINY), 1.0)
    for _ in range(_ROUNDS if len(time) >= FEWEST else 0):
        up = _in_world(turns, pulls) / GRAVITY
        tilt = np.stack([up[:, 1], -up[:, 0]], axis=1)
        turns = product(quaternions_of_vectors(np.pad(_smooth(time, tilt, weights), ((0, 0), (0, 1)))), turns)
    angles = unwound(angles_of(turns))
    return angles, rates_of(angles, rates)


def by_gravity(recording: Recording) -> tuple[Channel, tuple[str, ...]] | None:
    """Roll, pitch and yaw by where gravity points for the body, as learned controllers are told (`projected_gravity`), with
    yaw by a gyro in rad/s from 0 on; and what told them. None where either is not there, or there twice.
    """
    wanted = {
        n: c for n, c in recording.channels.items() if tuple(sorted(c.labels)) == AXES and np.isfinite(c.values).all()
    }
    shown = [name for name in wanted if "gravity" in words(name)]
    gyro = _gyro_of(recording)
    if len(shown) != 1 or gyro is None:
        return None
    gravity = wanted[shown[0]].select(AXES)
    up = -gravity.values / np.maximum(np.linalg.norm(gravity.values, axis=1, keepdims=True), TINY)
    up *= np.sign(np.median(up[:, 2]))  # some log what holds it up
    if np.median(up[:, 2]) < np.cos(TILT):
        return None
    angles = np.stack(
        [np.arctan2(up[:, 1], up[:, 2]), -np.arcsin(np.clip(up[:, 0], -1.0, 1.0)), np.zeros(len(up))], axis=1
    )
    told = Channel(ORIENTATION, ANGLES, "rad", gravity.time, angles)
    return _headed_by(told, gyro), (f"'{shown[0]}'", f"'{gyro.name}'")


def by_tilt(recording: Recording) -> tuple[Channel, tuple[str, ...]] | None:
    """Roll, pitch and yaw where an inertial unit tells roll and pitch alone: yaw is by a gyro in rad/s from 0 on, NaN where
    there is none. And what told them. None where no tilt is told, or several are.
    """
    told = _upright_ones(recording, {"roll", "pitch"})
    if len(told) != 1:
        return None
    gyro, tilt = _gyro_of(recording), told[0].replace(name=ORIENTATION)
    if gyro is None or not np.isfinite(tilt.values[:, :2]).all():
        return tilt, (f"'{told[0].name}'",)
    return _headed_by(tilt, gyro), (f"'{told[0].name}'", f"'{gyro.name}'")


def _gyro_of(recording: Recording) -> Channel | None:
    """The only gyro in rad/s that has no gaps, its axes in their order."""
    found = [
        c for name, c in recording.channels.items()
        if tuple(sorted(c.labels)) == AXES and c.unit == "rad/s" and is_gyro(name) and np.isfinite(c.values).all()
    ]  # fmt: skip
    return found[0].select(AXES) if len(found) == 1 else None


def _headed_by(tilt: Channel, gyro: Channel) -> Channel:
    """Roll and pitch (T, 3) with yaw by what a gyro turns, from 0 on."""
    rates = between(tilt.time, gyro.time, _from_rest(gyro.time, gyro.values)[0])
    angles = headed(tilt.values)
    turns = rates_of(angles, rates)[:, 2]
    angles[1:, 2] = np.cumsum(0.5 * (turns[1:] + turns[:-1]) * np.diff(tilt.time))
    return tilt.replace(values=unwound(angles))


def _from_rest(time: Array, rates: Array) -> tuple[Array, Mask]:
    """A gyro's rates (T, 3) without what it shows at rest, its error, if it begins so; and (T,) which samples are that."""
    first = time <= time[0] + BEGINNING
    moves = np.any(np.std(rates[first], axis=0) > MOVING * estimate_noise(rates, time))
    return (rates, np.zeros(len(time), dtype=np.bool_)) if moves else (rates - rates[first].mean(axis=0), first)


def _drift(time: Array, rates: Array, pulls: Array, up: Array) -> Array:
    """(3,) rad/s that are to be added to a gyro's rates for gravity to stay where it is, in the mean: a complementary filter
    (Mahony, Hamel and Pflimlin, IEEE Transactions on Automatic Control 2008, the passive one) has to add so much, which
    begins with what points `up` (3,).
    """
    x, y, z = (up / np.linalg.norm(up)).tolist()
    steps, mean, added = np.diff(time).tolist(), 0.5 * (rates[1:] + rates[:-1]), np.zeros((len(time) - 1, 3))
    for i, (dt, (p, q, r), (a, b, c)) in enumerate(zip(steps, mean.tolist(), (pulls / GRAVITY).tolist(), strict=False)):
        more = ((b * z - c * y) / CALM, (c * x - a * z) / CALM, (a * y - b * x) / CALM)
        p, q, r = p + more[0], q + more[1], r + more[2]
        x, y, z = x + dt * (y * r - z * q), y + dt * (z * p - x * r), z + dt * (x * q - y * p)
        length = (x * x + y * y + z * z) ** 0.5
        x, y, z, added[i] = x / length, y / length, z / length, more
    return np.asarray(np.diff(time) @ added / (time[-1] - time[0]), dtype=np.float64)


def _turned(time: Array, rates: Array, upright: Array) -> Array:
    """(T, 4) quaternions by the gyro alone, from the first on."""
    turns = quaternions_of_vectors(0.5 * (rates[1:] + rates[:-1]) * np.diff(time)[:, None])
    found = [tuple(upright.tolist())]
    for a, b, c, d in turns.tolist():  # each about the body's own axes
        w, x, y, z = found[-1]
        found.append((
            w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c, w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ))  # fmt: skip
    return np.array(found)


def _upright(up: Array) -> Array:
    """(4,) the quaternion, without yaw, of a body for which what points up is along (3,)."""
    return quaternion_of(np.array([np.arctan2(up[1], up[2]), np.arctan2(-up[0], np.hypot(up[1], up[2])), 0.0]))


def _in_world(turns: Array, vectors: Array) -> Array:
    """(T, 3) vectors (T, 3) of bodies turned by quaternions (T, 4), along the axes of the world."""
    scalar, axis = turns[:, :1], turns[:, 1:]
    return vectors + 2.0 * np.cross(axis, np.cross(axis, vectors) + scalar * vectors)


def _smooth(time: Array, values: Array, weights: Array) -> Array:
    """(T, k) what lasts of values (T, k), weighted by (T,), over twice the time in which steps average out."""
    from scipy.interpolate import make_smoothing_spline  # takes long to import

    step = float(time[-1] - time[0]) / (len(time) - 1)
    return np.asarray(
        make_smoothing_spline(time, values, weights, lam=(2.0 * CALM) ** 4 / step)(time), dtype=np.float64
    )


def attitude(recording: Recording) -> Channel | None:
    """How the robot was turned, as an inertial unit, or whatever is on its base, says under another name than
    `base_orientation`: a quaternion, or roll, pitch and yaw, upright in the median. None where nothing, or several, do.
    """
    upright = _upright_ones(recording, set(ANGLES))  # a unit that is mounted otherwise says more
    return upright[0] if len(upright) == 1 else None


def _upright_ones(recording: Recording, wanted: set[str]) -> list[Channel]:
    """What says how the base was turned in all angles that are `wanted`, and in no other, upright in the median."""
    found = list[Channel]()
    alone = [recording.channels.get(f"q{axis}") for axis in QUATERNION]
    single = all(c is not None and c.values.shape[1] == 1 for c in alone)  # four channels, named by their axes alone
    if single and wanted == set(ANGLES):
        first, *more = [c for c in alone if c is not None]
        if all(np.array_equal(c.time, first.time) for c in more):
            values = np.hstack([first.values, *(c.values for c in more)])
            found.append(first.replace(name="qw, qx, qy, qz", labels=QUATERNION, unit="", values=values))
    for name, channel in recording.channels.items():
        plain = set(words(name)) - {"deg", "rad"}
        of_base = "imu" in plain or any(plain & source for source in SOURCES) or plain <= _TURNS
        if of_base and not plain & (OTHERS - {"imu"}):
            found += _as_turns(channel, wanted)
    return [c for c in found if _up(c) > np.cos(TILT)]


def _as_turns(channel: Channel, wanted: set[str]) -> list[Channel]:
    """A channel as a quaternion w, x, y, z, or roll, pitch, yaw in rad, NaN where that is not `wanted`; none where it is
    neither.
    """
    ends = [label.rsplit(".", 1)[-1].removeprefix("q") for label in channel.labels]
    good = np.isfinite(channel.values).all(axis=1)
    if sorted(ends) == sorted(QUATERNION) and wanted == set(ANGLES) and is_unit(channel.values[good]):
        order = [ends.index(axis) for axis in QUATERNION]
        return [channel.replace(labels=QUATERNION, unit="", units=(), values=channel.values[:, order])]
    if sorted(ends) != sorted(wanted) or channel.unit not in ("", "rad") or not good.any():
        return []
    degrees = not channel.unit and hardly_radians(float(np.abs(channel.values[good]).max()))
    values = np.full((len(channel.values), len(ANGLES)), np.nan)
    values[:, [ANGLES.index(axis) for axis in ends]] = channel.values
    return [channel.replace(labels=ANGLES, unit="rad", units=(), values=np.radians(values) if degrees else values)]


def _up(channel: Channel) -> float:
    """Cosine of the angle between what points up of the base and of the world, in the median."""
    values = headed(channel.values) if channel.labels == ANGLES else channel.values
    values = values[np.isfinite(values).all(axis=1)]
    return float(np.median(up_of(quaternion_of(values) if channel.labels == ANGLES else values)[:, 2]))
