# SPDX-License-Identifier: Apache-2.0
"""What columns say of one another: sensors beside joints, columns named as their commands, labels that mean the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.formats.rules import joints
from trueup.formats.rules.bases import SOURCES, of_place, quaternions
from trueup.formats.rules.families import Named
from trueup.formats.rules.inertial import INERTIAL, sensor_labels
from trueup.formats.rules.names import AXES, TOOLS, taken_apart, words
from trueup.formats.rules.proposal import Proposal, threes, unchanged
from trueup.formats.rules.rule import Column, Example
from trueup.formats.table import listing

OF_ANY_DRIVE = frozenset(
    ["joint", "joints", "axis", "motor", "dof", "actuator", "servo", "drive", "robot", "arm", "a", "j"]
)


EXAMPLES = (
    Example("t,q_hip,q_cmd_hip,acc_x_m/s2,acc_y_m/s2,acc_z_m/s2,gyro_x_rad/s,gyro_y_rad/s,gyro_z_rad/s",
            "0 .1 .2 0 0 9 1 2 3|.01 .2 .3 0 0 9 1 2 2|.02 .3 .4 0 1 9 2 2 3",
            "command[rad] hip; position[rad] hip; acc[m/s^2] x y z; gyro[rad/s] x y z"),
    Example("t,q_hip,q_cmd_hip,accel_x_g,accel_y_g,accel_z_g,GyrX,GyrY,GyrZ",
            "0 .1 .2 0 0 9 1 2 3|.01 .2 .3 0 0 9 1 2 2|.02 .3 .4 0 1 9 2 2 3",
            "position[rad] hip; accel_g[] x y z; gyr[] x y z"),
    Example("t,q_hip,q_cmd_hip,ax,ay,az,gx_dps,gy_dps,gz_dps",
            "0 .1 .2 0 0 9 1 2 3|.01 .2 .3 0 0 9 1 2 2|.02 .3 .4 0 1 9 2 2 3",
            "position[rad] hip; acc[] x y z; gyro[deg/s] x y z"),
    Example("t,q_hip,q_cmd_hip,wx,wy,wz", "0 .1 .2 1 2 3|.01 .2 .3 1 2 2|.02 .3 .4 2 2 3", "position[rad] hip; gyro[] x y z"),
    # What a robot's controller says of itself has no word for its kind, and nobody commands it.
    Example("t,actual_q_0,actual_q_1,target_q_0,target_q_1,actual_digital_input_bits,actual_momentum",
            "0 .1 .2 .1 .2 0 1|.1 .2 .3 .2 .3 1 2|.2 .3 .4 .3 .4 0 1",
            "position[rad] joint_0 joint_1; command[rad] joint_0 joint_1"),
    # Gravity alone, as some log it, is no gyro.
    Example("t,q_hip,q_cmd_hip,gx,gy,gz", "0 .1 .2 0 0 9|.01 .2 .3 0 0 9|.02 .3 .4 0 1 9", "position[rad] hip; gx[] gx"),
    # A joint that is called a motor, beside the one that it moves; elsewhere motors have angles of their own.
    Example("t,cmd_knee,cmd_ankle_motor,pos_knee,pos_ankle,pos_ankle_motor", "0 1 2 1 3 2|.1 2 3 2 4 3|.2 1 2 1 3 2",
            "command[rad] knee ankle_motor; position[rad] knee ankle; position_motor[] ankle_motor"),
    Example("t,cmd_knee,cmd_ankle_motor,pos_knee,pos_ankle_motor", "0 1 2 1 2|.1 2 3 2 3|.2 1 2 1 2",
            "command[rad] knee ankle_motor; position[rad] knee ankle_motor"),
    Example("t,lift_cmd_m,wrist_cmd_rad,lift_m,wrist_rad", "0 .1 .2 .1 .2|.1 .2 .3 .2 .3|.2 .1 .2 .1 .2",
            "command[m,rad] lift wrist; position[m,rad] lift wrist"),
    # What Franka's interface calls its motors' angles, before their springs.
    Example("t,q[0],q[1],q_d[0],q_d[1],theta[0],theta[1]", "0 .1 .2 .1 .2 .1 .1|.1 .2 .3 .2 .3 .2 .3|.2 .1 .2 .1 .2 .2 .2",
            "command[rad] joint_0 joint_1; position[rad] joint_0 joint_1; theta[] 0 1"),
    # Of four joints or more three numbers of an inertial unit are its axes; of three joints they are theirs.
    Example("t,q[0],q[1],q[2],q[3],q_d[0],q_d[1],q_d[2],q_d[3],omega[0],omega[1],omega[2],quat[0],quat[1],quat[2],quat[3]",
            "0 1 2 0 0 1 2 0 0 1 2 3 1 0 0 0|.01 2 3 0 1 2 3 0 1 1 2 2 .8 .6 0 0|.02 3 4 1 0 3 4 1 0 2 2 3 1 0 0 0",
            "position[rad] joint_0 joint_1 joint_2 joint_3; omega[] x y z; quat[] w x y z"),
    Example("t,q[0],q[1],q[2],q_d[0],q_d[1],q_d[2],omega[0],omega[1],omega[2]",
            "0 .1 .2 0 .1 .2 0 1 2 3|.01 .2 .3 0 .2 .3 0 1 2 2|.02 .3 .4 1 .3 .4 1 2 2 3",
            "position[rad] joint_0 joint_1 joint_2; velocity[rad/s] joint_0 joint_1 joint_2"),
    # Of a state estimator three numbers are the base's, as a Mini Cheetah logs them (p beside kp, kd and v is a position).
    Example("t,data.q[0],data.q[1],command.q_des[0],command.q_des[1],command.kp[0],command.kd[0],state_estimator.p[0],"
            "state_estimator.p[1],state_estimator.p[2],state_estimator.vWorld[0],state_estimator.vWorld[1],"
            "state_estimator.vWorld[2],state_estimator.rpy[0],state_estimator.rpy[1],state_estimator.rpy[2]",
            "0 1 1 1 1 9 1 0 0 .3 0 0 0 0 0 .1|.1 2 1 1 1 9 1 .1 0 .3 0 1 0 0 .1 .1|.2 1 2 1 1 9 1 0 0 .3 0 0 0 .1 0 .1",
            "position[rad] joint_0 joint_1; base_position[m] x y z; base_orientation[rad] roll pitch yaw"),
    # Slides along x, y and z are joints.
    Example("t,pos_x,pos_y,pos_z,cmd_x,cmd_y,cmd_z,vel_x,vel_y,vel_z",
            "0 .1 .2 .1 .1 .2 .1 1 1 1|.01 .2 .3 .2 .2 .3 .2 1 1 2|.02 .3 .4 .3 .4 .4 .3 2 1 1",
            "command[rad] x y z; position[rad] x y z; velocity[rad/s] x y z"),
)  # fmt: skip
_MOTOR = "motor"
FAMILIES = (_MOTOR, *joints.VARIANTS)
"""Signals of motors are kept apart from those of joints, and others that are no plain ones, where a file has both."""
_POSITIONS = ("position", "command", "command_sent")
_OF_SENSORS = ("velocity", "acceleration", "torque")
_MEASURED_OF_JOINTS = ("position", "velocity")
_PLACES = frozenset("xyz")


def family_of(proposal: Proposal, proposals: Sequence[Proposal], named: Mapping[Column, Named]) -> str:
    """Whose signals these are apart from those of joints; '' for a joint that is itself called a motor ("ankle_motor").

    That is one of the model's, or one whose name without the word is no other column's of the role.
    """
    column = proposal.column
    family = next((word for word in FAMILIES if word in column.parts.words), "")
    if family != _MOTOR or not proposal.role:
        return family
    if column in named:
        return "" if _MOTOR in words(named[column].joint) else family
    of = [word for word in words(proposal.label) if word not in joints.PARTS]
    others = (p.label for p in proposals if p.role == proposal.role and _MOTOR not in p.column.parts.words)
    counted = not of or all(word.isdigit() for word in of)
    twin = any([word for word in words(label) if word not in joints.PARTS] == of for label in others)
    return family if counted or twin else ""


def distinct(members: Sequence[Proposal]) -> list[Proposal]:
    """Members with distinct labels; where two would have the same, the columns' names are the labels."""
    first = {member.label: member.column.values for member in reversed(members)}
    members = [m for m in members if m.column.values is (one := first[m.label]) or not _same(m.column.values, one)]
    if len(first) == len(members):
        return list(members)
    return [replace(member, label=member.column.name) for member in members]


def _same(values: Array, others: Array) -> bool:
    """Whether two columns say the same, as "desired" and "reference" of a controller do."""
    return values.shape == others.shape and np.array_equal(values, others, equal_nan=True)


def without_other_signals(proposals: Sequence[Proposal], named: Mapping[Column, Named]) -> list[Proposal]:
    """Columns without a word for their kind that are named as a joint with a position is, and more, are another signal of it.

    "m1_pos_fb" beside "m1_xyz_fb": whatever xyz is, it is no joint called m1_xyz. Nor is "u_1" what "theta_ref_1" is. But
    "cmd_ankle_motor" is one beside "pos_ankle" where there is "pos_ankle_motor", or the model has it.
    """
    implied = [p.role in _POSITIONS and joints.read(p.column.parts).implied for p in proposals]
    told = {(p.role, p.label) for p, only in zip(proposals, implied, strict=True) if p.role in _POSITIONS and not only}

    commanded = {p.label for p in proposals if p.role in _POSITIONS[1:]}
    measured = any(role == "position" for role, _ in told)

    def is_other(p: Proposal) -> bool:
        if (p.role, p.label) in told:
            return True
        if measured and commanded and p.role == "position" and p.label not in commanded and p.column not in named:
            return True  # actual_digital_input_bits
        joint = p.column in named or any(x == p.label for _, x in told)
        return not joint and any(x in p.label and {*words(x)} < {*words(p.label)} for _, x in told)

    return [unchanged(p.column) if only and is_other(p) else p for p, only in zip(proposals, implied, strict=True)]


def without_doubles(proposals: Sequence[Proposal]) -> list[Proposal]:
    """Columns that tell a signal of the same joints by another word are put aside: motors' theta[0] beside q[0], where there
    is q_d[0]. Kept are those called as what is commanded; else the most, else the first.
    """
    told = {word for p in proposals if p.role.startswith("command") for word in p.column.parts.words}
    rows: dict[tuple[str, str, str], dict[tuple[str, ...], list[Proposal]]] = {}
    for p in proposals:
        key = (p.role, p.column.table.name, next((word for word in FAMILIES if word in p.column.parts.words), ""))
        if p.role in _MEASURED_OF_JOINTS and p.column.width == 1:
            said = tuple(word for word in p.column.parts.words if word in joints.KINDS)
            rows.setdefault(key, {}).setdefault(said, []).append(p)
    aside: set[Column] = set()
    for by_word in rows.values():
        first = max(by_word, key=lambda said: (bool(told & set(said)), len(by_word[said])))
        labels = {p.label for p in by_word[first]}
        doubles = (each for said, each in by_word.items() if said != first and labels >= {p.label for p in each})
        aside |= {p.column for each in doubles for p in each}
    return [unchanged(p.column) if p.column in aside else p for p in proposals]


def without_sensors(proposals: Sequence[Proposal]) -> list[Proposal]:
    """Speeds, accelerations and torques along axes of which no position or command speaks are those of a sensor or tool, also
    those along x, y and z of one thing (gyro_x_rad/s, gyro_y_rad/s, gyro_z_rad/s), and three numbers of what an inertial
    unit measures, where there are more joints (omega[0], omega[1], omega[2]).

    Likewise an angle without a name beside a place x, y is where a vehicle heads, and no joint's.
    """
    labels = {p.label for p in proposals if p.role in _POSITIONS}
    along: dict[tuple[str, ...], set[str]] = {}
    for p in proposals:
        if p.role in _OF_SENSORS and p.label not in labels:
            thing, axis = _along(p.label)
            along.setdefault(thing, set()).update(axis)
    inertial = [
        row for row in threes(proposals, _OF_SENSORS) if INERTIAL & set(row[0].parts.words) and sensor_labels(row)
    ]
    more = any(sum(p.column.width for p in proposals if p.role == role) > len(_PLACES) for role in _POSITIONS)
    counted = {column for row in inertial if more for column in row}
    wholes = {thing for thing, axis in along.items() if axis == _PLACES}
    names = {p.column.name.lower() for p in proposals}
    found = []
    for p in proposals:
        pushes = p.role == "command_torque" and p.unit == "N"
        whole = p.label not in labels and _along(p.label)[0] in wholes
        sensor = (pushes or p.role in _OF_SENSORS) and (p.label in AXES - labels or whole)
        heads = p.role == "position" and p.column.name.lower() == "theta" and {"x", "y"} <= names
        found.append(unchanged(p.column) if sensor or heads or p.column in counted else p)
    return found


def _along(label: str) -> tuple[tuple[str, ...], frozenset[str]]:
    """The words of a label without x, y and z, and which of these it has."""
    plain = words(label)
    return tuple(word for word in plain if word not in _PLACES), _PLACES & frozenset(plain)


def without_places(proposals: Sequence[Proposal]) -> list[Proposal]:
    """Positions along x, y and z of one base, trunk or tracked body, or of whatever has a quaternion beside them, are a
    place, where nothing drives them as joints; three numbers, in a list or numbered, are one, or the base's speeds, where
    others are of joints.
    """
    driven = {p.label for p in proposals if p.role.startswith("command") or p.role in ("torque", "current")}
    lists = [row for row in threes(proposals, _MEASURED_OF_JOINTS) if _of_a_base(row[0])]
    based = {column for row in lists for column in row}
    based -= {p.column for p in proposals if p.column.width == 1 and p.label in driven}
    joined = {p.role for p in proposals if p.column not in based}
    proposals = [unchanged(p.column) if p.column in based and p.role in joined else p for p in proposals]
    found: dict[str, set[str]] = {}
    for p in proposals:
        plain = words(p.label)
        if p.role == "position" and p.label not in driven and plain and plain[-1] in _PLACES:
            found.setdefault(" ".join(plain[:-1]), set()).add(plain[-1])
    turned = quaternions([p.column for p in proposals])
    places = {name for name, along in found.items() if len(along) == 3 and (name in turned or of_place([name]))}

    def placed(p: Proposal) -> bool:
        return p.role == "position" and " ".join(words(p.label)[:-1]) in places and p.label not in driven

    return [unchanged(p.column) if placed(p) else p for p in proposals]


def _of_a_base(column: Column) -> bool:
    plain = set(column.parts.words)
    return any(source & plain - OF_ANY_DRIVE for source in SOURCES) and not plain & (TOOLS | OF_ANY_DRIVE - {"robot"})


def with_twins(proposals: Sequence[Proposal], known: Sequence[str] = ()) -> list[Proposal]:
    """Where no word tells a commanded joint's position, a column named as its command, but for the word that commands and a
    unit, is that; where positions are called otherwise than commands (hip_cmd beside q1), nothing is.

    "joint1" beside "joint1_cmd", where it does not move against it. Where one of them goes along with its command, the names
    mean what was measured, and one that moves against it was logged with the other sign. Where names by themselves mean that,
    so does that of a joint of the model (`known`) that nothing commands; how such a joint's position is called says nothing
    of how those of commanded joints are.
    """
    measured = {p.label for p in proposals if p.role == "position"}
    commands = {p.label: p.column for p in proposals if p.role == "command"}
    told = measured - ({*known} - commands.keys())
    if told and not told & commands.keys():
        return list(proposals)
    twins: dict[int, tuple[str, float]] = {}
    for k, p in enumerate(proposals):
        label = _label_without_unit(p.column)
        if not p.role and label in commands.keys() - measured and p.column.width == commands[label].width:
            twins[k] = label, _together(p.column, commands[label])
    surely = bool(told) or any(together > 0.0 for _, together in twins.values())
    if twins and surely:
        passive = {*known} - measured - commands.keys()
        bare = {k: _label_without_unit(p.column) for k, p in enumerate(proposals) if not p.role and p.column.width == 1}
        twins |= {k: (label, 0.0) for k, label in bare.items() if label in passive}
    return [
        replace(p, role="position", label=twins[k][0], unit=p.unit or p.column.parts.tail)
        if k in twins and (surely or twins[k][1] >= 0.0) else p
        for k, p in enumerate(proposals)
    ]  # fmt: skip


def _label_without_unit(column: Column) -> str:
    """The joint that a name without a word for its kind is of, "lift" for lift_m; '' where it is no joint's."""
    name = column.parts
    reading = joints.read(taken_apart(name.text[: name.spans[name.tail_words.start][1]]) if name.tail_words else name)
    return joints.label_of(reading.label) if reading.joint else ""


def _together(column: Column, command: Column) -> float:
    """The covariance of a column and a command, summed over what they hold; 0 where they are not rows of one table."""
    if column.table is not command.table or column.values.ndim > 1 or command.values.ndim > 1:
        return 0.0
    good = np.isfinite(column.values) & np.isfinite(command.values)
    return float(np.cov(column.values[good], command.values[good])[0, 1]) if np.count_nonzero(good) > 1 else 0.0


def with_common_labels(groups: dict[str, list[Proposal]]) -> tuple[dict[str, list[Proposal]], list[str]]:
    """Channels whose labels differ from the positions' only by words for any drive get the positions' labels.

    Torque_A1, Torque_A2 beside AxisPos_A1, AxisPos_A2; the other words must tell them apart.
    """
    positions = _told_apart([p.label for p in groups.get("position", ())])
    result, taken = dict(groups), dict[str, list[str]]()
    for name, group in groups.items():
        labels = _told_apart([p.label for p in group])
        role = name.removeprefix("command_sent").removeprefix("command").removeprefix("_") or "position"
        different = {p.label for p in group} - set(positions.values())
        if role in joints.BY_KIND and labels and different and set(labels) == set(positions):
            by_label = {label: positions[rest] for rest, label in labels.items()}
            result[name] = [replace(p, label=by_label[p.label]) for p in group]
            said = f"{listing(by_label, 6)} taken as {listing(by_label.values(), 6)}, by what tells them apart"
            taken.setdefault(said, []).append(name)
    return result, [f"{', '.join(names)}: {said}" for said, names in taken.items()]


def _told_apart(labels: Sequence[str]) -> dict[str, str]:
    """What tells labels apart, first and last words left out that all share -> label; {} where there is one label.

    Only words that any drive may have are left out: what is left of left_hip must not be taken for that of right_hip.
    """
    plain = [words(label) for label in labels]
    for end in (0, -1):
        while len(plain) > 1 and min(map(len, plain)) > 1 and len({each[end] for each in plain}) == 1:
            word = plain[0][end]
            if word not in OF_ANY_DRIVE and not (word.isdigit() and plain[0][end + 1] in OF_ANY_DRIVE):
                break
            plain = [each[1:] if end == 0 else each[:-1] for each in plain]
    rest = {"_".join(each): label for each, label in zip(plain, labels, strict=True)}
    return rest if len(rest) == len(labels) > 1 else {}
