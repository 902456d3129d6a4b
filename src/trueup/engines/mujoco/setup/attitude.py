# SPDX-License-Identifier: Apache-2.0
"""How a robot was turned all along, by its gyro and its accelerometer."""

from __future__ import annotations

import mujoco
import numpy as np

from trueup.arrays import Array, Mask
from trueup.articulated.inertial import CALM
from trueup.articulated.pose import (
    ANGLES,
    AXES,
    ORIENTATION,
    angles_of,
    product,
    quaternion_of,
    quaternions_of_vectors,
    rates_of,
)
from trueup.ends import TILT
from trueup.engines.mujoco.setup.stance import BEGINNING
from trueup.formats.rules.names import words
from trueup.inspection.sensors import is_gyro
from trueup.instant import MOVING
from trueup.noise import estimate_noise
from trueup.recording import Channel, Recording
from trueup.rounding import TINY
from trueup.samples import between, unwound
from trueup.units import GRAVITY

_FEWEST = 5  # samples of a smoothing spline
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
    upright = _upright(pulls[rests if rests.any() else time <= time[0] + CALM].mean(axis=0))
    rates = rates + _drift(time, rates, pulls, upright)
    turns = _turned(time, rates, upright)
    calm = np.var(pulls[rests], axis=0).sum() if rests.any() else 1.0
    weights = np.where(rests, np.var(pulls, axis=0).sum() / max(calm, TINY), 1.0)
    for _ in range(_ROUNDS if len(time) >= _FEWEST else 0):
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
    gyros = [name for name, c in wanted.items() if c.unit == "rad/s" and is_gyro(name)]
    if len(shown) != 1 or len(gyros) != 1:
        return None
    gravity, gyro = (wanted[name].select(AXES) for name in (*shown, *gyros))
    up = -gravity.values / np.maximum(np.linalg.norm(gravity.values, axis=1, keepdims=True), TINY)
    up *= np.sign(np.median(up[:, 2]))  # some log what holds it up
    if np.median(up[:, 2]) < np.cos(TILT):
        return None
    rates = between(gravity.time, gyro.time, _from_rest(gyro.time, gyro.values)[0])
    angles = np.stack(
        [np.arctan2(up[:, 1], up[:, 2]), -np.arcsin(np.clip(up[:, 0], -1.0, 1.0)), np.zeros(len(up))], axis=1
    )
    turns = rates_of(angles, rates)[:, 2]
    angles[1:, 2] = np.cumsum(0.5 * (turns[1:] + turns[:-1]) * np.diff(gravity.time))
    return Channel(ORIENTATION, ANGLES, "rad", gravity.time, unwound(angles)), (f"'{shown[0]}'", f"'{gyros[0]}'")


def _from_rest(time: Array, rates: Array) -> tuple[Array, Mask]:
    """A gyro's rates (T, 3) without what it shows at rest, its error, if it begins so; and (T,) which samples are that."""
    first = time <= time[0] + BEGINNING
    moves = np.any(np.std(rates[first], axis=0) > MOVING * estimate_noise(rates, time))
    return (rates, np.zeros(len(time), dtype=np.bool_)) if moves else (rates - rates[first].mean(axis=0), first)


def _drift(time: Array, rates: Array, pulls: Array, upright: Array) -> Array:
    """(3,) rad/s that are to be added to a gyro's rates for gravity to stay where it is, in the mean: a complementary filter
    (Mahony, Hamel and Pflimlin, IEEE Transactions on Automatic Control 2008, the passive one) has to add so much, which
    begins with the quaternion `upright` (4,).
    """
    turn, matrix, added = upright.copy(), np.empty(9), np.zeros(3)
    for i, dt in enumerate(np.diff(time).tolist()):
        mujoco.mju_quat2Mat(matrix, turn)
        more = np.cross(pulls[i] / GRAVITY, matrix[6:]) / CALM
        added += more * dt
        mujoco.mju_quatIntegrate(turn, 0.5 * (rates[i] + rates[i + 1]) + more, dt)
    return np.asarray(added / (time[-1] - time[0]), dtype=np.float64)


def _turned(time: Array, rates: Array, upright: Array) -> Array:
    """(T, 4) quaternions by the gyro alone, from the first on."""
    turn, turns = upright.copy(), np.empty((len(time), 4))
    turns[0] = turn
    for i, dt in enumerate(np.diff(time).tolist()):
        mujoco.mju_quatIntegrate(turn, 0.5 * (rates[i] + rates[i + 1]), dt)
        turns[i + 1] = turn
    return turns


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
