# SPDX-License-Identifier: Apache-2.0
"""What drives a vehicle, chosen among its signals: throttle or speed, and what steers it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trueup.formats.mapping import TimeColumn
from trueup.formats.rules import joints
from trueup.formats.rules.leading import leading
from trueup.formats.rules.names import COMMANDED
from trueup.formats.rules.rule import Column
from trueup.formats.rules.vehicles import Signal, best
from trueup.formats.rules.wheels import Pair
from trueup.formats.rules.wiring import measured
from trueup.tracking.commands import BEYOND

_DRIVING = ("throttle", "brake", "steering", "angle", "curvature", "speed", "sideways", "erpm", "yaw_rate")
"""Kinds of signals that may drive a vehicle."""

_BY_OTHERS = (
    "{}: taken for the commanded speed, since the log commands the steering alone: a person drives, as of a tractor that "
    "steers itself, and nothing in it tells how a speed follows its command; if a column does, name it in [channels.command]"
)


def commanded(
    signals: Sequence[Signal],
    columns: Sequence[Column],
    place: Sequence[Signal],
    heading: Sequence[Signal],
    time: TimeColumn,
    paired: Sequence[Pair] = (),
    *,
    joints_ride: bool = False,
) -> tuple[dict[str, Signal], tuple[str, ...]]:
    """What drives it, by label, and what to say of that; nothing where this is no vehicle.

    `paired`: what is there of two driven wheels, which tell where it is as a place does. `joints_ride`: joints are those of
    an arm on the vehicle; else a log that has any is of no vehicle that is told by its place alone.
    """
    kinds = {kind: [s for s in signals if s.kind == kind] for kind in _DRIVING}
    told = {kind: [s for s in each if s.commanded] for kind, each in kinds.items()}
    place = () if _has_joints(signals, columns) and not joints_ride else place
    steering, throttle = _steering(kinds, told, alone=bool(place)), best(kinds["throttle"])
    speed, turn, said = best(told["speed"]) or best(told["erpm"]), best(told["yaw_rate"]), ()
    asked = any(COMMANDED & set(c.parts.words) for c in columns) or any(p.commanded for p in paired)
    if place and not throttle and not speed and not asked:
        led = leading(kinds["speed"], kinds["yaw_rate"], place, heading, time)
        speed, turn, late = led or (None, turn, 0.0)
        # What leads is a command with all of its parts.
        told["sideways"] = [s for s in kinds["sideways"] if speed and s.source == speed.source]
        names = " and ".join(s.column.name for s in (speed, turn) if s is not None)
        said = () if led is None else (
            f"{names}: taken for what was commanded, since the motion follows {1e3 * late:.0f} ms behind and nothing else "
            "says so; if this was measured, name in [channels.command] what was commanded",
        )  # fmt: skip
    aside, warned = _beyond("sideways", told["sideways"])
    behind, also = _beyond("rear_steering", _behind(kinds["steering"]) if steering else ())
    ahead, by_others = _ahead(throttle, speed, steering if place else None, kinds["speed"])
    if steering and ahead:
        brake = best(kinds["brake"]) if "throttle" in ahead else None
        label = "curvature" if steering.kind == "curvature" else "steering"
        more = {"brake": brake, "rear_steering": behind}
        others = {name: s for name, s in more.items() if s}
        return {**ahead, label: steering, **others}, (*said, *by_others, *warned, *also)
    if not (speed and turn and (place or measured(paired))):
        return {}, ()
    return {"speed": speed, "turn": turn, **({"sideways": aside} if aside else {})}, (*said, *warned, *also)


def _ahead(
    throttle: Signal | None, speed: Signal | None, steering: Signal | None, speeds: Sequence[Signal]
) -> tuple[dict[str, Signal], tuple[str, ...]]:
    """What drives it ahead, and what to say of that: of a vehicle whose `steering` alone is commanded how fast it was."""
    measured_speed = best(speeds)
    unused = throttle is not None and len(np.unique(throttle.column.known)) < 2
    if unused and speed:  # Ackermann messages seldom use their acceleration
        throttle = None
    if throttle or speed or not steering or not steering.commanded or not measured_speed:
        return {"throttle": throttle} if throttle else {"speed": speed} if speed else {}, ()
    return {"speed": measured_speed}, (_BY_OTHERS.format(measured_speed.column.name),)


def _beyond(label: str, told: Sequence[Signal]) -> tuple[Signal | None, tuple[str, ...]]:
    """A command of what is not simulated that is not zero throughout, and what to say of it."""
    given = next((s for s in told if np.any(s.column.known != 0.0)), None)
    return given, () if given is None else (
        f"{given.column.name}: {BEYOND[label]}, is not simulated; take drives without it",
    )


def _behind(steers: Sequence[Signal]) -> list[Signal]:
    """What turns the rear wheels of a vehicle that steers its front wheels too."""
    rear = [s for s in steers if "rear" in s.source]
    return rear if len(rear) < len(steers) else []


def _steering(kinds: Mapping[str, list[Signal]], told: Mapping[str, list[Signal]], *, alone: bool) -> Signal | None:
    """What steers: what is called so, a commanded curvature, or, where no joint can be meant, an angle without a name."""
    angles = kinds["angle"] if kinds["throttle"] else told["angle"]
    rear = _behind(kinds["steering"])
    return (
        best([s for s in kinds["steering"] if s not in rear])
        or best(told["curvature"])
        or (best(angles) if alone else None)
    )


def _has_joints(signals: Sequence[Signal], columns: Sequence[Column]) -> bool:
    """Whether a column that no rule of vehicles knows is the position of a joint."""
    known = {s.column for s in signals}
    readings = [joints.read(column.parts) for column in columns if column not in known]
    return any(r.joint and r.kind == "position" and not r.command for r in readings)
