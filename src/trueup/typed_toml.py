# SPDX-License-Identifier: Apache-2.0
"""TOML tables into frozen dataclasses: every unknown key and every value of a wrong type is named with its choices.

A field says by its annotation what it takes, or by `metadata["read"]`, a function of the value and where it stands.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from trueup.errors import PlanError, TrueupError

T = TypeVar("T")
Value = Any
"""What TOML knows: text, numbers, true and false, lists, tables."""

_WORDS = {
    str: "text in quotes",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    Path: "a path in quotes",
}


@dataclass(frozen=True)
class Component:
    """Something that the plan names and campaign/resolve.py makes: a short name or `module:attribute`, and options."""

    type: str
    options: Mapping[str, Value] = field(default_factory=dict)
    where: str = ""
    """File and table, for errors."""

    def __post_init__(self) -> None:
        """Freezes the options; their types are checked against what is made with them."""
        object.__setattr__(self, "options", MappingProxyType(dict(self.options)))


class _WrongError(Exception):
    """What is wrong with a table, before it is known which error the reader of the file raises."""


def build(kind: type[T], table: Value, where: str, error: type[TrueupError] = PlanError) -> T:
    """The dataclass `kind` from a table. Raises `error`, which names `where`, key, value and the choices."""
    try:
        return _built(kind, table, where)
    except _WrongError as wrong:
        raise error(str(wrong)) from None


def converted(hint: Any, value: Value, where: str, key: str) -> Any:
    """`value` as the annotation `hint` says. Raises PlanError where it is of another type."""
    try:
        return _converted(hint, value, where, key)
    except _WrongError as wrong:
        raise PlanError(str(wrong)) from None


def check_keys(
    table: Mapping[str, Value], known: Sequence[str], where: str, error: type[Exception] = PlanError
) -> None:
    """Raises `error` for a key that is not among `known`, nearest match first."""
    for key in table:
        if key not in known:
            close = difflib.get_close_matches(key, known, n=1)
            hint = f" (did you mean '{close[0]}'?)" if close else ""
            raise error(
                f"{where}: unknown key '{key}' = {table[key]!r}{hint}; keys are: {', '.join(sorted(known)) or 'none'}"
            )


def check_finite(table: Value, where: str, error: type[TrueupError] = PlanError) -> None:
    """Raises `error` for a number anywhere in a table that is infinite or none: TOML knows inf and nan."""
    if isinstance(table, float) and not math.isfinite(table):
        raise error(f"{where} = {table}: must be a finite number")
    inside = table.items() if isinstance(table, Mapping) else enumerate(table, 1) if isinstance(table, list) else ()
    for key, value in inside:
        check_finite(value, f"{where}, {key}", error)


def _built(kind: type[T], table: Value, where: str) -> T:
    if not isinstance(table, Mapping):
        raise _WrongError(f"{where}: {table!r} is not a table of keys")
    hints = typing.get_type_hints(kind)
    known = [f for f in dataclasses.fields(kind) if not f.name.startswith("_")]  # type: ignore[arg-type]
    check_keys(table, [f.name for f in known], where, _WrongError)
    missing = [
        f.name for f in known
        if f.name not in table and f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
    ]  # fmt: skip
    if missing:
        raise _WrongError(f"{where}: '{missing[0]}' is missing")
    reads = {f.name: f.metadata["read"] for f in known if "read" in f.metadata}
    made = {
        key: reads[key](value, f"{where}, {key}") if key in reads else _converted(hints[key], value, where, key)
        for key, value in table.items()
    }
    try:
        return kind(**made)
    except ValueError as error:
        raise _WrongError(f"{where}: {error}") from None


def _converted(hint: Any, value: Value, where: str, key: str) -> Any:
    table = where if key == "" else f"{where}, {key}"
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return _one_of(arguments, value, where, key)
    if origin is typing.Literal:
        if value not in arguments:
            raise _WrongError(f"{table} = {value!r}: is not one of: {', '.join(map(str, arguments))}")
        return value
    if hint is Component:
        return _component(value, _inside(where, key))
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return _built(hint, value, _inside(where, key))
    if origin is tuple or origin is list or _is_sequence(origin):
        return _several(arguments, value, table)
    if origin is Mapping or (origin is not None and isinstance(value, Mapping)):
        if not isinstance(value, Mapping):
            raise _WrongError(f"{table} = {value!r}: must be a table")
        return {k: _converted(arguments[1], v, _inside(where, key), k) for k, v in value.items()}
    return _scalar(hint, value, table)


def _component(value: Value, where: str) -> Component:
    """A component from its name alone, or from a table with `type` and options."""
    if isinstance(value, str):
        return Component(value, {}, where)
    if not isinstance(value, Mapping) or not isinstance(value.get("type"), str):
        raise _WrongError(f'{where} = {value!r}: give a name in quotes, or a table with type = "..." and its options')
    return Component(value["type"], {k: v for k, v in value.items() if k != "type"}, where)


def _scalar(hint: Any, value: Value, where: str) -> Any:
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if hint is Path and isinstance(value, str):
        return Path(value)
    if hint in _WORDS and (not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool)):
        raise _WrongError(f"{where} = {value!r}: must be {_WORDS[hint]}")
    return value


def _one_of(choices: tuple[Any, ...], value: Value, where: str, key: str) -> Any:
    wanted = [c for c in choices if c is not type(None)]
    for exact in wanted:  # text is text before it is a path, a whole number before any number
        if isinstance(exact, type) and type(value) is exact:
            return value
    problems = []
    for choice in wanted:
        try:
            return _converted(choice, value, where, key)
        except _WrongError as error:
            problems.append(error)
    raise (
        problems[-1]
        if len(problems) == 1
        else _WrongError(
            f"{where}, {key} = {value!r}: must be {' or '.join(_WORDS.get(c, 'a list or table') for c in wanted)}"
        )
    )


def _several(arguments: tuple[Any, ...], value: Value, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise _WrongError(f"{where} = {value!r}: must be a list in square brackets")
    if len(arguments) > 1 and arguments[-1] is not Ellipsis:
        if len(value) != len(arguments):
            raise _WrongError(f"{where} = {value!r}: must hold {len(arguments)} values")
        return tuple(_converted(a, v, where, "") for a, v in zip(arguments, value, strict=True))
    each = arguments[0] if arguments else Any
    tables = dataclasses.is_dataclass(each)
    return tuple(_converted(each, v, f"{where} {k}" if tables else where, "") for k, v in enumerate(value, 1))


def _is_sequence(origin: Any) -> bool:
    return isinstance(origin, type) and issubclass(origin, typing.Sequence) and origin is not str


def _inside(where: str, key: str) -> str:
    """The name of a table in a table, as TOML writes it: 'plan.toml, [optimize.search]'."""
    if not key:
        return where
    return f"{where[:-1]}.{key}]" if where.endswith("]") else f"{where}, [{key}]"
