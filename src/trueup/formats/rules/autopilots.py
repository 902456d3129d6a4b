# SPDX-License-Identifier: Apache-2.0
"""What autopilots call what they drive: numbers of PX4's actuators, angles of a guidance along lines; no joints.

PX4 numbers its controls (docs.px4.io, Control Allocation, and actuator_controls of versions before 1.14: roll, pitch, yaw,
throttle; of a rover its yaw steers); which output drives what its frame says, and no log of it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from trueup.arrays import Array
from trueup.formats.rules.names import stem, words
from trueup.formats.rules.proposal import Proposal, unchanged
from trueup.formats.rules.rule import Column, Example
from trueup.formats.table import Table, listing

EXAMPLES = (
    # A car's autopilot: it neither rolls nor pitches.
    Example("timestamp,actuator_controls_0/control[0],actuator_controls_0/control[1],actuator_controls_0/control[2],"
            "actuator_controls_0/control[3],vehicle_local_position/x,vehicle_local_position/y",
            "0 0 0 .1 .2 1 2|100 0 0 .2 .2 1.1 2|200 0 0 .3 .4 1.2 2", "command[] throttle steering; position[m] x y"),
    Example("timestamp,actuator_motors/control[0],actuator_motors/control[1],actuator_servos/control[0],"
            "vehicle_local_position/x,vehicle_local_position/y",
            "0 .1 0 .1 1 2|100 .2 0 .2 1.1 2|200 .3 0 .1 1.2 2", "command[] throttle steering; position[m] x y"),
    # What rolls and pitches is none; nor is anything a joint that an autopilot numbers.
    Example("timestamp,timestamp_sample,control[0],control[1],control[2],control[3]",
            "0 0 .1 .1 .1 .2|100 90 .2 .3 .2 .2|200 190 .1 .2 .3 .4", "autopilot_control[] 0 1 2 3"),
    Example("timestamp,actuator_outputs_0/output[0],actuator_outputs_0/output[1],actuator_outputs_0/noutputs",
            "0 1500 1400 2|100 1510 1450 2|200 1600 1430 2", "autopilot_output[] 0 1"),
    # Angles of a tractor's guidance, which are no joints where nothing says where it drove.
    Example("t,guidanceLineSteerAngle,actualSteerAngleDegrees,crossTrackError,speed",
            "0 10 9 1 5|.1 20 11 2 5|.2 15 19 1 5", "guidance_line_steer_angle[] guidance_line_steer_angle"),
    Example("t,latitude,longitude,speed,heading,guidanceLineSteerAngle,actualSteerAngleDegrees,crossTrackError",
            "0 48 11 5 90 10 9 1|.1 48 12 5 91 20 11 2|.2 49 12 5 92 15 19 1",
            "command[m/s,rad] speed steering; position[deg] latitude longitude; heading[rad] heading"),
    # ArduPilot's rover: the outputs of its servos 1 and 3, unless its parameters say otherwise.
    Example("TimeUS,RCOU.C1,RCOU.C3,NKF1.PN,NKF1.PE,ATT.Yaw",
            "0 1500 1600 1 2 90|100000 1550 1650 1.1 2 91|200000 1600 1600 1.2 2 92",
            "command[] throttle steering; position[m] x y; heading[rad] heading"),
    Example("t,ControllerOutput_ThrottlePWM,ControllerOutput_SteerPWM,EKF_PosN,EKF_PosE",
            "0 1500 1600 1 2|.1 1550 1650 1.1 2|.2 1600 1600 1.2 2", "command[] throttle steering; position[m] x y"),
    # A joint that steers is one beside other words.
    Example("t,steer_pos,steer_cmd", "0 .1 .1|.1 .2 .1|.2 .3 .2", "command[rad] steer; position[rad] steer"),
)  # fmt: skip

WORD = "autopilot"
"""A word of names by which columns are read that no joint has."""
_NUMBER = re.compile(r"(?P<topic>.*?)(?P<field>control|output)(?:\[|[._])0*(?P<index>\d+)\]?$")
_TOPIC = re.compile(r"actuator_(?P<what>controls|outputs|motors|servos)(?:_(?P<group>\d+))?", re.IGNORECASE)
_THROTTLED, _STEERS = "actuator_controls.throttle", "actuator_controls.steering"
_SERVO = re.compile(r"(?:^|[/.])RCOU[/._]C(?P<index>\d+)$")
"""What ArduPilot calls the outputs of its servos."""
_ROVERS = MappingProxyType({"1": _STEERS, "3": _THROTTLED})
"""Which of them a rover of ArduPilot has, as SERVO1_FUNCTION and SERVO3_FUNCTION are unless they are set otherwise."""
_SAMPLED = "timestamp_sample"
"""A column that PX4 writes beside what it controls."""
_ROLL, _PITCH, _YAW, _THROTTLE = "0", "1", "2", "3"
_GUIDED = (frozenset(["guidance"]), frozenset(["crosstrack"]), frozenset(["cross", "track"]), frozenset(["xte"]))
"""Words of which one set tells that something is steered along lines."""
_STEERED = frozenset(["steer", "steering", "wheel", "speed", "velocity", "heading", "course"])

_Key = tuple[str, str]
"""Table and column."""


def read_as(tables: Sequence[Table], read: Mapping[str, str]) -> dict[_Key, str]:
    """The names of columns as they are to be read: those of actuators by what PX4 drives with them, all others by `read`."""
    found = {(table.name, name): read[name] for table in tables for name in table.columns}
    numbers = {key: what for table in tables for name in table.columns
               if (what := _actuator(table, name)) is not None and (key := (table.name, name))}  # fmt: skip
    moving = {what for (table, name), what in numbers.items() if _moves(_columns_of(tables, table)[name])}
    driving = _driving(moving)
    for key, what in numbers.items():
        found[key] = driving.get(what, f"{WORD}_{what[1]}_{what[2]}")
    return found


def _columns_of(tables: Sequence[Table], name: str) -> Mapping[str, Array]:
    return next(table.columns for table in tables if table.name == name)


def _actuator(table: Table, name: str) -> tuple[str, str, str] | None:
    """Topic, field and number of what PX4 drives; None for anything else."""
    servo = _SERVO.search(name)
    if servo is not None:
        return "rcou", "output", servo["index"]
    match = _NUMBER.match(name)
    if match is None:
        return None
    topic = _TOPIC.search(match["topic"]) or _TOPIC.search(stem(table.name))
    if topic is None:
        return ("", match["field"], match["index"]) if _SAMPLED in table.columns and not match["topic"] else None
    group = topic["group"] if topic["what"].lower() == "controls" else ""
    return f"{topic['what'].lower()}{group if group not in ('', '0', None) else ''}", match["field"], match["index"]


def _moves(values: Array) -> bool:
    known = values[np.isfinite(values)]
    return bool(known.size) and float(np.ptp(known)) > 0.0


def _driving(moving: set[tuple[str, str, str]]) -> dict[tuple[str, str, str], str]:
    """What is read as throttle and steering: of one that neither rolls nor pitches, or that has one motor and one servo."""
    told = {index for topic, _, index in moving if topic == "controls"}
    if told and not told & {_ROLL, _PITCH}:
        return {("controls", "control", _THROTTLE): _THROTTLED, ("controls", "control", _YAW): _STEERS}
    if {index for topic, _, index in moving if topic == "rcou"} == {*_ROVERS}:
        return {("rcou", "output", n): name for n, name in _ROVERS.items()}
    motors, servos = ([what for what in moving if what[0] == topic] for topic in ("motors", "servos"))
    if len(motors) == len(servos) == 1:
        return {motors[0]: _THROTTLED, servos[0]: _STEERS}
    return {}


def without_guided(proposals: Sequence[Proposal], columns: Sequence[Column]) -> list[Proposal]:
    """What steers or drives along lines of a guidance is put aside: it is a vehicle's, and no joint's."""
    if not _guided(columns):
        return list(proposals)
    return [unchanged(p.column) if p.role and _STEERED & set(words(p.column.name)) else p for p in proposals]


def _guided(columns: Sequence[Column]) -> bool:
    return any(said <= set(words(column.name)) for column in columns for said in _GUIDED)


def notes(columns: Sequence[Column], used: Sequence[Column]) -> list[str]:
    """Which columns are an autopilot's or a guidance's and were left out, why, and what to do; `used`: those of a vehicle."""
    left = [column for column in columns if column not in used]
    notes = []
    numbered = [column.name for column in left if WORD in column.parts.words]
    if numbered and not used:
        notes.append(
            f"{listing(numbered, 4)}: what an autopilot (PX4, ArduPilot) drives actuators with, and no joints: left out. Of "
            "a rover control[2] of actuator_controls_0 steers and control[3] is the throttle: name these in the mapping, in "
            '[channels.command] with labels = ["steering", "throttle"], and vehicle_local_position as [channels.position]'
        )
    driving = {
        column.read_as.rpartition(".")[2]: column.name for column in used if column.read_as in (_THROTTLED, _STEERS)
    }
    if driving:
        notes.append(
            f"{' and '.join(driving.values())}: taken for {' and '.join(driving)}, as rovers of PX4 and ArduPilot have them "
            "unless they are set otherwise; if these are others, name in [channels.command] what drove it"
        )
    guided = [column.name for column in left if _STEERED & set(words(column.name))]
    if guided and _guided(columns) and not used:
        notes.append(
            f"{listing(guided, 4)}: of a vehicle that a guidance steers along lines, and no joints: left out. A vehicle's "
            "log also says where it drove (x and y, or latitude and longitude), which is missing here"
        )
    return notes
