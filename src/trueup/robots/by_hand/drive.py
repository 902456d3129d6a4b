# SPDX-License-Identifier: Apache-2.0
"""Is a log the drive that was asked for? Where it starts, its path, its frame, its commands, its angles."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.evidence import HALVED
from trueup.inspection.relations import ALIKE
from trueup.recording import Recording
from trueup.rounding import ROUNDED
from trueup.samples import between, correlation, thinned, way_along, wrapped
from trueup.tracking.windows import moves
from trueup.trial import Trial
from trueup.units import FULL_LOCK

_PLACE = ("x", "y")
_PLACED, _ASIDE = 0.5, 0.1  # m, and share of a path's extent, within which anyone places a robot, be it a car or a toy
_MIRRORS = (
    ("y turned over (sign = [1, -1], heading sign = -1)", (0, 1), (1.0, -1.0)),
    ("x turned over (sign = [-1, 1], heading sign = -1 and offset = -3.1416)", (0, 1), (-1.0, 1.0)),
    ("x and y exchanged (their columns; heading sign = -1 and offset = -1.5708)", (1, 0), (1.0, 1.0)),
)
"""How frames are mixed up that grow to the other side: in words, the columns and their signs."""
_AWRY = 0.25 * np.pi  # rad: a vehicle that goes further off than that goes rather to a side than ahead
_ASTRAY = 0.25  # median distance from the path, as a share of its extent


def unlike_its_path(trial: Trial, recording: Recording) -> list[str]:
    """Positions lie near the path that was to be followed, from where the run was to start, and are no mirror image of it."""
    path = trial.references.get("path")
    if path is None or not recording.has("position"):
        return []
    position = recording.channel("position")
    if not set(_PLACE) <= set(path.labels) or not set(_PLACE) <= set(position.labels):
        return []
    wanted = path.values[:, [path.labels.index(label) for label in _PLACE]]
    driven = position.select(_PLACE).values
    driven = driven[np.isfinite(driven).all(axis=1)]
    if not len(driven):
        return ["its positions are all missing"]
    extent = float(np.ptp(wanted, axis=0).max())
    placed = max(_ASIDE * extent, min(_PLACED, _ASTRAY * extent))
    return _mirrored(driven, wanted, placed) or _astray(driven, wanted, extent) or _elsewhere(trial, driven, placed)


def _mirrored(driven: Array, wanted: Array, near: float) -> list[str]:
    """A mirror image of the drive keeps to the path where the drive does not, by more than `near` m."""
    as_is, *mirrored = (
        _apart(x, wanted) for x in (driven, *(driven[:, columns] * signs for _, columns, signs in _MIRRORS))
    )
    best = int(np.argmin(mirrored))
    if as_is <= near or mirrored[best] > HALVED * as_is:
        return []
    return [
        f"it is a mirror image of the path: {as_is:.3g} m from it after the same way, {mirrored[best]:.3g} m with "
        f"{_MIRRORS[best][0]}. Is its frame another? say so in mapping.toml, [channels.position], [channels.heading] and, "
        "where steering is turned over with them, [channels.command]"
    ]


def _apart(driven: Array, wanted: Array) -> float:
    """Median distance in m of a drive (N, 2) from a path (M, 2) after the same way along each, as far as both go."""
    few = thinned(driven, 200)  # so that noise adds little to the way
    ways = [way_along(p) for p in (few, wanted)]
    at = np.linspace(0.0, min(way[-1] for way in ways), 200)
    places = [between(at, way, p) for way, p in zip(ways, (few, wanted), strict=True)]
    return float(np.median(np.hypot(*(places[0] - places[1]).T)))


def _astray(driven: Array, wanted: Array, extent: float) -> list[str]:
    few, dense = thinned(driven, 200), thinned(wanted, 2000)
    away = np.sqrt(((few[:, None, :] - dense[None, :, :]) ** 2).sum(axis=2)).min(axis=1)
    if np.median(away) <= max(_ASTRAY * extent, _PLACED):
        return []
    ratio = float(np.ptp(driven, axis=0).max()) / max(extent, ROUNDED)
    unit = " (its extent is about a thousand times the path's: in mm?)" if 300 < ratio < 3000 else ""
    return [f"its positions lie {np.median(away):.3g} m from the path{unit}: another run, frame or unit?"]


def _elsewhere(trial: Trial, driven: Array, placed: float) -> list[str]:
    """The drive begins within `placed` m of where the run was to start."""
    start = trial.initial.get("position")
    if start is None or not set(_PLACE) <= set(start.labels):
        return []
    asked, first = start.select(_PLACE).values[0], np.median(driven[:5], axis=0)
    off = float(np.hypot(*(first - asked)))
    if off <= placed:
        return []
    return [
        f"it begins {off:.3g} m from where the run was to start (at x {first[0]:.3g}, y {first[1]:.3g} m, not x "
        f"{asked[0]:.3g}, y {asked[1]:.3g} m): place the robot there and start the log as it starts; where its frame has "
        "another origin, say the offset in mapping.toml, [channels.position]"
    ]


def unlike_a_vehicle(trial: Trial, recording: Recording) -> list[str]:
    """Angles of a vehicle are in rad, and it goes where it points: a heading in degrees still has the right shape."""
    asked = trial.observed.get("command")
    if asked is None or "steering" not in asked.labels:
        return []
    found = _uncommanded(recording) if recording.has("position") else []
    if found:
        return found
    largest = float(np.nanmax(np.abs(recording.channel("command").column("steering"))))
    if largest > FULL_LOCK:
        found.append(
            f"its steering reaches {largest:.3g} rad: in degrees? say in mapping.toml, [channels.command], what one of its "
            "numbers is (scale, one for each label; a degree is 0.01745)"
        )
    if {"position", "heading"} <= set(trial.observed):
        found += _points(recording) or _turns(recording)
    return found


def _uncommanded(recording: Recording) -> list[str]:
    """A vehicle that drives was told a speed, and a controller that holds it on a path never steers by one same angle."""
    _, places = _legs(recording)
    if not len(places) or not moves(recording.channel("position").select(_PLACE).values):
        return []
    command = recording.channel("command")
    constant = {label for label in command.labels if float(np.ptp(_known(command.column(label)))) <= ROUNDED}
    still = [label for label in ("speed", "throttle") if label in constant and not _known(command.column(label)).any()]
    way = np.unwrap(np.arctan2(*np.diff(places, axis=0).T[::-1]))
    still += ["steering"] if "steering" in constant and float(np.ptp(way)) > _AWRY else []
    if not still:
        return []
    values = " and ".join(f"{label} stays at {float(_known(command.column(label))[0]):.4g}" for label in still)
    return [
        f"its commands are not what drove it: {values} while it goes {float(np.hypot(*np.ptp(places, axis=0))):.3g} m far. "
        "Log what the controller sends to motors and steering: without that no simulator can be calibrated"
    ]


def _known(values: Array) -> Array:
    """Those that are numbers; a zero where none is."""
    known = values[np.isfinite(values)]
    return known if len(known) else np.zeros(1)


def _legs(recording: Recording) -> tuple[Array, Array]:
    """(41,) when each fortieth of the way begins and ends, in s, and (41, 2) where; none for what does not move."""
    position = recording.channel("position")
    place = position.select(("x", "y")).values
    known = np.isfinite(place).all(axis=1)
    time, place = position.time[known], place[known]
    gone = way_along(place)
    if len(time) < 2 or gone[-1] <= 0.0:
        return np.zeros(0), np.zeros((0, 2))
    legs = np.interp(np.linspace(0.0, gone[-1], 41), gone + ROUNDED * np.arange(len(gone)), time)
    return legs, between(legs, time, place)


def _turns(recording: Recording) -> list[str]:
    """A vehicle that is steered to the left turns to the left."""
    legs, _ = _legs(recording)
    if not len(legs):
        return []
    command, heading = recording.channel("command"), recording.channel("heading")
    within = np.linspace(legs[:-1], legs[1:], 9)
    steered = command.select(("steering",)).at(within.ravel())[:, 0].reshape(within.shape).mean(axis=0)
    turned = wrapped(np.diff(heading.at(legs)[:, 0]))
    known = np.isfinite(steered + turned)
    if known.sum() < 0.5 * len(known) or correlation(steered[known], turned[known]) > -ALIKE:
        return []
    return [
        "it turns to the right where its steering is to the left: does its steering grow to the right? say it in "
        "mapping.toml, [channels.command], sign = [1, -1] (one for each label; its steering second)"
    ]


def _points(recording: Recording) -> list[str]:
    heading = recording.channel("heading")
    legs, ends = _legs(recording)
    if not len(legs):
        return []
    way = np.arctan2(*np.diff(ends, axis=0).T[::-1])
    shown = heading.at(0.5 * (legs[1:] + legs[:-1]))[:, 0]
    awry = _off(shown - way)
    if awry <= _AWRY:
        return []
    others = {"in degrees (unit)": np.radians(shown), "growing to the right (sign = -1)": -shown,
              "counted from north (sign = -1, offset = -1.5708)": np.pi / 2 - shown}  # fmt: skip
    better = [words for words, angle in others.items() if _off(angle - way) < HALVED * _AWRY]
    mend = better[0] if better else "in degrees (unit), growing to the right (sign = -1) or from another zero (offset)"
    return [
        f"it does not go where its heading points ({awry:.2g} rad off in the median): is the heading {mend}? "
        "say it in mapping.toml, [channels.heading]"
    ]


def _off(angles: Array) -> float:
    """Median size of angles, whole turns aside; 0 without any."""
    known = angles[np.isfinite(angles)]
    return float(np.median(np.abs(wrapped(known)))) if len(known) else 0.0
