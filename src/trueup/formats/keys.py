# SPDX-License-Identifier: Apache-2.0
"""Keys of a TOML table as fields of a dataclass: how each is checked, and how it is written with its comment."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable
from typing import Any, TypeVar

from trueup.errors import MappingError, TrueupError
from trueup.units import to_si

T = TypeVar("T")
Read = Callable[[Any, str], Any]
"""(value, where it stands) -> the value as the field holds it. Raises MappingError."""


def key(default: Any, read: Read, *, comment: str = "", unset: str | None = "") -> Any:
    """A field that is a key of the table.

    `comment` is written behind it, `unset` as a line of its own where the field has its default ('' writes nothing, None
    writes the default itself).
    """
    return dataclasses.field(default=default, metadata={"read": read, "comment": comment, "unset": unset})


def to_lines(table: Any) -> list[str]:
    """The lines `key = value  # comment` of a dataclass with such fields, those that have their default left out."""
    lines: list[str] = []
    for field in dataclasses.fields(table):
        value, unset = getattr(table, field.name), field.metadata["unset"]
        if value != field.default or unset is None:
            comment = field.metadata["comment"]
            lines.append(f"{field.name} = {_written(value)}" + (f"  # {comment}" if comment else ""))
        elif unset and not getattr(table, f"{field.name}s", ()):  # `units` in the place of `unit`
            lines.append(unset)
    return lines


def text(value: Any, where: str) -> str:
    """A text."""
    if not isinstance(value, str):
        raise MappingError(f"{where}: {value!r} is not a text in quotes")
    return value


def texts(value: Any, where: str) -> tuple[str, ...]:
    """Texts, or one."""
    entries = [value] if isinstance(value, str) else value
    if not isinstance(entries, (list, tuple)):
        raise MappingError(f"{where}: {value!r} is not a list of texts")
    return tuple(text(entry, where) for entry in entries)


def number(value: Any, where: str) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e300:
        raise MappingError(f"{where}: {value!r} is not a finite number")
    return float(value)


def numbers(value: Any, where: str) -> tuple[float, ...]:
    """Numbers, or one."""
    entries = value if isinstance(value, (list, tuple)) else [value]
    if not entries:
        raise MappingError(f"{where}: the list is empty; give one number, or one for each label")
    return tuple(number(entry, where) for entry in entries)


def count(value: Any, where: str) -> int:
    """A number of columns."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise MappingError(f"{where}: {value!r} is not a number of columns (1, 2, ...)")
    return value


def rate(value: Any, where: str) -> float:
    """A rate in Hz."""
    per_second = number(value, where)
    if per_second <= 0.0:
        raise MappingError(f"{where}: {per_second:g} Hz is not a positive rate")
    return per_second


def unit(value: Any, where: str) -> str:
    """A unit that is known, or ''."""
    try:
        to_si(text(value, where))
    except TrueupError as error:
        raise MappingError(f"{where}: {error}") from None
    return value


def units(value: Any, where: str) -> tuple[str, ...]:
    """Units that are known, or ''."""
    return tuple(unit(entry, where) for entry in texts(value, where))


def time_unit(value: Any, where: str) -> str:
    """A unit of time, or ''."""
    if unit(value, where) and to_si(value)[0] != "s":
        raise MappingError(f"{where}: '{value}' is not a unit of time; give s, ms, us, ns or min")
    return value


def name(word: str) -> str:
    """A key's name as TOML has it."""
    return word if re.fullmatch(r"[A-Za-z0-9_-]+", word) else quoted(word)


def quoted(content: str) -> str:
    """A text as TOML has it."""
    # JSON escapes are TOML escapes, except that TOML wants DEL escaped and knows no surrogates.
    plain = content.encode("utf-8", "replace").decode("utf-8")
    return json.dumps(plain, ensure_ascii=False).replace("\x7f", "\\u007f")


def _written(value: Any) -> str:
    if isinstance(value, str):
        return quoted(value)
    if not isinstance(value, tuple):
        return repr(value)
    if len(value) == 1 and not isinstance(value[0], str):
        return repr(value[0])
    entries = [_written(entry) for entry in value]
    flat = "[" + ", ".join(entries) + "]"
    # A long list is written one entry a line.
    return flat if len(flat) <= 100 else "[\n    " + ",\n    ".join(entries) + ",\n]"
