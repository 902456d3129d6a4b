# SPDX-License-Identifier: Apache-2.0
"""What names of columns mean beside one another: an act that is actual, letters of an inertial unit, what is current."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

from trueup.formats.rules.names import AXES, COMMANDED, MEASURED, listed, taken_apart, words
from trueup.formats.rules.signals import KINDS

_LEADING = ("command", "actual")
_LED = tuple(
    (tuple(re.compile(rf"(?<![A-Za-z]){word}(?![A-Za-z])", re.IGNORECASE) for word in pair), meant)
    for pair, meant in (
        (("leader", "follower"), _LEADING),
        (("master", "puppet"), _LEADING),
        (("master", "slave"), _LEADING),
        (("actuator", "sensor"), _LEADING),
        (("stiffness", "damping"), ("kp", "kd")),
    )
)
"""Words that mean something only where both stand beside the same: of a robot that is led by hand and one that follows it, of
the gains of a drive (a joint has damping, too). And what they mean then.
"""
_OBJECT = re.compile(r"(?<![A-Za-z0-9])(?:0x60[0-9A-Fa-f]{2}|60[0-9A-Fa-f]{2}h)(?![A-Za-z0-9])_?")
"""What a drive on a bus calls its objects (CiA 402): 6064h_position_actual, 0x607A_target_position."""
_RSI = {re.compile(r"(?<![A-Za-z])AIPos"): "actual_position", re.compile(r"(?<![A-Za-z])ASPos"): "command_position",
        re.compile(r"(?<![A-Za-z])MACur"): "current"}  # fmt: skip
"""What KUKA's robot sensor interface calls an axis's position, its set point, and its motor's current."""
_SIX = tuple(re.compile(rf"(?<![A-Za-z]){letter}([xyz])(?![A-Za-z])", re.I) for letter in ("a", "[gw]", "w"))
"""Axes of an accelerometer and of a gyro, each a word; and those of which a gyro alone is told, as g may be gravity."""
_ACT = re.compile(r"(?<![A-Za-z])[Aa][Cc][Tt](?![A-Za-z])|(?<![A-Za-z])[Aa]ct(?=[A-Z])")

_EFFORTS = listed("torque torques trq tau moment effort efforts current currents")
_LETTERS = {"p": "position", "v": "velocity", "t": "torque"}
"""Of what drives of legged robots are told beside kp and kd, as a Mini Cheetah's are (B. Katz, 2018): p_des, v_des, t_ff."""
_NOW = re.compile(r"(?<![A-Za-z])(?i:current|curr|cur)(?![a-z])")
"""A current, or what is so at present."""
_PLACES = AXES | listed("pose heading steering steer orientation lat latitude lon longitude lng")


def in_context(names: Sequence[str], joints: Sequence[str] = ()) -> dict[str, str]:
    """Each name as it is to be read beside the others: what makers call their signals, pairs, letters, what is so at present;
    and "act" as "actual", but in the name of one of the `joints` of a model ("L_act").
    """
    read = {name: _OBJECT.sub("", name).strip("_ ") or name for name in names}
    for word, meant_by_it in _RSI.items():
        read = {name: word.sub(meant_by_it, as_read) for name, as_read in read.items()}
    for words_of_pair, meant in _LED:
        read = _in_pairs(read, words_of_pair, meant)
    read = _present(_impedance(_inertial(read)))
    own = [f" {' '.join(words(joint))} " for joint in joints if "act" in words(joint)]
    acted = _acted([name for name in read.values() if not any(joint in f" {' '.join(words(name))} " for joint in own)])
    return {name: acted.get(as_read, as_read) for name, as_read in read.items()}


def _inertial(read: dict[str, str]) -> dict[str, str]:
    """Names in which ax, ay, az beside gx, gy, gz (or wx, wy, wz) are an accelerometer's axes and a gyro's: all
    six, behind the same words; or wx, wy, wz alone.
    """
    whole: list[set[str]] = []
    for word in _SIX:
        seen: dict[str, set[str]] = {}
        for match in filter(None, map(word.search, read.values())):
            seen.setdefault(match.string[: match.start()].lower(), set()).add(match[1].lower())
        whole.append({head for head, along in seen.items() if along == {"x", "y", "z"}})
    heads = (whole[0] & whole[1],) * 2 + (whole[2],)

    def as_sensor(name: str) -> str:
        for word, sensor, own in zip(_SIX, ("acc", "gyro", "gyro"), heads, strict=True):
            match = word.search(name)
            if match and match.string[: match.start()].lower() in own:
                return word.sub(rf"{sensor}_\1", name)
        return name

    return {name: as_sensor(as_read) for name, as_read in read.items()}


def _acted(names: Sequence[str]) -> dict[str, str]:
    """Each name with "actual" for "act" where that is what it means, and no action: beside plain words for commands, with a
    unit, and behind a torque or current where no other is there ("trq_act"): should it be one after all, it drives what it
    drove.
    """
    plain = (COMMANDED | {"throttle", "steering"}) - {"act"}
    measured = any(unit not in ("", "1") for name in names if _ACT.search(name) for unit in _units(name))
    if measured or any(plain & set(words(name)) for name in names):
        return {name: _ACT.sub("actual", name) for name in names}
    given = {name: words(name) for name in names}
    efforts = {name for name, each in given.items() if _EFFORTS & set(each)}
    behind = {name for name in efforts if any(a in _EFFORTS and b == "act" for a, b in pairwise(given[name]))}
    return {name: _ACT.sub("actual", name) if efforts == behind and name in behind else name for name in names}


def _in_pairs(read: dict[str, str], pair: Sequence[re.Pattern[str]], meant: Sequence[str]) -> dict[str, str]:
    """Names with what the words of a pair mean, where every name that has one has its like with the other.

    More may be measured than is commanded; both gains are of the same drives.
    """
    one, other = pair
    beside = [{word.sub("", name) for name in read.values() if word.search(name)} for word in pair]
    if not beside[0] or not (beside[0] <= beside[1] if "actual" in meant else beside[0] == beside[1]):
        return read
    return {name: other.sub(meant[1], one.sub(meant[0], as_read)) for name, as_read in read.items()}


def _units(name: str) -> tuple[str, str]:
    """In brackets, and at its end."""
    whole = taken_apart(name)
    return whole.bracketed, whole.tail


def _impedance(read: dict[str, str]) -> dict[str, str]:
    """Names in which single letters stand for what a drive is told or measures, where gains and positions are called so."""
    plain = {name: set(words(as_read)) for name, as_read in read.items()}
    if not all(any(word in each for each in plain.values()) for word in ("kp", "kd", "p", "v")):
        return read
    said = COMMANDED | MEASURED
    found = dict(read)
    for letter, kind in _LETTERS.items():
        word = re.compile(rf"(?<![A-Za-z]){letter}(?![A-Za-z])", re.IGNORECASE)
        found |= {name: word.sub(kind, found[name]) for name, each in plain.items() if letter in each and each & said}
    return found


def _present(read: dict[str, str]) -> dict[str, str]:
    """Names with "present" for "current" where that tells when, and not what: beside another kind of signal, or a place.

    A torque's current is one, as is what is in amperes, and what stands before names of joints: of `current_hip` and
    `current_gripper_speed` both are currents.
    """
    named = {name: now for name, as_read in read.items() if (now := _NOW.search(as_read)) and not _in_amperes(as_read)}
    heads = {now.string[: now.end()] for now in named.values() if _tells_what(now.string[now.end() :])}
    found = dict(read)
    for name, now in named.items():
        as_read = read[name]
        behind, before = words(as_read[: now.start()]), words(as_read[now.end() :])
        said = any(KINDS.get(word) in ("position", "velocity") and len(word) > 1 for word in behind)
        if said or (as_read[: now.end()] not in heads and _of_another_kind(before)):
            found[name] = _NOW.sub("present", as_read, count=1)
    return found


def _in_amperes(name: str) -> bool:
    parts = taken_apart(name)
    return (parts.bracketed or parts.tail) in ("A", "mA")


def _tells_what(rest: str) -> bool:
    """Whether what follows a current is a name, and no kind of signal and no number."""
    plain = words(rest)
    return bool(plain) and not _of_another_kind(plain) and not all(word.isdigit() for word in plain)


def _of_another_kind(plain: Sequence[str]) -> bool:
    return any(KINDS.get(word, "current") != "current" for word in plain) or bool(_PLACES & {*plain[:1]})
