# SPDX-License-Identifier: Apache-2.0
"""Joints whose names hold words that mean something else elsewhere: a base that yaws, a gripper called by its speed.

A word alone cannot tell whether `q_base_yaw` is the heading of a trunk or an arm's first joint. The model can, where one is
given: a joint's exact name wins. Else the other columns tell: what stands in every family of columns (q_*, qd_*, tau_*) in
which the joints stand that nobody doubts is a joint like them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.formats.rules import joints
from trueup.formats.rules.names import AXES, COMMANDED, MEASURED, SENT, Name, stem, taken_apart, words
from trueup.formats.rules.rule import Column, Example

EXAMPLES = (
    Example("t,q_base_yaw,q_elbow,qd_base_yaw,qd_elbow,tau_base_yaw,tau_elbow",
            "0 .1 .1 1 1 2 2|.1 .2 .1 1 1 3 2|.2 .3 .2 1 1 2 3",
            "position[rad] base_yaw elbow; velocity[rad/s] base_yaw elbow; torque[N m] base_yaw elbow"),
    Example("t,base_x_pos,elbow_pos,base_x_cmd,elbow_cmd", "0 .1 .1 1 1|.1 .2 .1 1 1|.2 .3 .2 1 1",
            "command[rad] base_x elbow; position[rad] base_x elbow"),
    Example("t,grip_speed_pos,elbow_pos,grip_speed_torque,elbow_torque", "0 .1 .1 1 1|.1 .2 .1 1 1|.2 .3 .2 1 1",
            "position[rad] grip_speed elbow; torque[N m] grip_speed elbow"),
    Example("t,base_yaw.pos_ticks,elbow.pos_ticks,base_yaw.load,elbow.load", "0 9 1 1 1|.1 7 2 1 1|.2 8 3 1 1",
            "load[] base_yaw elbow; position[] base_yaw elbow"),
    # A trunk has a pose of several numbers, and no motor.
    Example("t,q_base_x,q_base_y,q_base_yaw,q_elbow,tau_elbow", "0 1 1 .1 .1 1|.1 2 1 .1 .2 1|.2 3 2 .1 .3 2",
            "position[rad] elbow; q_base[] x y yaw; torque[N m] elbow"),
    # The heading of a trunk stands in fewer families than a joint.
    Example("t,q_base_yaw,q_elbow,tau_elbow", "0 .1 .1 1|.1 .1 .2 1|.2 .1 .3 2",
            "position[rad] elbow; q_base[] yaw; torque[N m] elbow"),
)  # fmt: skip

_STAND_IN = "elbow"
"""A joint's name of which no rule takes a word for anything else."""
_RATES = frozenset(["dot", "ddot"])
_ROLES = frozenset(joints.KINDS) | joints.ENCODERS | COMMANDED | SENT | MEASURED | {"d"}
"""Words that may stand before or behind a joint's name and say what of it was logged."""
_CONTROLLERS = frozenset(["controller", "controllers"])
"""Words behind the name of what tells drives, and before that of a drive."""
_PLACES, _TURNS = frozenset("xyz"), frozenset(["roll", "pitch", "yaw"])
_QUATERNION = frozenset(["qw", "qx", "qy", "qz"])

_Core = tuple[str, ...]
_Frame = tuple[str, _Core, _Core]
"""Table, words before a joint's name, words behind it."""


@dataclass(frozen=True)
class Named:
    """A column that is a joint's."""

    joint: str
    """As the model has it, else as the column's name does, with "motor" or "joint" where it says so."""
    read_as: Name
    """The column's name with a plain one in the joint's place."""


@dataclass(frozen=True)
class _Split:
    """A column's name as the words of a joint, and what stands around them."""

    frame: _Frame
    core: _Core
    at: range
    """Which words of the name the joint's are."""


def of_base(column: Column) -> bool:
    """Whether "base" may mean a trunk with a pose of several numbers, and not an arm's first joint."""
    plain = column.parts.words
    return "base" in plain and (column.values.ndim > 1 or any(word in AXES or word.isdigit() for word in plain))


def joints_in(columns: Sequence[Column], known: Sequence[str] = (), *, several: bool) -> dict[Column, Named]:
    """The columns whose words mean something else elsewhere and that are a joint's: one of `known`, the joints of a model,
    or one that stands where the others do. `several`: files whose own names say what they hold.
    """
    splits = {c: list(_splits(c, several)) for c in columns if c.values.ndim == 1}
    exact = {_core(joint): joint for joint in known if _telling(_core(joint))}
    found = {c: _named(c, s.at, exact[s.core]) for c, each in splits.items() for s in each if s.core in exact}
    left = {c: each for c, each in splits.items() if c not in found}
    plain = {
        c: min(each, key=lambda s: len(s.core)) for c, each in splits.items()
        if each and (c in found or (not of_base(c) and joints.read(c.parts).joint))
    }  # fmt: skip
    others, frames = _frames(plain.values()), _frames(s for each in left.values() for s in each)
    based = _joints_of_base({c: each for c, each in left.items() if of_base(c)}, others, frames)
    twofold = {core for core in frames if _twofold(core) and len(_shared(core, frames, others)) > 1}
    for column, each in left.items():
        split = next((s for s in each if s.core in (based if of_base(column) else twofold)), None)
        if split is not None:
            found[column] = _named(column, split.at)
    return found


def _core(joint: str) -> _Core:
    return tuple(words(joint))


def _telling(core: _Core) -> bool:
    """Whether a joint's name has a word of its own: "q1" and "joint_1" are words of any log."""
    return any(word not in _ROLES and not word.isdigit() for word in core)


def _frames(splits: Iterable[_Split]) -> dict[_Core, set[_Frame]]:
    """What stands around each joint's name."""
    found: dict[_Core, set[_Frame]] = {}
    for split in splits:
        found.setdefault(split.core, set()).add(split.frame)
    return found


def _shared(core: _Core, frames: Mapping[_Core, set[_Frame]], others: Mapping[_Core, set[_Frame]]) -> set[_Frame]:
    """What stands around a name and around that of another joint too."""
    return frames[core] & set().union(*(theirs for other, theirs in others.items() if other != core))


def _twofold(core: _Core) -> bool:
    """Whether a joint's name would have a word for a kind of signal: gripper_speed; "current" is "present" too."""
    roles = _ROLES & set(core) - {"joint", "motor"}
    return _telling(core) and bool(roles) and roles <= frozenset(joints.KINDS) - _RATES - {"current"}


def _named(column: Column, at: range, joint: str = "") -> Named:
    name = column.parts
    start, end = name.spans[at[0]][1], name.spans[at[-1]][2]
    plain = taken_apart(column.read_as[:start] + _STAND_IN + column.read_as[end:])
    return Named(joint or joints.read(plain).label.replace(_STAND_IN, name.text[start:end]), plain)


def _splits(column: Column, several: bool) -> Iterator[_Split]:
    """Every way to take a name for a joint's between words of a role, of which one tells a kind or a command."""
    plain = [word for i, word in enumerate(column.parts.words) if i not in column.parts.tail_words]
    file = joints.read(taken_apart(stem(column.table.name))) if several else None
    said = file is not None and bool(file.kind or file.command)
    # What stands before that word names the controller, as in hand_controller/commands/thumb.
    named = max((i + 1 for i, word in enumerate(plain[:-1]) if word in _CONTROLLERS), default=0)
    before = next((i for i, word in enumerate(plain) if i >= named and word not in _ROLES), len(plain))
    behind = next((i for i, word in enumerate(plain[::-1]) if word not in _ROLES), len(plain))
    for i in range(before + 1):
        for j in range(len(plain) - behind, len(plain) + 1):
            around = {*plain[:i], *plain[j:]}
            if i < j and (said or around & (frozenset(joints.KINDS) | COMMANDED)):
                frame = (column.table.name, tuple(plain[:i]), tuple(plain[j:]))
                yield _Split(frame, tuple(plain[i:j]), range(i, j))


def _joints_of_base(
    splits: Mapping[Column, Sequence[_Split]], others: Mapping[_Core, set[_Frame]], frames: Mapping[_Core, set[_Frame]]
) -> set[_Core]:
    """Names of joints in columns of a base: what stands wherever its neighbours do, unless it is a pose without motors."""
    motors = [c for c in splits if joints.read(c.parts).kind in ("torque", "current") and bool(np.any(c.known != 0.0))]
    driven = {split.core for column in motors for split in splits[column]}
    cores = {split.core for each in splits.values() for split in each if _telling(split.core)}
    free = cores - driven
    said = {word for core in free for word in core}
    pose = any(len(said & several) > 1 for several in (_PLACES, _TURNS, _QUATERNION))
    if pose or sum(word.isdigit() for word in said) > 2:
        cores = driven
    beside = {core: [theirs for theirs in others.values() if theirs & frames[core]] for core in cores}
    return {
        core for core in cores
        if (set.intersection(*beside[core]) <= frames[core] if beside[core] else core in driven and not others)
    }  # fmt: skip
