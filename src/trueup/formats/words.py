# SPDX-License-Identifier: Apache-2.0
"""What the name of a column says: its role, whether it is a command, its unit, its joint."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from trueup.units import canonical

_KINDS = {
    "position": "position positions pos q qpos angle angles theta ang jointangle jointpos jp jpos",
    "velocity": "velocity velocities vel vels speed speeds qd dq qdot qvel omega jointvel jv jvel dot",
    "acceleration": "acceleration accelerations acc accel qdd ddq qddot qacc ddot",
    "torque": "torque torques tau taus effort efforts moment trq tq torq qfrc jt jtau jtrq",
    "current": "current currents cur curr amps amperage iq",
    "load": "load loads",
    "voltage": "voltage voltages volt volts",
    "temperature": "temperature temperatures temp temps",
}
_COMMAND = (
    "command commands commanded cmd cmds goal goals target targets tgt desired des setpoint setpoints sp control "
    "controls ctrl action actions act ref reference references requested request req demand u throttle steering"
)
_ITSELF = {"throttle", "steering"}  # words that are a command and its name at once
_SENT = {"sent", "written", "applied"}
_MEASURED = (
    "measured meas msr msd actual present feedback fb observation observed obs state states read sensor sensed data "
    "motor motors joint joints field"
)
_PLAINLY_MEASURED = frozenset(["measured", "meas", "msr", "msd", "actual", "present", "feedback"])
"""Words that mean a position where nothing says of what."""
_RATES = ("dot", "ddot")
"""Words that make a rate of change of what stands before them: q_dot, theta_ddot."""
_NEUTRAL = "controller controllers trajectory"
_TIME = (
    "time timestamp timestamps t stamp stamps times clock elapsed ts sec secs seconds millis micros datetime msec usec "
    "nsec nanosec timestep date received zeit tiempo tempo"
)
_NOT_TIME = "index frame episode step steps count counter id seq"
_NOT_JOINT = (
    "tcp ee pose imu mode status enable enabled flag index frame episode id seq count counter error err errors done "
    "success force wrench quat orientation gain kp kd ki vicon mocap gps odom cov covariance"
)
_AXES = "x y z w roll pitch yaw qx qy qz qw rx ry rz"


@dataclass(frozen=True)
class Vocabulary:
    """The words looked for, each set ready for look-up."""

    kinds: dict[str, str]
    commands: frozenset[str]
    measured: frozenset[str]
    neutral: frozenset[str]
    """Words that say nothing about the role and are no part of a joint's name."""
    time: frozenset[str]
    not_time: frozenset[str]
    not_joint: frozenset[str]
    axes: frozenset[str]


VOCABULARY = Vocabulary(
    kinds={word: kind for kind, words in _KINDS.items() for word in words.split()},
    commands=frozenset(_COMMAND.split()),
    measured=frozenset(_MEASURED.split()),
    neutral=frozenset(_NEUTRAL.split()),
    time=frozenset(_TIME.split()),
    not_time=frozenset(_NOT_TIME.split()),
    not_joint=frozenset(_NOT_JOINT.split()),
    axes=frozenset(_AXES.split()),
)

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_ACT = re.compile(r"(?<![A-Za-z])[Aa][Cc][Tt](?![A-Za-z])|(?<![A-Za-z])[Aa]ct(?=[A-Z])")
_BRACKETED_UNIT = re.compile(r"[\[(]\s*([^\])]*?)\s*[\])]\s*$")
_UNIT_SUFFIXES = {
    "position": {"rad": "rad", "deg": "deg", "degrees": "deg", "rev": "rev", "mrad": "mrad", "m": "m", "mm": "mm"},
    "velocity": {
        "rads": "rad/s", "radps": "rad/s", "rad/s": "rad/s", "degs": "deg/s", "degps": "deg/s", "deg/s": "deg/s",
        "rpm": "rpm", "mps": "m/s", "m/s": "m/s", "dps": "deg/s",
    },
    "torque": {"nm": "N m", "mnm": "mN m"},
    "current": {"a": "A", "ma": "mA"},
    "voltage": {"v": "V", "mv": "mV"},
    "temperature": {"c": "degC", "degc": "degC", "k": "K"},
}  # fmt: skip


@dataclass(frozen=True)
class Meaning:
    """What a column's name says."""

    kind: str
    """position, velocity, ...; '' if no word tells."""
    command: bool
    sent: bool
    measured: bool
    unit: str
    label: str
    """What is left of the name without the words for role and unit."""
    joint: bool
    """False where a word says that this is no joint's signal (a pose, a mode, a counter)."""


def with_actual(names: Sequence[str]) -> dict[str, str]:
    """Each name as it is to be read: "act" is "actual", and no action, beside names with a plain word for a command."""
    plain = [words(name) for name in names]
    if not any((VOCABULARY.commands - {"act"}) & set(each) for each in plain):
        return {name: name for name in names}
    return {name: _ACT.sub("actual", name) for name in names}


def words(name: str) -> list[str]:
    """The words and numbers of a name, in lower case: "jointPos_1" -> joint, pos, 1."""
    return [match[0].lower() for match in _WORD.finditer(name)]


def meaning(name: str) -> Meaning:
    """What the name of a column says about it."""
    bare, unit = _without_unit(name)
    spans = [(match[0].lower(), match.start(), match.end()) for match in _WORD.finditer(bare)]
    plain = [word for word, _, _ in spans]
    kinds = [_kind(word) for word in plain]
    commands = [_is_command(i, plain) for i in range(len(plain))]
    kind = next((k for k in kinds if k), "")
    kind = {"dot": "velocity", "ddot": "acceleration"}.get(next((w for w in plain if w in _RATES), ""), kind)
    told = any(commands) or bool(_PLAINLY_MEASURED & set(plain))
    suffix, where = ("", range(0)) if unit else _unit_suffix(bare, kind)
    if not kind and (told or not (VOCABULARY.axes | {"heading"}) & set(plain[:1])):
        kind, suffix, where = _kind_by_unit(bare, unit, suffix, where, told=told)
    if not kind and told and not any(commands):
        kind = "position"
    keep = [
        kept and start not in where
        for kept, (_, start, _) in zip(_kept_words(spans, kinds, commands), spans, strict=True)
    ]
    joint = not any(word in VOCABULARY.not_joint for word in plain)
    return Meaning(
        kind=kind,
        command=any(commands),
        sent=any(word in _SENT for word in plain),
        measured=any(word in VOCABULARY.measured for word in plain),
        unit=unit or suffix,
        label=_cut_out(bare, spans, keep),
        joint=joint,
    )


def joint_labels(names: Sequence[str]) -> tuple[str, ...]:
    """Labels for columns: what distinguishes their names, "joint_3" where that is a number; unique."""
    labels = [label_of(meaning(name).label) for name in names]
    return tuple(labels) if len(set(labels)) == len(labels) else tuple(names)


def label_of(rest: str) -> str:
    """A label from what is left of a column's name: a bare number or nothing becomes "joint_n"."""
    if not rest:
        return "joint_1"
    return f"joint_{rest}" if rest.isdigit() else rest


def is_time(name: str) -> bool:
    """Whether a name sounds like a clock."""
    plain = words(name)
    return any(word in VOCABULARY.time for word in plain) and not any(word in VOCABULARY.not_time for word in plain)


def _kind(word: str) -> str:
    """The kind of signal a word names; "qdes" and "cmdpos" are taken apart."""
    if word in VOCABULARY.kinds:
        return VOCABULARY.kinds[word]
    for i in range(1, len(word)):
        for kind, other in ((word[:i], word[i:]), (word[i:], word[:i])):
            if kind in VOCABULARY.kinds and len(other) > 2 and other in VOCABULARY.commands:
                return VOCABULARY.kinds[kind]
    return ""


def _is_command(i: int, plain: Sequence[str]) -> bool:
    word = plain[i]
    if word in VOCABULARY.commands:
        return True
    if word == "d":  # q_d, tau_J_d: desired
        return any(previous in ("q", "dq", "tau", "ddq") for previous in plain[:i])
    return word not in VOCABULARY.kinds and bool(_kind(word))


def _without_unit(name: str) -> tuple[str, str]:
    match = _BRACKETED_UNIT.search(name)
    unit = canonical(match[1]) if match and match[1] else None
    if match is None or not unit or unit == match[1] == "":
        return name, ""
    return name[: match.start()].rstrip(" _"), unit


def _unit_suffix(bare: str, kind: str) -> tuple[str, range]:
    """A unit that fits the kind at the end of the name (or before its index), and where it stands."""
    known = _UNIT_SUFFIXES.get(kind, {})
    pieces = [(match[0].lower(), match.start(), match.end()) for match in re.finditer(r"[^_\s.\-]+", bare)]
    if len(pieces) > 1 and pieces[-1][0].isdigit():
        pieces = pieces[:-1]
    for count in (2, 1):
        tail = pieces[-count:]
        unit = known.get("/".join(piece for piece, _, _ in tail))
        if unit and len(pieces) > count:
            return unit, range(tail[0][1], tail[-1][2])
    return "", range(0)


def _kind_by_unit(bare: str, unit: str, suffix: str, where: range, *, told: bool) -> tuple[str, str, range]:
    """The kind that a unit speaks of where no word does: "goal_elbow_deg", "tool (N m)"; with the unit's suffix.

    Single letters say so only where the name is `told` to be a command or a measurement.
    """
    for kind, known in _UNIT_SUFFIXES.items():
        if unit and unit in known.values():
            return (kind, suffix, where) if told or len(unit) > 1 else ("", suffix, where)
        found, there = _unit_suffix(bare, kind) if not unit else ("", range(0))
        if found and (told or len(there) > 1):
            return kind, found, there
    return "", suffix, where


def _kept_words(spans: Sequence[tuple[str, int, int]], kinds: Sequence[str], commands: Sequence[bool]) -> list[bool]:
    """Which words belong to the joint's name."""
    franka = [word == "j" and i > 0 and spans[i - 1][0] == "tau" for i, (word, _, _) in enumerate(spans)]  # tau_J
    special = [
        (bool(kinds[i]) or commands[i] or franka[i] or word in _SENT) and word not in _ITSELF
        for i, (word, _, _) in enumerate(spans)
    ]
    keep = [not is_special for is_special in special]
    dropped = VOCABULARY.measured | VOCABULARY.neutral
    named = [i for i, kept in enumerate(keep) if kept and spans[i][0] not in dropped]
    # "joint" and "motor" are part of a name such as FL_hip_joint or Joint_1, "actual" in actual_q_0 is not.
    for i, (word, _, _) in enumerate(spans):
        if word in dropped:
            topic = i + 1 < len(spans) and spans[i + 1][0] in ("state", "states")
            part = word in ("joint", "joints", "motor", "motors") and bool(named) and not topic
            keep[i] = keep[i] and part
    return keep


def _cut_out(bare: str, spans: Sequence[tuple[str, int, int]], keep: Sequence[bool]) -> str:
    """The kept words with what stands between them."""
    pieces: list[str] = []
    for i, (_, start, end) in enumerate(spans):
        if keep[i]:
            joined = bool(pieces) and i > 0 and keep[i - 1]
            between = bare[spans[i - 1][2] : start] if joined else ("_" if pieces else "")
            pieces.append(between + bare[start:end])
    return "".join(pieces)
