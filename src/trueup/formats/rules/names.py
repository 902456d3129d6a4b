# SPDX-License-Identifier: Apache-2.0
"""The words of a column's name, the unit that it ends with, and what marks a command or a measurement in any dialect."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from trueup.units import canonical


def listed(text: str) -> frozenset[str]:
    """The words of a text."""
    return frozenset(text.split())


COMMANDED = listed(
    "command commands commanded cmd cmds goal goals target targets tgt desired des setpoint setpoints sp control controls "
    "ctrl action actions act ref reference references requested request req demand set u soll ff feedforward "
    "planned consigne consigna referencia riferimento"
)
"""Words that make a command of what stands beside them."""
SENT = listed("sent written applied")
PLAINLY_MEASURED = listed("measured meas msr msd mes observed actual present feedback fb fbk ist mesure medida misura")
"""Words that mean a position where nothing says of what."""
TRACKERS = listed("vicon mocap optitrack qualisys odom odometry gps gnss uwb imu cam camera encoder")
"""Where a measurement may come from."""
_WHOSE = COMMANDED | SENT | PLAINLY_MEASURED | TRACKERS
"""Words that may stand behind a unit: none is a part of the robot."""
MEASURED = PLAINLY_MEASURED | listed(
    "observation obs state states read sensor sensed data motor motors joint joints field est estimate "
    "estimated pv real"
)
AXES = listed("x y z w roll pitch yaw qx qy qz qw rx ry rz px py pz tx ty tz")
TOOLS = listed("ee eef tcp effector endeffector cartesian")
"""Of what an arm carries, whose pose is none of its joints and none of its base."""
_ANGLES_BY_LETTER = listed("r p y")
EULER = listed("rpy euler")
_TIME = listed(
    "time timestamp timestamps t stamp stamps times clock elapsed ts sec secs seconds millis micros datetime msec "
    "usec nsec nanosec epoch unix utc timestep date received zeit zeitstempel uhrzeit tiempo tempo temps"
)
_TIME_UNITS = listed("ms us ns")
"""Names of a clock by themselves."""
_TICKS = listed("tick ticks duration")
_NANOSECONDS = listed("nsec nsecs nanosec nanosecs nanos nanoseconds")
_NOT_TIME = listed("per index frame episode step steps count counter id seq")
_TAILS: Mapping[tuple[str, ...], str] = MappingProxyType(
    {
        **{tuple(u.lower().split("/")): u for u in ("km/h", "m/s", "cm/s", "mm/s", "rad/s", "deg/s")},
        **{(w,): w for w in ("rpm", "mph", "m", "cm", "mm", "km", "rad", "mrad", "deg", "rev")},
        **dict.fromkeys((("kmh",), ("kph",), ("kmph",)), "km/h"), ("mps",): "m/s", ("ms",): "ms",
        ("mmps",): "mm/s", ("cmps",): "cm/s",
        **dict.fromkeys((("m", "s2"), ("m", "s^2"), ("ms2",), ("mps2",)), "m/s^2"),
        **dict.fromkeys((("rads",), ("radps",)), "rad/s"), **dict.fromkeys((("dps",), ("degs",), ("degps",)), "deg/s"),
        **dict.fromkeys((("degrees",), ("degree",), ("grad",)), "deg"), **dict.fromkeys((("radians",), ("radian",)), "rad"),
        ("rev", "s"): "rev/s", ("rps",): "rev/s",
        **dict.fromkeys((("percent",), ("pct",), ("prozent",)), "%"), ("us",): "1", ("nm",): "N m", ("mnm",): "mN m",
        ("a",): "A", ("ma",): "mA", ("v",): "V", ("mv",): "mV", ("c",): "degC", ("degc",): "degC", ("k",): "K", ("n",): "N",
    }
)  # fmt: skip
"""Words at the end of a name: the unit; "1" for the microseconds of a pulse, which is a number as good as any."""

_BRACKETS = frozenset("[]()")
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_PIECE = re.compile(r"[^_\s./\-]+")
_BRACKETED_UNIT = re.compile(r"[\[(]\s*([^\])]*?)\s*[\])]\s*$")


@dataclass(frozen=True)
class Name:
    """A column's name taken apart."""

    text: str
    """Without a unit in brackets."""
    bracketed: str
    """The unit in brackets, as `units` writes it; '' for none."""
    spans: tuple[tuple[str, int, int], ...]
    """Its words in lower case, and where each begins and ends in `text`."""
    tail: str
    """The unit that the words end with (before an index): one of `units`, "1" for none but a number; '' for no unit."""
    tail_words: range
    """Which words say that."""

    @property
    def words(self) -> list[str]:
        """All words."""
        return [word for word, _, _ in self.spans]

    @property
    def bare(self) -> list[str]:
        """The words without the unit at the end."""
        return [word for i, word in enumerate(self.words) if i not in self.tail_words]

    def cut_out(self, keep: Sequence[bool]) -> str:
        """The kept words with what stands between them."""
        pieces: list[str] = []
        for i, (_, start, end) in enumerate(self.spans):
            if keep[i]:
                joined = bool(pieces) and i > 0 and keep[i - 1]
                between = self.text[self.spans[i - 1][2] : start] if joined else ("_" if pieces else "")
                between = between if not set(between) & _BRACKETS else "_"
                pieces.append(between + self.text[start:end])
        return "".join(pieces)


def taken_apart(name: str) -> Name:
    """The name in its parts."""
    name = unicodedata.normalize("NFC", name)
    match = _BRACKETED_UNIT.search(name)
    unit = canonical(match[1]) if match and match[1] else None
    text = name[: match.start()].rstrip(" _") if match is not None and unit else name
    spans = tuple((word[0].lower(), word.start(), word.end()) for word in _WORD.finditer(_without_accents(text)))
    tail, where = ("", range(0)) if unit else _tail(text, spans)
    return Name(text, unit or "", spans, tail, where)


def _tail(text: str, spans: Sequence[tuple[str, int, int]]) -> tuple[str, range]:
    """The unit at the end of a name, in pieces of their own ("pos_hip_deg", "speed m/s"); a name is more than its unit.

    An index may follow it, or what only says whose it is ("speed_kmh_set"): not behind single letters, as of motor_a_cmd.
    """
    pieces = [(match[0].lower(), match.start()) for match in _PIECE.finditer(text)]
    pieces = pieces[:-1] if len(pieces) > 1 and pieces[-1][0].isdigit() else pieces
    last = len(spans) - 1 if spans and spans[-1][0].isdigit() else len(spans)
    whole = len(pieces)
    while len(pieces) > 1 and pieces[-1][0] in _WHOSE:
        pieces, last = pieces[:-1], next(i for i, span in enumerate(spans) if span[1] >= pieces[-1][1])
    for count in (2, 1):
        unit = _TAILS.get(tuple(piece for piece, _ in pieces[-count:]), "")
        if unit == "N" and text[pieces[-1][1]] != "N":  # a small n counts
            continue
        if len(pieces) < whole and sum(len(piece) for piece, _ in pieces[-count:]) < 2:
            continue
        if unit and len(pieces) > count:
            last = len(spans) if pieces[-1][0].endswith("2") and len(pieces) == whole else last  # of m/s2, and no index
            return unit, range(next(i for i, span in enumerate(spans) if span[1] >= pieces[-count][1]), last)
    while last > 2 and spans[last - 1][0] in _WHOSE:  # jointAngleDegCmd
        last -= 1
    camel = spans[last - 1][0] if last > 1 else ""
    unit = _TAILS.get((camel,), "") if len(camel) > 2 else ""  # jointAngleDeg
    return unit, range(last - 1, last) if unit else range(0)


def axes(plain: Sequence[str]) -> frozenset[str]:
    """Which words of a name are axes or indices: letters r, p and y too where "rpy" says what they are."""
    known = AXES | _ANGLES_BY_LETTER if EULER & set(plain) else AXES
    return frozenset(word for word in plain if word in known or word.isdigit())


def words(name: str) -> list[str]:
    """The words and numbers of a name, in lower case: "jointPos_1" -> joint, pos, 1."""
    return [match[0].lower() for match in _WORD.finditer(_without_accents(unicodedata.normalize("NFC", name)))]


def _without_accents(name: str) -> str:
    """The same name, letter by letter, with plain letters: an accent ends no word ("Längengrad", "posición")."""
    return "".join(unicodedata.normalize("NFD", letter)[0] for letter in name)


def is_time(name: str) -> bool:
    """Whether a name sounds like a clock: of words made of two the last says so (Unitree's motiontime, simtime)."""
    plain = set(words(name))
    return (
        any(word in _TIME or word.endswith("time") for word in plain) and not plain & _NOT_TIME
    ) or name.strip().lower() in _TIME_UNITS


def says_nanoseconds(name: str) -> bool:
    """Whether a name says that these are nanoseconds, which beside seconds are the rest of them."""
    return bool(_NANOSECONDS & set(words(name)))


def ticks(name: str) -> bool:
    """Whether a name sounds like what a controller's clock counts, or an encoder, or how long it took."""
    return bool(set(words(name)) & _TICKS)


def names_its_clock(column: str, clock: str, main: str) -> bool:
    """Whether a column and a second clock share a word that the main clock lacks ("cmd_pos" and "cmd_time")."""
    return bool((set(words(clock)) - _TIME - set(words(main))) & set(words(column)))


def stem(name: str) -> str:
    """The name of a file without its ending; topics have none."""
    return name.rsplit(".", 1)[0] if "." in name and not name.startswith("/") else name
