# SPDX-License-Identifier: Apache-2.0
"""Is a log what was asked for? Channels, joints and their order, duration, clock, the command, the path."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.ends import end_of
from trueup.formats.rules.drive import FULL_LOCK
from trueup.inspection.standing import standing
from trueup.inspection.unmeasured import unmeasured
from trueup.recording import Channel, Recording
from trueup.robots.by_hand.begin import completed, side_by_side
from trueup.rounding import ROUNDED
from trueup.trial import Trial
from trueup.units import to_si

_TIMES = ("ms", "us", "ns", "min")
"""Units of clocks, in which a log is written or as which one in s is read."""
_COMPLETE, _ARRIVED = (
    0.95,
    0.6,
)  # share of the duration that must be there: of a command; of a run that ends by arriving
_TOO_LONG = 1.6
_SAME_COMMAND = 0.15  # root mean square difference from what was asked, as a share of its spread
_ASTRAY = 0.25  # median distance from the path, as a share of its extent
_PLAINLY = 0.5  # correlation of turns with steering, below zero where one of the two has the wrong sign
_AWRY = 0.7  # rad, median angle between where a vehicle points and where it goes


def mismatches(trial: Trial, recording: Recording) -> list[str]:
    """What is not as asked for, one sentence each with what mends it; [] for a log that can be used."""
    found = _channels(trial, recording)
    if found:
        return found
    found = _lasts(trial, recording) or _missing(trial, recording) or _stood(trial, recording)
    if found:
        return found
    return _commands(trial, recording) + _follows(trial, recording) + _steers(trial, recording)


def _channels(trial: Trial, recording: Recording) -> list[str]:
    found = []
    if lost := [f"'{name}'" for name in trial.observed if not recording.has(name)]:
        names = " or ".join(filter(None, (", ".join(lost[:-1]), lost[-1])))
        has = ", ".join(_words(c) for c in recording.channels.values())
        found.append(f"there is no channel {names} in it; it holds {has}: a wrong file, or mapping.toml must say where")
    for name, o in ((n, o) for n, o in trial.observed.items() if recording.has(n)):
        channel = recording.channel(name)
        missing = [label for label in o.labels if label not in channel.labels]
        if missing:
            found.append(
                f"channel '{name}' lacks {', '.join(missing)}; it has {', '.join(channel.labels)}: give the joints their "
                "names in mapping.toml (labels, or [joints])"
            )
        elif o.unit and channel.unit and o.unit != channel.unit:
            found.append(f"channel '{name}' is in {channel.unit}, asked for in {o.unit}: say the unit in mapping.toml")
    return found


def _words(channel: Channel) -> str:
    """A channel with its labels, where these say more than its name."""
    return channel.name if channel.labels == (channel.name,) else f"{channel.name} ({', '.join(channel.labels)})"


def _lasts(trial: Trial, recording: Recording) -> list[str]:
    """The shortest of the observed channels must cover the run."""
    lasts = min(recording.channel(n).time[-1] - recording.channel(n).time[0] for n in trial.observed)
    if lasts <= 0.0:
        return ["it holds a single instant"]
    ratio = lasts / trial.duration
    sizes = {unit: to_si(unit)[1] for unit in _TIMES}
    clocks = {1.0 / size: unit for unit, size in sizes.items()} | {s: f"s read as {unit}" for unit, s in sizes.items()}
    for factor, unit in clocks.items():
        if abs(np.log(ratio / factor)) < 0.5:
            return [
                f"it lasts {lasts:.4g} s, {ratio:.3g} times the {trial.duration:.4g} s that were asked for: its clock is in "
                f"another unit ({unit}); say it in mapping.toml, [time], unit"
            ]
    enough = _COMPLETE if trial.command is not None else _ARRIVED
    if ratio < enough and end_of(recording, trial.ends) is None:
        return [
            f"it lasts {lasts:.4g} s of {trial.duration:.4g} s: still being written, or broken off? If the run was stopped, "
            f"put {trial.name}-aborted.txt beside it"
        ]
    if ratio > _TOO_LONG:
        return [
            f"it lasts {lasts:.4g} s, {ratio:.2g} times what was asked for: does it hold two runs? cut out the right one"
        ]
    return []


def _missing(trial: Trial, recording: Recording) -> list[str]:
    """What is observed was measured all along, from where the run begins."""
    return [
        f"{words}, so nobody can say what the robot did there: run it again, or put {trial.name}-aborted.txt beside it"
        for words in unmeasured(trial, completed(trial, recording))
    ]


def _stood(trial: Trial, recording: Recording) -> list[str]:
    words = standing(trial, recording)
    return [f"{words}: run it again, or put {trial.name}-aborted.txt beside it"] if words else []


def _commands(trial: Trial, recording: Recording) -> list[str]:
    """The command recorded is the one requested; where none was recorded, the joints follow it in the right order."""
    asked = trial.command
    if asked is None:
        return []
    for name in ("command", "command_sent"):
        if recording.has(name):
            done = recording.channel(name)
            labels = [label for label in asked.labels if label in done.labels]
            if len(labels) < len(asked.labels):
                lost = [label for label in asked.labels if label not in labels]
                return [
                    f"channel '{name}' lacks {', '.join(lost)}, which were commanded; it has {', '.join(done.labels)}"
                ]
            found = _as_asked(asked, done)
            return found + (_swapped(asked, recording) if not found else [])
    return _swapped(asked, recording)


def _as_asked(asked: Channel, done: Channel) -> list[str]:
    request, sent = side_by_side(asked, done)
    spread = np.maximum(request.std(axis=0), 1e-3 * max(ROUNDED, float(request.std())))
    off = np.sqrt(np.mean((sent - request) ** 2, axis=0)) / spread
    wrong = [k for k in range(len(off)) if off[k] > _SAME_COMMAND]
    if not wrong:
        return []
    for k in wrong:
        others = np.sqrt(np.mean((sent[:, [k]] - request) ** 2, axis=0)) / spread
        best = int(np.argmin(others))
        if best != k and others[best] < _SAME_COMMAND:
            return [
                f"the command recorded for '{asked.labels[k]}' is what was asked of '{asked.labels[best]}': the joints are "
                "in another order; give the columns their right labels in mapping.toml"
            ]
    names = ", ".join(f"'{asked.labels[k]}' ({100 * off[k]:.0f} % off)" for k in wrong[:4])
    return [
        f"the command recorded is not the one asked for: {names}; is this the log of another run, or in another unit?"
    ]


def _swapped(asked: Channel, recording: Recording) -> list[str]:
    """Positions that follow another joint's command."""
    if not recording.has("position"):
        return []
    position = recording.channel("position")
    labels = [label for label in asked.labels if label in position.labels]
    if len(labels) < 2:
        return []
    request, moved = side_by_side(asked.select(labels), position.select(labels))
    moving = request.std(axis=0) > 1e-3
    for k, label in enumerate(labels):
        if not moving[k] or moved[:, k].std() < 1e-3:
            continue
        alike = [_correlation(moved[:, k], request[:, j]) if moving[j] else 0.0 for j in range(len(labels))]
        best = int(np.argmax(alike))
        if best != k and alike[best] > 0.8 and alike[k] < 0.5:
            return [
                f"the position of '{label}' follows what was asked of '{labels[best]}': the joints are in another order; "
                "give the columns their right labels in mapping.toml"
            ]
    return []


def _follows(trial: Trial, recording: Recording) -> list[str]:
    """Positions lie near the path that was to be followed."""
    path = trial.references.get("path")
    if path is None or not recording.has("position"):
        return []
    position = recording.channel("position")
    if not {"x", "y"} <= set(path.labels) or not {"x", "y"} <= set(position.labels):
        return []
    wanted = path.values[:, [path.labels.index("x"), path.labels.index("y")]]
    driven = position.select(("x", "y")).values
    driven = driven[np.isfinite(driven).all(axis=1)]
    if not len(driven):
        return ["its positions are all missing"]
    few, dense = _thin(driven, 200), _thin(wanted, 2000)
    away = np.sqrt(((few[:, None, :] - dense[None, :, :]) ** 2).sum(axis=2)).min(axis=1)
    extent = float(np.ptp(wanted, axis=0).max())
    if np.median(away) <= max(_ASTRAY * extent, 0.5):
        return []
    ratio = float(np.ptp(driven, axis=0).max()) / max(extent, ROUNDED)
    unit = " (its extent is about a thousand times the path's: in mm?)" if 300 < ratio < 3000 else ""
    return [f"its positions lie {np.median(away):.3g} m from the path{unit}: another run, frame or unit?"]


def _steers(trial: Trial, recording: Recording) -> list[str]:
    """Angles of a vehicle are in rad, and it goes where it points: a heading in degrees still has the right shape."""
    asked = trial.observed.get("command")
    if asked is None or "steering" not in asked.labels:
        return []
    found = []
    largest = float(np.nanmax(np.abs(recording.channel("command").column("steering"))))
    if largest > FULL_LOCK:
        found.append(
            f"its steering reaches {largest:.3g} rad: in degrees? say in mapping.toml, [channels.command], what one of its "
            "numbers is (scale, one for each label; a degree is 0.01745)"
        )
    if {"position", "heading"} <= set(trial.observed):
        found += _points(recording) or _turns(recording)
    return found


def _legs(recording: Recording) -> tuple[Array, Array]:
    """(41,) when each fortieth of the way begins and ends, in s, and (41, 2) where; none for what does not move."""
    position = recording.channel("position")
    place = position.select(("x", "y")).values
    known = np.isfinite(place).all(axis=1)
    time, place = position.time[known], place[known]
    gone = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(place, axis=0).T))])
    if len(time) < 2 or gone[-1] <= 0.0:
        return np.zeros(0), np.zeros((0, 2))
    legs = np.interp(np.linspace(0.0, gone[-1], 41), gone + ROUNDED * np.arange(len(gone)), time)
    return legs, np.stack([np.interp(legs, time, column) for column in place.T], axis=1)


def _turns(recording: Recording) -> list[str]:
    """A vehicle that is steered to the left turns to the left."""
    legs, _ = _legs(recording)
    if not len(legs):
        return []
    command, heading = recording.channel("command"), recording.channel("heading")
    within = np.linspace(legs[:-1], legs[1:], 9)
    steered = command.select(("steering",)).at(within.ravel())[:, 0].reshape(within.shape).mean(axis=0)
    turned = np.angle(np.exp(1j * np.diff(heading.at(legs)[:, 0])))
    known = np.isfinite(steered + turned)
    if known.sum() < 0.5 * len(known) or _correlation(steered[known], turned[known]) > -_PLAINLY:
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
    if _off(shown - way) <= _AWRY:
        return []
    others = {"in degrees (unit)": np.radians(shown), "growing to the right (sign = -1)": -shown,
              "counted from north (sign = -1, offset = -1.5708)": np.pi / 2 - shown}  # fmt: skip
    better = [words for words, angle in others.items() if _off(angle - way) < 0.5 * _AWRY]
    mend = better[0] if better else "in degrees (unit), growing to the right (sign = -1) or from another zero (offset)"
    return [
        f"it does not go where its heading points ({_off(shown - way):.2g} rad off in the median): is the heading {mend}? "
        "say it in mapping.toml, [channels.heading]"
    ]


def _off(angles: Array) -> float:
    """Median size of angles, whole turns aside; 0 without any."""
    known = angles[np.isfinite(angles)]
    return float(np.median(np.abs(np.angle(np.exp(1j * known))))) if len(known) else 0.0


def _correlation(a: Array, b: Array) -> float:
    return float(np.corrcoef(a, b)[0, 1]) if a.std() > 0 and b.std() > 0 else 0.0


def _thin(points: Array, most: int) -> Array:
    return points[:: max(1, len(points) // most)]


def one_of(trials: Sequence[Trial], recording: Recording) -> list[Trial]:
    """The trials whose request a recording fits."""
    return [t for t in trials if not mismatches(t, recording)]
