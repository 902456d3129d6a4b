# SPDX-License-Identifier: Apache-2.0
"""What an agent perceives in one cycle, out of a server's message, in SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from trueup.errors import TrialError
from trueup.robots.rcss.expressions import Expression, named, parse

Values = tuple[float, ...]


@dataclass(frozen=True)
class Percept:
    """One cycle. Names are those of the server's perceptors; what it did not send is absent or empty."""

    time: float = math.nan
    """s, on the server's clock, as it rounds it."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """rad; a universal joint is two: 'laj1.1', 'laj1.2'."""
    speeds: Mapping[str, float] = field(default_factory=dict)
    """rad/s, where the server says them."""
    gyros: Mapping[str, Values] = field(default_factory=dict)
    """rad/s, (3,)."""
    accelerometers: Mapping[str, Values] = field(default_factory=dict)
    """m/s2, (3,)."""
    forces: Mapping[str, Values] = field(default_factory=dict)
    """Force resistance: where it acts in m (3,), then the force in N (3,)."""
    touches: Mapping[str, Values] = field(default_factory=dict)
    """(1,): not 0 where something touches."""
    positions: Mapping[str, Values] = field(default_factory=dict)
    """m, (3,) in the field, where the server tells the truth."""
    orientations: Mapping[str, Values] = field(default_factory=dict)
    """Quaternion w, x, y, z, (4,), where the server tells the truth."""
    seen: Mapping[str, Values] = field(default_factory=dict)
    """Distance in m, azimuth and elevation in rad, of what is in sight; parts of players as 'P.team.1.head'."""


def percept(message: bytes) -> Percept:
    """What a message says. What it does not know it leaves out. Raises TrialError for one that is malformed."""
    made: dict[str, dict[str, Values]] = {}
    time = math.nan
    for word, rest in named(parse(message)):
        fields = dict(named(rest))
        if word == "time":
            time = _numbers(fields, "now", 1, message)[0]
        elif word == "HJ":
            made.setdefault("joints", {})[_name(fields, message)] = _turned(_numbers(fields, "ax", 1, message))
            if "vx" in fields:
                made.setdefault("speeds", {})[_name(fields, message)] = _turned(_numbers(fields, "vx", 1, message))
        elif word == "UJ":
            for axis in ("1", "2"):
                at = f"{_name(fields, message)}.{axis}"
                made.setdefault("joints", {})[at] = _turned(_numbers(fields, f"ax{axis}", 1, message))
        elif word == "GYR":
            made.setdefault("gyros", {})[_name(fields, message)] = _turned(_numbers(fields, "rt", 3, message))
        elif word in _PLAIN:
            kind, keys = _PLAIN[word]
            values = tuple(x for key, axes in keys.items() for x in _numbers(fields, key, len(axes), message))
            made.setdefault(kind, {})[_name(fields, message)] = values
        elif word == "TCH":  # (TCH n bumper val 1)
            flat = [a for a in rest if isinstance(a, str)]
            made.setdefault("touches", {})[_after(flat, "n", message)] = (
                _number(_after(flat, "val", message), message),
            )
        elif word == "See":
            made.setdefault("seen", {}).update(_sights(rest, message))
    single = {kind: {n: v[0] for n, v in made.pop(kind, {}).items()} for kind in ("joints", "speeds")}
    return Percept(time, single["joints"], single["speeds"], **made)  # type: ignore[arg-type]


_PLAIN: Mapping[str, tuple[str, Mapping[str, str]]] = {
    "ACC": ("accelerometers", {"a": "xyz"}),
    "FRP": ("forces", {"c": "xyz", "f": "xyz"}),
    "pos": ("positions", {"p": "xyz"}),
    "quat": ("orientations", {"q": "wxyz"}),
}
"""What words tell, and which numbers stand behind which key."""


def _sights(rest: Sequence[Expression], message: bytes) -> dict[str, Values]:
    found: dict[str, Values] = {}
    for what, fields in named(rest):
        parts = dict(named(fields))
        if "pol" in parts:
            found[what] = _polar(parts, message)
        elif what == "P":
            who = [str(parts[key][0]) for key in ("team", "id") if parts.get(key)]
            for part, inner in parts.items():
                within = {part: inner} if part == "pol" else dict(named(inner))
                if "pol" in within:
                    found[".".join(["P", *who, part])] = _polar(within, message)
    return found


def _polar(fields: Mapping[str, list[Expression]], message: bytes) -> Values:
    distance, azimuth, elevation = _numbers(fields, "pol", 3, message)
    return distance, math.radians(azimuth), math.radians(elevation)


def _turned(values: Values) -> Values:
    return tuple(math.radians(v) for v in values)


def _numbers(fields: Mapping[str, list[Expression]], key: str, count: int, message: bytes) -> Values:
    values = fields.get(key, [])
    if len(values) != count:
        raise _wrong(message, f"'{key}' has {len(values)} values, not {count}")
    return tuple(_number(value, message) for value in values)


def _number(value: Expression, message: bytes) -> float:
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        shown = value if isinstance(value, str) else "(...)"
        raise _wrong(message, f"'{shown[:40]}' is no number")
    return number


def _name(fields: Mapping[str, list[Expression]], message: bytes) -> str:
    if not fields.get("n") or not isinstance(fields["n"][0], str):
        raise _wrong(message, "a perceptor has no name (n ...)")
    return fields["n"][0]


def _after(words: Sequence[str], key: str, message: bytes) -> str:
    if key not in words[:-1]:
        raise _wrong(message, f"a touch perceptor lacks '{key}'")
    return words[words.index(key) + 1]


def _wrong(message: bytes, why: str) -> TrialError:
    shown = message[:120].decode("utf-8", errors="replace")
    return TrialError(f"the server's message is not understood: {why}; it begins: {shown}")
