# SPDX-License-Identifier: Apache-2.0
"""TOML tables into frozen dataclasses: every unknown key and every value of a wrong type is named with its choices."""

from __future__ import annotations

import dataclasses
import difflib
import tomllib
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from trueup import files
from trueup.errors import PlanError

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


def read_text(path: Path) -> str:
    """The text of a file. Raises PlanError."""
    if not path.exists() and not path.is_symlink():
        raise PlanError(f"{path}: no such file{files.hint(path)}; `trueup new NAME` writes a plan to edit")
    return files.text(path, PlanError)


def parse_toml(text: str, where: Path) -> dict[str, Value]:
    """The tables of a TOML text. Raises PlanError with line and column where it is none."""
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise PlanError(f"{where}: not valid TOML ({error})") from None


def build(kind: type[T], table: Value, where: str) -> T:
    """The dataclass `kind` from a table. Raises PlanError, which names `where`, key, value and the choices."""
    if not isinstance(table, Mapping):
        raise PlanError(f"{where}: {table!r} is not a table of keys")
    hints = typing.get_type_hints(kind)
    known = [f for f in dataclasses.fields(kind) if not f.name.startswith("_")]  # type: ignore[arg-type]
    check_keys(table, [f.name for f in known], where)
    missing = [
        f.name for f in known
        if f.name not in table and f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
    ]  # fmt: skip
    if missing:
        raise PlanError(f"{where}: '{missing[0]}' is missing")
    made = {key: convert(hints[key], value, where, key) for key, value in table.items()}
    try:
        return kind(**made)
    except ValueError as error:
        raise PlanError(f"{where}: {error}") from None


def check_keys(table: Mapping[str, Value], known: list[str], where: str) -> None:
    """Raises PlanError for a key that is not among `known`, nearest match first."""
    for key in table:
        if key not in known:
            close = difflib.get_close_matches(key, known, n=1)
            hint = f" (did you mean '{close[0]}'?)" if close else ""
            raise PlanError(
                f"{where}: unknown key '{key}' = {table[key]!r}{hint}; keys are: {', '.join(sorted(known))}"
            )


def convert(hint: Any, value: Value, where: str, key: str) -> Any:
    """`value` as the annotation `hint` says. Raises PlanError where it is of another type."""
    table = where if key == "" else f"{where}, {key}"
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return _one_of(arguments, value, where, key)
    if origin is typing.Literal:
        if value not in arguments:
            raise PlanError(f"{table} = {value!r}: is not one of: {', '.join(map(str, arguments))}")
        return value
    if hint is Component:
        return component(value, _inside(where, key))
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return build(hint, value, _inside(where, key))
    if origin is tuple or origin is list or _is_sequence(origin):
        return _several(arguments, value, table)
    if origin is Mapping or (origin is not None and isinstance(value, Mapping)):
        if not isinstance(value, Mapping):
            raise PlanError(f"{table} = {value!r}: must be a table")
        return {k: convert(arguments[1], v, _inside(where, key), k) for k, v in value.items()}
    return _scalar(hint, value, table)


def component(value: Value, where: str) -> Component:
    """A component from its name alone, or from a table with `type` and options. Raises PlanError."""
    if isinstance(value, str):
        return Component(value, {}, where)
    if not isinstance(value, Mapping) or not isinstance(value.get("type"), str):
        raise PlanError(f'{where} = {value!r}: give a name in quotes, or a table with type = "..." and its options')
    return Component(value["type"], {k: v for k, v in value.items() if k != "type"}, where)


def _scalar(hint: Any, value: Value, where: str) -> Any:
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if hint is Path and isinstance(value, str):
        return Path(value)
    if hint in _WORDS and (not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool)):
        raise PlanError(f"{where} = {value!r}: must be {_WORDS[hint]}")
    return value


def _one_of(choices: tuple[Any, ...], value: Value, where: str, key: str) -> Any:
    wanted = [c for c in choices if c is not type(None)]
    for exact in wanted:  # text is text before it is a path, a whole number before any number
        if isinstance(exact, type) and type(value) is exact:
            return value
    problems = []
    for choice in wanted:
        try:
            return convert(choice, value, where, key)
        except PlanError as error:
            problems.append(error)
    raise (
        problems[-1]
        if len(problems) == 1
        else PlanError(
            f"{where}, {key} = {value!r}: must be {' or '.join(_WORDS.get(c, 'a list or table') for c in wanted)}"
        )
    )


def _several(arguments: tuple[Any, ...], value: Value, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise PlanError(f"{where} = {value!r}: must be a list in square brackets")
    if len(arguments) > 1 and arguments[-1] is not Ellipsis:
        if len(value) != len(arguments):
            raise PlanError(f"{where} = {value!r}: must hold {len(arguments)} values")
        return tuple(convert(a, v, where, "") for a, v in zip(arguments, value, strict=True))
    return tuple(convert(arguments[0] if arguments else Any, v, where, "") for v in value)


def _is_sequence(origin: Any) -> bool:
    return isinstance(origin, type) and issubclass(origin, typing.Sequence) and origin is not str


def _inside(where: str, key: str) -> str:
    """The name of a table in a table, as TOML writes it: 'plan.toml, [optimize.search]'."""
    if not key:
        return where
    return f"{where[:-1]}.{key}]" if where.endswith("]") else f"{where}, [{key}]"
