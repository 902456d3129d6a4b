# SPDX-License-Identifier: Apache-2.0
"""Where a car was, in metres: from x and y, from latitude and longitude, or added up from its speed and turn rate."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.errors import RecordingError
from trueup.instant import MISSING, usual_step
from trueup.recording import Channel, Recording
from trueup.tracking.commands import TOGETHER
from trueup.tracking.heading import heading_of

_ON_A_FLOOR, _ON_EARTH = ("x", "y"), ("latitude", "longitude")
_EQUATOR, _FLATTENING = 6378137.0, 1.0 / 298.257223563
"""Half axis in m and flattening of the earth (WGS 84)."""


def place_of(recording: Recording) -> tuple[Channel, Channel | None, list[str]]:
    """Position (x, y in m), the heading that came with it if it had to be added up, and notes.

    Raises RecordingError where nothing tells the position.
    """
    if not recording.has("position"):
        return _added_up(recording)
    position = recording.channel("position")
    if set(_ON_EARTH) <= set(position.labels):
        return _on_the_ground(position), None, []
    return position.select(_ON_A_FLOOR), None, []


def tells_place(position: Channel) -> bool:
    """Whether a channel has the labels of a place on a floor or on earth."""
    return any(set(labels) <= set(position.labels) for labels in (_ON_A_FLOOR, _ON_EARTH))


def fresh(channel: Channel) -> Channel:
    """The samples with something new, where a log repeats what a slower sensor said last; the channel itself elsewhere.

    Between two fixes a repeated position stands still and then jumps, which no car does. While the sensor says the same for
    long (the car stands) samples are kept at its usual rate. A fix whose first row is missing came at an unknown instant
    before the row that shows it: it is left out.
    """
    values = channel.values
    same = np.all((values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1])), axis=1)
    begun = np.flatnonzero(np.concatenate([[True], ~same]))
    runs = np.diff(np.append(begun, len(values)))
    usual = int(np.median(runs[1:-1])) if len(runs) > 20 else 1
    if usual < 2:  # the rows are no more frequent than the sensor
        return channel
    missing = np.concatenate([[0.0], np.diff(channel.time)])[begun] > MISSING * usual_step(channel.time)
    starts = begun + usual * missing
    kept = np.concatenate([np.arange(a, b, usual) for a, b in zip(starts, begun + runs, strict=True)])
    return channel.replace(time=channel.time[kept], values=values[kept])


def _on_the_ground(position: Channel) -> Channel:
    """East and north of the first fix, in m (tangent plane; a drive is short beside the earth's radius)."""
    angle = position.select(_ON_EARTH).values
    known = angle[np.isfinite(angle).all(axis=1) & (angle != 0.0).any(axis=1)]  # 0, 0: no fix yet
    if not len(known):
        return position.replace(labels=("x", "y"), unit="m", values=np.full(angle.shape, np.nan))
    bulge = _FLATTENING * (2.0 - _FLATTENING)  # eccentricity squared
    latitude = float(known[0, 0])
    root = np.sqrt(1.0 - bulge * np.sin(latitude) ** 2)
    north, east = _EQUATOR * (1.0 - bulge) / root**3, _EQUATOR * np.cos(latitude) / root
    values = np.stack([east * (angle[:, 1] - known[0, 1]), north * (angle[:, 0] - known[0, 0])], axis=1)
    values[~(angle != 0.0).any(axis=1)] = np.nan
    return position.replace(labels=("x", "y"), unit="m", values=values)


def _added_up(recording: Recording) -> tuple[Channel, Channel, list[str]]:
    """Dead reckoning: the way that wheel speed and turn rate (or heading) add up to, from the origin."""
    heading = heading_of(recording)
    if not recording.has("speed") or (heading is None and not recording.has("yaw_rate")):
        raise RecordingError(
            f"recording '{recording.name}' has no channel 'position'; a car is calibrated on a tracked pose: name the "
            f"columns of x and y as 'position' and the yaw as 'heading' in the mapping, or at least 'speed' (m/s) and "
            f"'yaw_rate' (rad/s), which add up to one (it has: {', '.join(recording.channels)}). For a pose in a file of its "
            f"own: {TOGETHER}"
        )
    turning = recording.channel("yaw_rate") if heading is None else heading
    time = turning.time
    speed = recording.channel("speed").at(time)[:, 0]
    values = turning.values[:, 0]
    known = np.isfinite(values) & np.isfinite(speed)
    step = np.diff(time, prepend=time[0])
    if heading is None:
        angle = np.cumsum(_middle(np.where(known, values, 0.0)) * step)
    else:
        angle = np.interp(time, time[known], np.unwrap(values[known])) if known.any() else np.zeros(len(time))
    v, direction = _middle(np.where(known, speed, 0.0)), _middle(angle)
    way = np.cumsum(np.stack([v * np.cos(direction), v * np.sin(direction)], axis=1) * step[:, None], axis=0)
    source = "turn rate" if heading is None else "heading"
    note = (
        f"no position was recorded: the way that speed and {source} add up to stands for it, so that errors of these two are "
        "not seen"
    )
    position = Channel("position", ("x", "y"), "m", time, np.where(known[:, None], way, np.nan))
    return position, Channel("heading", ("heading",), "rad", time, angle[:, None]), [note]


def _middle(values: Array) -> Array:
    """Means of neighbours, the first by itself."""
    return np.concatenate([values[:1], 0.5 * (values[1:] + values[:-1])])
