# SPDX-License-Identifier: Apache-2.0
"""Signals of joints and drives, in arms, legs and machines: what a column's name says of kind, command, unit and joint."""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

from trueup.formats.rules.names import (
    AXES,
    COMMANDED,
    MEASURED,
    PLAINLY_MEASURED,
    SENT,
    TOOLS,
    Name,
    listed,
    taken_apart,
)
from trueup.formats.rules.signals import BY_KIND, KINDS, RULES, SETTINGS
from trueup.units import to_si


def _words(gain: tuple[frozenset[str], str]) -> int:
    return len(gain[0])


_GAINS = sorted(
    ((frozenset(name.split()), kind) for kind in SETTINGS for name in BY_KIND[kind].names.split(", ")),
    key=_words, reverse=True,
)  # fmt: skip
"""The words of a gain, and its kind, the longest first."""
SHARES = MappingProxyType(
    {**dict.fromkeys(("percent", "pct", "perc"), "%"), "permille": "permille", "promille": "permille"}
)
"""Words of a share of what a drive is rated for, as a unit."""
_RATES = MappingProxyType({"dot": "velocity", "ddot": "acceleration"})
"""Words that make a rate of change of what stands before them: q_dot, theta_ddot."""
ENCODERS = listed("encoder encoders enc counts ticks")
"""Words of a position where no other word tells a kind."""
_AMPERES = frozenset(["i"])
"""Words of a current where a unit says so, or a command or measurement."""
_SPEEDS = frozenset(["v"])
"""Words of a speed where a unit says so: v_cmd_x [mm/s]."""
_SHORT = frozenset(["th"])
"""Words of a position that may also be part of a joint's name: theta, or thigh."""
_OF_A_LOG = frozenset(["sample", "sampling", "frame", "update", "data", "loop", "log"])
"""Whose rate is no speed."""
_CONTROL = listed("control controls ctrl")
"""Words of a command, but for what is said to be measured within a controller."""
_WITHIN = (["data"], ["state"], ["command"], ["cmd"])
"""What follows such a word where it names the controller, and says nothing of its own."""
_ITSELF = frozenset(["throttle", "steering"])  # words that are a command and its name at once
_NEUTRAL = listed(
    "controller controllers trajectory lowstate lowcmd group forward value values device sub list electric"
)
_TOPICS = listed("state states controller controllers trajectory group")
"""What follows a word for any joint where it names a topic: joint_states, joint_group_position_controller."""
_FORCES = listed("force forces")
"""Words of what slides push with, where they are commanded: what was measured is more often a tool's."""
_NOT_PUSHED = listed("grip gripper grasp finger fingers limit limits max min")
"""Whose commanded force is a setting, and drives no joint."""
VARIANTS = ("raw", "unfiltered", "filtered", "filt", "external", "ext", "predicted", "pred", "simulated", "sim", "prev",
            "previous", "computed", "calculated")  # fmt: skip
"""Words of a signal that stands beside a plainer one of the same joint."""
COUNTED = re.compile(r"joint_\d+")
"""Labels of a list that names no joints, as a bag's Float64MultiArray: of those whose positions were logged beside it."""
PARTS = listed("joint joints motor motors gelenk")
_NUMBERED_ID = re.compile(r"(?<![A-Za-z])id_?\d", re.IGNORECASE)
_LOW = frozenset(["low"])
_NOT_JOINT = TOOLS | listed(
    "autopilot pose imu mode status enable enabled flag index frame episode id seq count counter error err errors done "
    "success layout force wrench quat orientation gain kp kd ki vicon mocap gps odom cov covariance sin cos camera "
    "extrinsics intrinsics timestamp timestamps scaling override"
)


@dataclass(frozen=True)
class Reading:
    """What a column's name says of a joint."""

    kind: str
    """position, velocity, ...; '' if no word tells."""
    command: bool
    sent: bool
    measured: bool
    """Whether a word says so that is no part of a joint's name."""
    unit: str
    label: str
    """What is left of the name without the words for kind and unit."""
    implied: bool
    """Whether no word tells the kind: the position of what is plainly measured, or commanded."""
    joint: bool
    """False where a word says that this is no joint's signal (a pose, a mode, a counter)."""

    @property
    def is_position(self) -> bool:
        """Whether it is where a joint was measured to be."""
        return self.joint and self.kind == "position" and not self.command


@functools.lru_cache(1 << 15)
def read(name: Name) -> Reading:
    """What a column's name says of a joint."""
    plain = name.words
    kinds = [_kind(word) for word in plain]
    commands = [_is_command(i, plain) for i in range(len(plain))]
    told = any(commands) or bool(PLAINLY_MEASURED & set(plain))
    kind, kinds, gain = _gain(plain, kinds)
    kind = kind or next((_RATES[w] for w in plain if w in _RATES), next((k for k in kinds if k), ""))
    pushes = not kind and any(commands) and bool(_FORCES & set(plain)) and not _NOT_PUSHED & set(plain)
    if pushes:
        kind, kinds = "torque", ["torque" if word in _FORCES else k for word, k in zip(plain, kinds, strict=True)]
    unit, where = _unit(name, kind, share=any(commands))
    if pushes and not (name.bracketed or name.tail):
        unit = "N"
    if not kind and (told or not (AXES | {"heading"}) & set(plain[:1])):
        kind, unit, where = _kind_by_unit(name, told=told)
        said = {"position": ENCODERS, "current": _AMPERES, "velocity": _SPEEDS}.get(kind, frozenset())
        kinds = [kind if word in said else k for word, k in zip(plain, kinds, strict=True)]
    implied = not kind
    if not kind:
        amperes = (name.bracketed or name.tail) in ("A", "mA")
        kind, kinds, implied = _by_letter(plain, kinds, current=told or amperes, position=told and not any(commands))
        unit, where = _unit(name, kind, share=any(commands))
    keep = _kept_words(name, kinds, commands, where)
    numbered = bool(kind) or _NUMBERED_ID.search(name.text) is not None  # id1_position is a drive's
    finger = "index" in plain and any(keep[plain.index("index") + 1 :])  # index_mcp is a hand's, index a count
    others = _NOT_JOINT - gain - ({"id"} if numbered else set()) - (_FORCES if pushes else set())
    others -= {"index"} if finger else set()
    return Reading(
        kind=kind,
        command=any(commands),
        sent=any(word in SENT for word in plain),
        measured=bool((MEASURED - PARTS) & set(plain)),
        unit=unit,
        label=name.cut_out(keep),
        implied=implied,
        joint=not others & set(plain),
    )


def label_of(rest: str) -> str:
    """A label from what is left of a column's name: a bare number or nothing becomes "joint_n"."""
    return f"joint_{rest or 1}" if not rest or rest.isdigit() else rest


def joint_labels(names: Sequence[str]) -> tuple[str, ...]:
    """Labels for columns: what distinguishes their names, "joint_3" where that is a number; unique."""
    labels = [label_of(read(taken_apart(name)).label) for name in names]
    return tuple(labels) if len(set(labels)) == len(labels) else tuple(names)


def _kind(word: str) -> str:
    """The kind of signal a word names; "qdes" and "istwinkel" are taken apart."""
    return KINDS[word] if word in KINDS else _apart(word)[0]


def _apart(word: str) -> tuple[str, str]:
    """The kind in a word made of two, and the other, which commands or measures or says of what: "cmdpos", "motorstrom"; both
    empty for any other word.
    """
    for i in range(1, len(word)):
        for kind, other in ((word[:i], word[i:]), (word[i:], word[:i])):
            if kind in KINDS and len(other) > 2 and other in COMMANDED | PLAINLY_MEASURED | PARTS:
                return KINDS[kind], other
    return "", ""


def _gain(plain: Sequence[str], kinds: Sequence[str]) -> tuple[str, list[str], frozenset[str]]:
    """The setting of a drive that words name, the kinds of all words then, and which of them say so; of a position alone.

    What a speed or a current is controlled with tells nothing of a servo's stiffness.
    """
    for said, kind in _GAINS:
        others = {k for word, k in zip(plain, kinds, strict=True) if word not in said}
        if said <= set(plain) and others <= {"", "position"}:
            return kind, [kind if word in said else k for word, k in zip(plain, kinds, strict=True)], said
    return "", list(kinds), frozenset()


def _is_command(i: int, plain: Sequence[str]) -> bool:
    word = plain[i]
    if word in _CONTROL and (PLAINLY_MEASURED & set(plain) or plain[i + 1 : i + 2] in _WITHIN):
        return False
    if word in COMMANDED or word in _ITSELF:
        return True
    if word == "input":  # axis0.controller.input_pos; of a voltage it is the supply's
        return any(_kind(other) in ("position", "velocity", "torque") for other in plain)
    if word == "d":  # q_d, tau_J_d: desired
        return any(previous in KINDS or previous in _SHORT for previous in plain[:i])
    return word not in KINDS and _apart(word)[1] in COMMANDED


def _unit(name: Name, kind: str, *, share: bool) -> tuple[str, range]:
    """The unit that a name says, and the words that say it, where it is one of the kind; positions that are commanded may be
    told as a `share` of their range.
    """
    if name.bracketed:
        return name.bracketed, range(0)
    if kind in ("torque", "current", "load", "duty") or (share and kind in ("", "position")):
        for i, word in enumerate(name.words):
            if word in SHARES:
                return SHARES[word], range(i, i + 1)
    if name.tail and kind and BY_KIND[kind].fits(to_si(name.tail)[0]):
        return name.tail, name.tail_words
    return "", range(0)


def _kind_by_unit(name: Name, *, told: bool) -> tuple[str, str, range]:
    """The kind that a unit speaks of where no word does: "goal_elbow_deg", "tool (N m)"; with the unit and its words.

    Single letters say so only where the name is `told` to be a command or a measurement.
    """
    unit = name.bracketed or name.tail
    short = len(name.bracketed or "".join(name.words[i] for i in name.tail_words)) < 2
    kind = next((rule.kind for rule in RULES if unit and rule.unit and rule.fits(to_si(unit)[0])), "")
    if kind and (told or not short):
        return kind, unit, range(0) if name.bracketed else name.tail_words
    return "", name.bracketed, range(0)


def _by_letter(
    plain: Sequence[str], kinds: Sequence[str], *, current: bool, position: bool
) -> tuple[str, list[str], bool]:
    """Kinds of last resort: i for a current, a rate or v for a speed, an encoder for a position, or what is plainly measured,
    which alone is no more than implied.
    """
    rates = frozenset(["rate", "v"] if position and plain[:1] == ["v"] else ["rate"])  # v_mes_1
    telling = {
        "current": _AMPERES if current and len(plain) > 1 else frozenset(),
        "velocity": rates if len(plain) > 1 and not _OF_A_LOG & set(plain) else frozenset(),
        "position": ENCODERS | _SHORT,
    }
    for kind, said in telling.items():
        if said & set(plain):
            return kind, [kind if word in said else k for word, k in zip(plain, kinds, strict=True)], False
    return ("position" if position else ""), list(kinds), True


def _kept_words(name: Name, kinds: Sequence[str], commands: Sequence[bool], unit: range) -> list[bool]:
    """Which words belong to the joint's name."""
    plain = name.words
    franka = [word == "j" and i > 0 and plain[i - 1] == "tau" for i, word in enumerate(plain)]  # tau_J
    keep = [
        word in _ITSELF or not (kinds[i] or commands[i] or franka[i] or word in SENT or i in unit)
        for i, word in enumerate(plain)
    ]
    low = any(a == "low" and b in ("state", "cmd") for a, b in itertools.pairwise(plain))
    dropped = MEASURED | _NEUTRAL | _CONTROL | {*VARIANTS}
    dropped |= (ENCODERS if any(kinds) else frozenset()) | (_LOW if low else frozenset())
    named = any(kept and word not in dropped for kept, word in zip(keep, plain, strict=True))
    # "joint" and "motor" are part of a name such as FL_hip_joint or Joint_1, "actual" in actual_q_0 is not.
    for i, word in enumerate(plain):
        if word in dropped:
            following = plain[i + 1] if i + 1 < len(plain) else ""
            topic = following in _TOPICS or (following == "cmd" and (low or "lowcmd" in plain))
            keep[i] = keep[i] and word in PARTS and named and not topic
    return keep
