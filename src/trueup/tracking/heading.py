# SPDX-License-Identifier: Apache-2.0
"""The direction a car points to, as a log gives it: a yaw, a quaternion, a compass angle, or only the way it went."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from trueup.arrays import Array, Mask
from trueup.evidence import FEWEST_PARTS, evidence
from trueup.instant import usual_step
from trueup.recording import Channel, Recording
from trueup.rounding import ROUNDED, TINY
from trueup.samples import MOSTLY

Number = TypeVar("Number", np.float64, np.complex128)
_QUATERNIONS = (("qx", "qy", "qz", "qw"), ("x", "y", "z", "w"))
"""Labels of a quaternion, the real part last."""
WAY = 0.05  # m at least between the poses that show a direction of motion, or a jump
SPAN = 0.4  # s, the same
_FADES = 4.0  # s over which the zero of a gyroscope's angle is averaged
_SCALES = np.geomspace(0.5, 2.0, 17)
"""Of a turn rate: wheels that skid turn a robot half as much as they would where they roll, or less."""


def samples_in(span: float, time: Array) -> float:
    """How many usual steps of (T,) instants a span of so many s holds; of clocks that hardly go on, of milliseconds."""
    return span / max(usual_step(time), 1e-3)


def heading_of(recording: Recording) -> Channel | None:
    """The channel 'heading', or the yaw of a recorded quaternion (qx, qy, qz, qw, or the last two; or x, y, z, w), in rad;
    None without.
    """
    channel = next(iter(told_by(recording)), None)
    if channel is None or channel.name == "heading":
        return channel
    names = next(names for names in _QUATERNIONS if set(names[2:]) <= set(channel.labels))
    x, y, z, w = (channel.column(q) if q in channel.labels else 0.0 for q in names)
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return Channel("heading", ("heading",), "rad", channel.time, yaw[:, None])


def told_by(recording: Recording) -> list[Channel]:
    """The channels that tell the heading, as they were recorded, the first choice first."""
    angles = [recording.channel("heading")] if recording.has("heading") else []
    turns = [
        channel for names in _QUATERNIONS for channel in recording.channels.values()
        if set(names[2:]) <= set(channel.labels)  # on a floor the first two are often left out
    ]  # fmt: skip
    return [*angles, *turns]


def course(position: Channel, good: Mask, back: Mask | None = None) -> Channel:
    """The direction of motion at each good sample, from where the car was until then, so that a prediction may start there;
    the other way round where it goes `back` (T,). While it stands, the last direction. NaN elsewhere.
    """
    time, points = position.time[good], position.values[good]
    angle = np.full((len(position.time), 1), np.nan)
    if len(time) > 2:
        moved, sure = _motion_until(time, points)
        if sure.any():
            known = np.flatnonzero(sure)
            turned = 0.0 if back is None else np.pi * back[good][known]
            way = np.unwrap(np.arctan2(moved[known, 1], moved[known, 0]) + turned)
            angle[good, 0] = way[np.maximum(np.searchsorted(known, np.arange(len(time)), side="right") - 1, 0)]
    return Channel("heading", ("heading",), "rad", position.time, angle)


def turned_with(position: Channel, yaw_rate: Channel, good: Mask, back: Mask | None = None) -> Channel | None:
    """The heading at each sample from a gyroscope, set right by the way driven; None where the two do not go together.

    The turn rate adds up to an angle whose zero drifts; the direction from fix to fix, beside the mean angle between them,
    shows the zero, averaged over the last seconds; it is the other way round where the car goes `back` (T,). Nothing that
    comes later counts, so that a prediction may start there, but for how far ahead of the axle the point is (an antenna's
    lever arm), which swings to the outside as the car turns.
    """
    known = np.isfinite(yaw_rate.values[:, 0])
    time, points = position.time[good], position.values[good]
    if known.sum() < 50 or len(time) < 50:
        return None
    clock, rate = yaw_rate.time[known], yaw_rate.values[known, 0]
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(clock))])
    area = np.concatenate([[0.0], np.cumsum(0.5 * (angle[1:] + angle[:-1]) * np.diff(clock))])
    width = max(1, round(samples_in(SPAN, time)))
    moved, lasted = points[width:] - points[:-width], time[width:] - time[:-width]
    way = np.linalg.norm(moved, axis=1)
    usable = (way > telling(points)) & (lasted < 3.0 * SPAN + 0.5)
    usable &= (time[:-width] >= clock[0]) & (time[width:] <= clock[-1])
    if usable.sum() < 50:
        return None
    areas, angles = (np.interp(time, clock, v) for v in (area, angle))
    mean, turned = (areas[width:] - areas[:-width]) / lasted, angles[width:] - angles[:-width]
    ahead: NDArray[np.complex128] = np.where(usable, moved[:, 0] + 1j * moved[:, 1], 0j)
    flipped = np.ones(len(usable)) if back is None else np.where(back[good][width:], -1.0, 1.0)
    clock, went = time[width:], ahead * flipped
    scale = _scale_of(clock[::width], went[::width], mean[::width], turned[::width], flipped[::width])
    agree, summed = _agreeing(scale, clock, went, mean, turned, flipped)
    if agree.mean() < MOSTLY:  # the length of the mean direction: gyroscope and way driven go together
        return None
    angle = np.concatenate([np.zeros(width), np.unwrap(np.angle(summed))]) + scale * angles
    values = np.full((len(position.time), 1), np.nan)
    started = np.concatenate([np.zeros(width, dtype=bool), np.cumsum(usable) > 0])
    values[np.flatnonzero(good)[started], 0] = angle[started]
    return Channel("heading", ("heading",), "rad", position.time, values)


def _scale_of(time: Array, went: NDArray[np.complex128], mean: Array, turned: Array, forward: Array) -> float:
    """What times the measured angle is the vehicle's, as moves that share no sample tell (see `_agreeing`): 1 or -1 as of a
    gyroscope, unless they agree clearly better on another, as on that of wheels that skid in every turn.
    """
    moves, lasts = (time, went, mean, turned, forward), time[-1] - time[0]
    count = min(max(lasts / (2.0 * _FADES), FEWEST_PARTS), lasts / _FADES)
    block = ((time - time[0]) / max(lasts, TINY) * int(count)).astype(np.int64)
    index = np.unique(block[np.abs(went) > 0.0], return_inverse=True)[1]

    def apart(scale: float) -> Array:
        return np.asarray(np.bincount(index, 1.0 - _agreeing(scale, *moves)[0]), dtype=np.float64)

    usual = min((1.0, -1.0), key=lambda s: apart(s).sum())
    rough = min((*_SCALES.tolist(), *(-_SCALES).tolist()), key=lambda s: apart(s).sum())
    finer = np.geomspace(_SCALES[0], _SCALES[1], 9) / _SCALES[0]
    best = min((rough * k for k in (*finer.tolist(), *(1.0 / finer).tolist())), key=lambda s: apart(s).sum())
    without, with_it = apart(usual), apart(best)
    sure = len(without) >= FEWEST_PARTS and evidence(without, with_it, without + with_it).holds
    return best if sure else usual


def _agreeing(
    scale: float, time: Array, went: NDArray[np.complex128], mean: Array, turned: Array, forward: Array
) -> tuple[Array, NDArray[np.complex128]]:
    """What `_zero_of` gives for moves `went` (T,) in m, the vehicle's angle being `scale` times the one that was measured:
    `mean` (T,) between their ends, `turned` (T,) from one to the other; `forward` (T,) is -1 where it backs off.
    """
    swung = np.where(np.abs(went) > 0.0, 2.0 * np.sin(0.5 * scale * turned), 0.0) * forward
    return _zero_of(time, went * np.exp(-1j * scale * mean), swung)


def _zero_of(time: Array, went: NDArray[np.complex128], swung: Array) -> tuple[Array, NDArray[np.complex128]]:
    """How well each (M,) of the moves of a point (T,), complex in m and 0 where none, seen from the mean angle of a gyroscope
    between their ends, agrees with those before it on its zero (at best 1), and sums (T,) whose argument that is. `swung`
    (T,) is how far a point a metre ahead of the axle moves to the left by the turn alone.

    A lever arm says which part of each move goes across, and so the zero; what then goes across, regressed on the turn, is
    the lever arm: where both agree is found by the secant method.
    """
    from scipy.optimize import root_scalar  # half a second to load, and rarely needed

    size = np.maximum(np.abs(went), TINY)

    def zeros(arm: float) -> NDArray[np.complex128]:
        across = np.clip(arm * swung / size, -1.0, 1.0)
        return _fading(time, went * (np.sqrt(1.0 - across**2) - 1j * across))

    def beyond(arm: float) -> float:
        across = np.imag(went * np.exp(-1j * np.angle(zeros(arm))))
        return float(np.sum(across * swung)) / max(float(np.sum(swung**2)), TINY) - arm

    first = beyond(0.0)
    found = root_scalar(beyond, method="secant", x0=0.0, x1=first) if abs(first) > ROUNDED else None
    summed = zeros(float(found.root) if found is not None and found.converged else 0.0)
    there, weight = np.abs(went) > 0.0, _fading(time, np.abs(went))
    return np.abs(summed[there]) / weight[there], summed


def _fading(time: Array, values: NDArray[Number]) -> NDArray[Number]:
    """(T,) sums over the past in which what is _FADES s old counts a third."""
    out, now = np.zeros_like(values), values.dtype.type(0.0)
    keep = np.exp(-np.diff(time, prepend=time[0]) / _FADES)
    for k in range(len(values)):
        now = now * keep[k] + values[k]
        out[k] = now
    return out


def backing(position: Channel, heading: Channel, good: Mask) -> Mask:
    """(T,) where a good sample goes against its heading, farther than the noise of the points could feign."""
    time, points, angle = position.time[good], position.values[good], heading.values[good, 0]
    back = np.zeros(len(good), dtype=bool)
    if len(time) > 2:
        moved, sure = motion(time, points)
        along = np.cos(angle) * moved[:, 0] + np.sin(angle) * moved[:, 1]
        back[good] = sure & (along < -telling(points))
    return back


def telling(points: Array) -> float:
    """How far in m one of (T, 2) points must have gone to show a direction: farther than their noise could feign."""
    return max(WAY, 4.0 * float(np.median(np.abs(np.diff(points, n=2, axis=0)))))


def _motion_until(time: Array, points: Array) -> tuple[Array, Mask]:
    """(T, 2) velocity at the end of a parabola through the last SPAN s, and where it shows one.

    It does where the car went farther in that time than the noise of the points could feign. Where SPAN holds fewer than ten
    samples, up to ten are taken: as many as foretell best where the next one lies, for long windows blur curves.
    """
    least, most = max(round(samples_in(SPAN, time)) + 1, 4), 10
    velocity, far = np.zeros_like(points), np.zeros(len(time), dtype=bool)
    if len(time) <= max(least, most):
        return velocity, far
    fits = {width: _parabolas(time, points, width) for width in range(least, max(least, most) + 1)}
    width = min(fits, key=lambda w: float(np.median(fits[w][1][most - w :]))) if len(fits) > 1 else least
    velocity[width - 1 :] = fits[width][0]
    moved = np.linalg.norm(points[width - 1 :] - points[: 1 - width], axis=1)
    lasted = time[width - 1 :] - time[: 1 - width]
    far[width - 1 :] = (moved > telling(points)) & (lasted < 3.0 * width * usual_step(time))
    return velocity, far


def _parabolas(time: Array, points: Array, width: int) -> tuple[Array, Array]:
    """(T - width + 1, 2) velocity at the end of a parabola through each `width` samples, (T - width,) its distance in m from
    the sample after them.
    """
    since = sliding_window_view(time, width) - time[width - 1 :, None]
    span = -since[:, 0]
    share = since / span[:, None]
    table = np.stack([np.ones_like(share), share, share**2], axis=2)
    seen = sliding_window_view(points, width, axis=0) - points[width - 1 :, :, None]
    normal = np.einsum("twi,twj->tij", table, table)
    found = np.linalg.solve(normal, np.einsum("twi,tcw->tic", table, seen))
    ahead = np.diff(time)[width - 1 :] / span[:-1]
    foretold = found[:-1, 0] + found[:-1, 1] * ahead[:, None] + found[:-1, 2] * ahead[:, None] ** 2
    return found[:, 1] / span[:, None], np.linalg.norm(np.diff(points, axis=0)[width - 1 :] - foretold, axis=1)


def motion(time: Array, points: Array) -> tuple[Array, Mask]:
    """(T, 2) how the point moves around each sample, and where that is far enough to show a direction."""
    half = max(1, round(0.5 * samples_in(SPAN, time)))
    index = np.arange(len(time))
    before, after = np.maximum(index - half, 0), np.minimum(index + half, len(time) - 1)
    moved = points[after] - points[before]
    return moved, (np.linalg.norm(moved, axis=1) > WAY) & (time[after] - time[before] < 3.0 * SPAN)
