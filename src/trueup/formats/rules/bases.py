# SPDX-License-Identifier: Apache-2.0
"""The pose of a robot's free base among the columns of a log, whoever named it: position and orientation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.formats.rules.names import EULER, TOOLS, listed, words
from trueup.formats.rules.rule import Column, Example, Rule
from trueup.samples import is_unit
from trueup.units import hardly_radians, to_si

POSITION, ORIENTATION = "base_position", "base_orientation"
PLACES = ("x", "y", "z")
QUATERNION = ("w", "x", "y", "z")
ANGLES = ("roll", "pitch", "yaw")
_COMPONENTS = {f"{letter}{axis}": axis for letter in "pt" for axis in PLACES}
"""px, py, pz and tx, ty, tz: a place or a translation, each number by itself."""
_BARE = frozenset([*PLACES, *ANGLES, *(f"q{c}" for c in QUATERNION)])
"""Columns that are named by their component alone."""
_LEANS = 0.4
"""rad that a robot on feet or wheels leans by: most fall further on. Headings so near to straight back are not told."""
_ROOM = 30.0
"""m: rooms with motion capture are smaller, so larger numbers are millimetres."""


_JOINT = "t,q_hip,q_des_hip,"
RULES = (
    Rule(
        POSITION, "x, y, z",
        (
            Example(_JOINT + "base_x,base_y,base_z,base_qw,base_qx,base_qy,base_qz",
                    "0 .1 .1 1 2 .5 1 0 0 0|.1 .2 .1 1 2 .5 .8 .6 0 0|.2 .1 .2 1 2 .5 1 0 0 0",
                    "position[rad] hip; base_position[m] x y z; base_orientation[] w x y z"),
            Example(_JOINT + "root_pos_x,root_pos_y,root_pos_z,root_quat_x,root_quat_y,root_quat_z,root_quat_w",
                    "0 .1 .1 1 2 .5 0 0 0 1|.1 .2 .1 1 2 .5 .8 .6 0 0|.2 .1 .2 1 2 .5 0 0 0 1",
                    "position[rad] hip; base_position[m] x y z; base_orientation[] w x y z"),
            Example(_JOINT + "mocap_px,mocap_py,mocap_pz,mocap_qw,mocap_qx,mocap_qy,mocap_qz",
                    "0 .1 .1 1 2 .5 1 0 0 0|.1 .2 .1 1 2 .5 .8 .6 0 0|.2 .1 .2 1 2 .5 1 0 0 0",
                    "position[rad] hip; base_position[m] x y z; base_orientation[] w x y z"),
            Example(_JOINT + "mc_x_mm,mc_y_mm,mc_z_mm,mc_qw,mc_qx,mc_qy,mc_qz",
                    "0 .1 .1 9 2 5 1 0 0 0|.1 .2 .1 9 2 5 .8 .6 0 0|.2 .1 .2 9 2 5 1 0 0 0",
                    "position[rad] hip; base_position[mm] x y z; base_orientation[] w x y z"),
            # Of two things nothing tells which is the robot.
            Example(_JOINT + "a_x,a_y,a_z,a_qw,a_qx,a_qy,a_qz,b_x,b_y,b_z,b_qw,b_qx,b_qy,b_qz",
                    "0 .1 .1 9 2 5 1 0 0 0 9 2 5 1 0 0 0|.1 .2 .1 9 2 5 .8 .6 0 0 9 2 5 .8 .6 0 0|"
                    ".2 .1 .2 9 2 5 1 0 0 0 9 2 5 1 0 0 0", "position[rad] hip"),
            Example(_JOINT + "vicon_x,vicon_y,vicon_z,vicon_roll,vicon_pitch,vicon_yaw",
                    "0 .1 .1 900 200 500 0 0 0|.1 .2 .1 900 200 500 .1 0 0|.2 .1 .2 900 210 500 0 0 0",
                    "base_position[mm] x y z; base_orientation[rad] roll pitch yaw"),
        ),
        unit="m",
    ),
    Rule(
        ORIENTATION, "quat, quaternion, orientation, ori, rotation, rot, attitude",
        (
            Example(_JOINT + "base_pos_0,base_pos_1,base_pos_2,base_quat_0,base_quat_1,base_quat_2,base_quat_3",
                    "0 .1 .1 1 2 .5 0 0 0 1|.1 .2 .1 1 2 .5 .6 0 0 .8|.2 .1 .2 1 2 .5 0 0 0 1",
                    "base_position[m] x y z; base_orientation[] w x y z"),
            Example(_JOINT + "base_pos_x,base_pos_y,base_pos_z,base_ori_w,base_ori_x,base_ori_y,base_ori_z",
                    "0 .1 .1 1 2 .5 1 0 0 0|.1 .2 .1 1 2 .5 .8 .6 0 0|.2 .1 .2 1 2 .5 1 0 0 0",
                    "position[rad] hip; base_position[m] x y z; base_orientation[] w x y z"),
            # Upright, whichever way it heads.
            Example(_JOINT + "base_pos_0,base_pos_1,base_pos_2,base_quat_0,base_quat_1,base_quat_2,base_quat_3",
                    "0 .1 .1 1 2 .5 .5 0 0 .866|.1 .2 .1 1 2 .5 .4 0 0 .9165|.2 .1 .2 1 2 .5 .5 0 .05 .8646",
                    "base_position[m] x y z; base_orientation[] w x y z"),
            # Four numbers whose squares do not add up to 1 are no orientation.
            Example(_JOINT + "base_x,base_y,base_z,base_qw,base_qx,base_qy,base_qz",
                    "0 .1 .1 1 2 .5 9 3 0 0|.1 .2 .1 1 2 .5 8 6 0 0|.2 .1 .2 1 2 .5 9 4 0 0", "position[rad] hip"),
        ),
        possible=is_unit,
    ),
    Rule(
        ORIENTATION, ", ".join(sorted(EULER)),
        (
            Example(_JOINT + "base_pos_x,base_pos_y,base_pos_z,base_rpy_r,base_rpy_p,base_rpy_y",
                    "0 .1 .1 1 2 .5 0 0 .9|.1 .2 .1 1 2 .5 .1 0 .91|.2 .1 .2 1 2 .5 0 0 .92",
                    "position[rad] hip; base_position[m] x y z; base_orientation[rad] roll pitch yaw"),
            Example(_JOINT + "base_pos_0,base_pos_1,base_pos_2,base_rpy_0,base_rpy_1,base_rpy_2",
                    "0 .1 .1 1 2 .5 0 0 90|.1 .2 .1 1 2 .5 1 0 91|.2 .1 .2 1 2 .5 0 0 92",
                    "base_position[m] x y z; base_orientation[deg] roll pitch yaw"),
        ),
        unit="rad",
    ),
)  # fmt: skip
SOURCES = tuple(
    frozenset(group.split())
    for group in (
        "mocap vicon opti optitrack qualisys vrpn motive motion capture rigid",
        "ground truth",
        "base trunk torso body root pelvis floating pose robot world",
        "odom odometry estimator",
    )
)
"""Words for whose pose it is or who measured it, the better sources first."""
OTHERS = TOOLS | listed(
    "imu command commanded cmd desired des target goal ref reference foot feet hand camera velocity vel twist "
    "linear angular lin acc accel acceleration speed gyro omega v"
)
TURNS = listed("quat quaternion orientation ori rotation rot attitude") | EULER
"""Words for how something is turned."""


@dataclass(frozen=True, eq=False)
class _Part:
    """One number of a pose: the group of columns that it is in, and which of its numbers."""

    group: str
    at: int
    component: str


@dataclass(frozen=True, eq=False)
class _BaseChannel:
    """One channel of a pose."""

    columns: tuple[Column, ...]
    labels: tuple[str, ...]
    unit: str
    declares_unit: bool
    """Whether the log itself says the unit."""


@dataclass(frozen=True, eq=False)
class Pose:
    """The channels of a base's pose, which groups of columns they were, and what to say of it."""

    channels: Mapping[str, _BaseChannel]
    groups: frozenset[str]
    notes: tuple[str, ...]


def of_place(names: Sequence[str]) -> bool:
    """Whether names (without their axis) are those of a base, trunk or motion capture."""
    plain = {word for name in names for word in words(name)}
    return any(plain & source for source in SOURCES) and not plain & OTHERS


def pose(groups: Mapping[str, Sequence[Column]]) -> Pose:
    """The pose of a base in groups of columns, by name; without channels where there is none.

    Taken are x, y, z, quaternions and roll, pitch, yaw of a base, trunk or motion capture, in columns or lists, from the
    best source that has a whole pose, or from the only thing of any name that has a quaternion beside its place; nothing
    where a number is not there, stands there twice, or cannot be one.
    """
    every = [part for name, group in groups.items() if _may_be(name) for part in _parts(name, group)]
    wholes = [_whole_pose([p for p in every if _source(p.group) == k]) for k in range(len(SOURCES) + 1)]
    notes: list[str] = []
    for places, turn in (w for w in [*wholes, _whole_pose(every), _unnamed(groups)] if w is not None):
        labels = QUATERNION if turn[0].component == "qw" else ANGLES
        values = np.stack([_numbers(groups, part) for part in turn], axis=1)
        used = frozenset(part.group for part in (*places, *turn))
        if labels == QUATERNION and not is_unit(values[np.isfinite(values).all(axis=1)]):
            notes.append(
                f"{', '.join(sorted(used))}: no pose of a base, as the quaternion's length is not 1: is it one?"
            )
            continue
        found = {POSITION: _base_channel(groups, places, PLACES), ORIENTATION: _base_channel(groups, turn, labels)}
        notes += [
            f"{n}: taken as {f.unit}; say so if it is anything else" for n, f in found.items() if not f.declares_unit
        ]
        return Pose(found, used, tuple(dict.fromkeys(notes)))
    return Pose({}, frozenset(), tuple(dict.fromkeys(notes or _half(every))))


def quaternions(columns: Sequence[Column]) -> frozenset[str]:
    """Words, joined, of whatever has a quaternion in columns of its own (mc of mc_qw, mc_qx, mc_qy, mc_qz)."""
    found = dict[str, dict[str, Column]]()
    for column in columns:
        *head, last = words(column.name) or [""]
        if column.width == 1 and last[:1] == "q" and last[1:] in QUATERNION and head and not OTHERS & set(head):
            found.setdefault(" ".join(head), {})[last[1:]] = column
    wholes = {name: np.stack([each[c].values.ravel() for c in QUATERNION], axis=1)
              for name, each in found.items() if len(each) == len(QUATERNION)}  # fmt: skip
    return frozenset(name for name, turns in wholes.items() if is_unit(turns[np.isfinite(turns).all(axis=1)]))


def _unnamed(groups: Mapping[str, Sequence[Column]]) -> tuple[list[_Part], list[_Part]] | None:
    """The pose of the only thing that has a quaternion beside its place, whatever it is called."""
    named = quaternions([c for group in groups.values() for c in group])
    of_things = [_whole_pose(_parts(n, group)) for n, group in groups.items() if " ".join(words(n)) in named]
    return of_things[0] if len(of_things) == 1 else None


def _half(parts: Sequence[_Part]) -> list[str]:
    """What to say of a place of a base whose orientation is not there."""
    sources = [[p for p in parts if p.group not in _BARE and _source(p.group) == k] for k in range(len(SOURCES))]
    places = next(filter(None, (_whole(each, PLACES) for each in sources)), None)
    if places is None:
        return []
    groups = ", ".join(sorted({part.group for part in places}))
    wanted = "w, x, y, z or roll, pitch, yaw, in the same frame"
    return [f"{groups}: x, y and z, but no orientation beside them, so no pose of a base: log one as well ({wanted})"]


def _numbers(groups: Mapping[str, Sequence[Column]], part: _Part) -> Array:
    """(T,)."""
    group = groups[part.group]
    return np.hstack([c.values if c.values.ndim > 1 else c.values[:, None] for c in group])[:, part.at]


def _whole_pose(parts: Sequence[_Part]) -> tuple[list[_Part], list[_Part]] | None:
    """Position, and quaternion or angles, if these parts are a whole pose."""
    places = _whole(parts, PLACES)
    turn = _whole(parts, tuple(f"q{c}" for c in QUATERNION)) or _whole(parts, ANGLES)
    return (places, turn) if places and turn else None


def _whole(parts: Sequence[_Part], wanted: Sequence[str]) -> list[_Part] | None:
    """One part for each component; None where one is missing or there twice."""
    found = [[p for p in parts if p.component == component] for component in wanted]
    return [p for (p,) in found] if all(len(each) == 1 for each in found) else None


def _source(name: str) -> int:
    """How good the source of a group is, by its name: 0 the best, the last for none."""
    found = [k for k, group in enumerate(SOURCES) if group & set(words(name))]
    # An odometry's pose of the base drifts, whatever else its name says.
    return max(found) if len(SOURCES) - 1 in found else min(found, default=len(SOURCES))


def _may_be(name: str) -> bool:
    return name in _BARE or (_source(name) < len(SOURCES) and not OTHERS & set(words(name)))


def _parts(name: str, group: Sequence[Column]) -> list[_Part]:
    """The numbers of a group as parts of a pose; none where one of them is no part."""
    plain, count = set(words(name)), sum(column.width for column in group)
    ends = [(column.parts.bare or [""])[-1] for column in group] if all(c.width == 1 for c in group) else ["0"] * count
    numbered = all(end.isdigit() for end in ends)
    if numbered and count == 3:
        ends = list(ANGLES if plain & EULER else PLACES)
    elif numbered and count == 4:
        ends = [f"q{c}" for c in order(group)]
    elif numbered and count == len(group) == 7:  # a mapping cannot take a list in pieces
        ends = [*PLACES, *(f"q{c}" for c in QUATERNION)]
    if set(ends) == set(QUATERNION):  # no place has a w
        ends = [f"q{end}" for end in ends]
    elif plain & EULER and len(ends) == 3:
        ends = [next((angle for angle in ANGLES if angle[0] == end), end) for end in ends]
    ends = [_COMPONENTS.get(end, end) for end in ends]
    return [_Part(name, i, end) for i, end in enumerate(ends)] if _BARE.issuperset(ends) else []


def order(group: Sequence[Column]) -> str:
    """Whether the real part of four numbers stands first or last: a robot mostly stands upright, wherever it heads. Where
    both would have it so, as with (0, 0, 0, 1), it heads ahead rather than back: the real part is the larger.
    """
    values = np.hstack([c.values if c.values.ndim > 1 else c.values[:, None] for c in group])
    first, second, third, last = np.nanmedian(values**2, axis=0)
    # By half of the angle that it leans by.
    upright = [
        name for name, sine in (("wxyz", second + third), ("xyzw", first + second)) if sine < np.sin(_LEANS / 2) ** 2
    ]
    return upright[0] if len(upright) == 1 else "wxyz" if first >= last else "xyzw"


def _base_channel(
    groups: Mapping[str, Sequence[Column]], parts: Sequence[_Part], labels: tuple[str, ...]
) -> _BaseChannel:
    """The channel of these parts: single columns in the order of `labels`, or one list-valued column with labels."""
    group = groups[parts[0].group]
    if all(column.width == 1 for column in group):
        columns = tuple(groups[part.group][part.at] for part in parts)
    else:
        columns, bare = tuple(group), {part.at: label for part, label in zip(parts, labels, strict=True)}
        labels = tuple(bare[i] for i in range(len(bare)))
    return _BaseChannel(columns, labels, *_unit(columns, set(labels)))


def _unit(columns: Sequence[Column], labels: set[str]) -> tuple[str, bool]:
    """The unit of these columns, and whether the log says it."""
    if labels == set(QUATERNION):
        return "", True
    said = columns[0].declared or columns[0].parts.tail
    si = "m" if labels == set(PLACES) else "rad"
    if said and to_si(said)[0] == si:
        return said, True
    largest = max(column.largest for column in columns)
    if si == "m":
        return ("mm" if largest > _ROOM else "m"), False
    return ("deg" if hardly_radians(largest) else "rad"), False
