# SPDX-License-Identifier: Apache-2.0
"""Is a recording the run that was asked for? How long it lasts, by which clock, and which joint followed which command."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.ends import end_of
from trueup.evidence import HALVED
from trueup.inspection.relations import ALIKE, nearest
from trueup.inspection.requested import side_by_side
from trueup.inspection.suspicions import in_another_unit
from trueup.instant import samples_of_cubic, usual_step
from trueup.noise import FEWEST
from trueup.recording import Channel, Recording
from trueup.rounding import TINY
from trueup.samples import correlation
from trueup.trial import Trial
from trueup.units import AS_FAR, hardly_radians, numbers_of, size_of

_TIMES = ("ms", "us", "ns", "min")
"""Units of clocks, in which a log is written or as which one in s is read."""
_COMPLETE, _ARRIVED = (
    0.95,
    0.6,
)  # share of the duration that must be there: of a command; of a run that ends by arriving
_LARGER = {"rad": {"degrees": numbers_of("deg")}, "m": {"mm": numbers_of("mm")}}
"""Unit to others, in which numbers are so many times as large: nobody begins a run that far away."""


@dataclass(frozen=True)
class Unlike:
    """One thing in which a recording is not what was asked for."""

    kind: str
    """'instant', 'clock', 'short', 'long', 'order' or 'unit': what mends it depends on where recordings come from."""
    words: str


def lasting(trial: Trial, recording: Recording) -> Unlike | None:
    """How the shortest of the observed channels, all of which the recording has, fails to cover the run; None if it does."""
    if not trial.observed:
        return None
    lasts = min(recording.channel(n).time[-1] - recording.channel(n).time[0] for n in trial.observed)
    if lasts <= 0.0:
        return Unlike("instant", "it holds a single instant")
    ratio = lasts / trial.duration
    ended = ratio < 1.0 and end_of(recording, trial.ends) is not None
    # How long a run was that ended early tells no clock; how far apart its samples are does.
    paced = _paced(trial, recording) if ended else ratio
    sizes = {unit: size_of(unit) for unit in _TIMES}
    clocks = {1.0 / size: unit for unit, size in sizes.items()} | {s: f"s read as {unit}" for unit, s in sizes.items()}
    for factor, unit in clocks.items():
        if max(abs(np.log(ratio / factor)), abs(np.log(paced / factor))) < 0.5:
            return Unlike(
                "clock",
                f"it lasts {lasts:.4g} s, {ratio:.3g} times the {trial.duration:.4g} s that were asked for: its clock is in "
                f"another unit ({unit})",
            )
    enough = _COMPLETE if trial.command is not None else _ARRIVED
    if ratio < enough and not ended:
        return Unlike("short", f"it lasts {lasts:.4g} s of {trial.duration:.4g} s")
    if ratio > AS_FAR:
        return Unlike("long", f"it lasts {lasts:.4g} s, {ratio:.2g} times what was asked for")
    return None


def _paced(trial: Trial, recording: Recording) -> float:
    """Times as far apart as was asked for that samples are, of the channel in which that is least."""
    apart = [
        np.median(np.diff(recording.channel(n).time)) / np.median(np.diff(o.time))
        for n, o in trial.observed.items()
        if len(o.time) > 1
    ]
    return float(min(apart, default=1.0))


def swapped(asked: Channel, recording: Recording) -> Unlike | None:
    """Positions that follow another joint's command; None where there are none."""
    if not recording.has("position"):
        return None
    position = recording.channel("position")
    labels = [label for label in asked.labels if label in position.labels]
    if len(labels) < 2:
        return None
    request, moved = side_by_side(asked.select(labels), position.select(labels))
    moving = request.std(axis=0) > 1e-3
    for k, label in enumerate(labels):
        if not moving[k] or moved[:, k].std() < 1e-3:
            continue
        alike = [correlation(moved[:, k], request[:, j]) if moving[j] else 0.0 for j in range(len(labels))]
        best = int(np.argmax(alike))
        if best != k and alike[best] > 0.8 and alike[k] < ALIKE:
            own = correlation(moved[:, best], request[:, best])
            if own >= ALIKE and alike[k] >= -0.8:
                continue  # the other is where it belongs: this one gives way under the load that the other's motion brings
            turned = f", or '{label}' is logged with the other sign" if alike[k] < -0.8 and own > 0.8 else ""
            followed = f"the position of '{label}' follows what was asked of '{labels[best]}'"
            return Unlike("order", f"{followed}: the joints are in another order{turned}")
    return None


def missized(asked: Channel, recording: Recording) -> Unlike | None:
    """Positions in the unit of what was asked of them that follow it so many times as large as another unit would make them:
    a log that names no unit is taken to be in the one that was asked for.
    """
    position = recording.channels.get("position")
    labels = [label for label in asked.labels if position is not None and label in position.labels]
    if position is None or not labels:
        return None
    told, moved = asked.select(labels), position.select(labels)
    if any(told.unit_of(label) != moved.unit_of(label) for label in labels):
        return None
    request, followed = side_by_side(told, moved)
    time = np.arange(len(request), dtype=np.float64)
    said = in_another_unit(told.replace(time=time, values=request), moved.replace(time=time, values=followed))
    return Unlike("unit", said) if said else None


def sized(trial: Trial, recording: Recording) -> Unlike | None:
    """Positions that begin so many times as far from zero as the run does as another unit would make them, or that name no
    unit and reach further than joints do in rad: nothing else tells it of runs in which the robot's own controller commands.
    """
    for name, observed in trial.observed.items():
        channel = recording.channels.get(name)
        if channel is None or name != "position":
            continue
        if said := _begun(trial, channel.select([label for label in observed.labels if label in channel.labels])):
            return Unlike("unit", said)
        most = float(np.nanmax(np.abs(channel.values), initial=0.0))
        if observed.unit == "rad" and not any((channel.unit, *channel.units)) and hardly_radians(most):
            return Unlike("unit", f"'{name}' names no unit and reaches {most:.4g}, asked for in rad: is it in degrees?")
    return None


def _begun(trial: Trial, channel: Channel) -> str:
    """What is wrong with where positions begin, in words; '' where that is no other unit."""
    start = trial.initial.get(channel.name)
    labels = [label for label in channel.labels if start is not None and label in start.labels]
    if start is None or not labels or len(channel.time) < FEWEST:
        return ""
    few = samples_of_cubic(usual_step(channel.time))  # of which the middle one is where a log begins
    asked, first = start.select(labels).values[0], np.nanmedian(channel.select(labels).values[:few], axis=0)
    unit = start.unit_of(labels[0])
    size = float(first @ asked) / max(float(asked @ asked), TINY)
    said = nearest(size, _LARGER.get(unit, {}))
    if not said or np.sum((first - size * asked) ** 2) > HALVED * np.sum(first**2):
        return ""
    return f"{channel.name} begins at {_numbers(first)}, {size:.3g} times the {_numbers(asked)} {unit} asked for: in {said}?"


def _numbers(values: Array) -> str:
    return ", ".join(f"{v:.4g}" for v in values)
