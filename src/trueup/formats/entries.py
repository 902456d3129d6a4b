# SPDX-License-Identifier: Apache-2.0
"""Samples that are an object each, as in JSON and in structs of Parquet: columns by the names of what is nested in them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from trueup.arrays import Array
from trueup.errors import FormatError
from trueup.formats.dates import parse_clock
from trueup.formats.rules.names import words as split_words
from trueup.formats.table import numbers, shown

NAMES = frozenset(["name", "names", "joints", "labels"])
"""Words of a key below which the names of joints stand."""


def from_entries(entries: Sequence[Any], path: Path, key: str) -> dict[str, list[Any]]:
    """Cells by column name, of samples below a `key` of a file ('' at its top). Raises FormatError."""
    where = f"{path}, '{key}'" if key else str(path)
    if not entries:
        raise FormatError(f"{where}: the list is empty")
    if all(isinstance(entry, list) for entry in entries):  # rows without names
        width = max(len(entry) for entry in entries)
        for i, entry in enumerate(entries):
            if len(entry) != width:
                raise FormatError(f"{where}, entry {i + 1}: {len(entry)} numbers, others have {width}")
        return {f"column_{k + 1}": [entry[k] for entry in entries] for k in range(width)}
    columns: dict[str, list[Any]] = {}
    for i, entry in enumerate(entries):
        if not isinstance(entry, dict):
            raise FormatError(f"{where}, entry {i + 1}: {shown(entry)} is not an object with keys")
        for name, value in flat(_with_named_lists(entry)).items():
            if name not in columns:  # setdefault would make a list for every cell
                columns[name] = [None] * len(entries)
            columns[name][i] = value
    return columns


def _with_named_lists(entry: Mapping[str, Any], depth: int = 0) -> dict[str, Any]:
    """An entry in which lists of numbers beside a list of as many names are one number for each name, as ROS says what of a
    message is which joint's; messages may name other joints, in another order.
    """
    named = {key: value for key, value in entry.items() if are_names(key, value)}
    made: dict[str, Any] = {}
    for key, value in entry.items():
        by = next((n for n in named if isinstance(value, list) and n != key and len(named[n]) == len(value)), None)
        if isinstance(value, dict) and depth < 20:
            made[key] = _with_named_lists(value, depth + 1)
        elif depth < 20 and isinstance(value, list) and value and all(isinstance(each, dict) for each in value):
            made |= {f"{key}{part}": _with_named_lists(each, depth + 1) for part, each in _by_part(value)}
        elif by is not None and key not in named:
            made |= {f"{key}/{name}": each for name, each in zip(named[by], value, strict=True)}
        else:
            made[key] = value
    return made


def _by_part(objects: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, dict[str, Any]]]:
    """(what tells it apart, object) of each in a list of them, as a bus of motors has one for each: by the name that it says
    of itself, or by its place.
    """
    said = [
        next(
            (str(value) for key, value in each.items() if isinstance(value, str) and NAMES & set(split_words(key))), ""
        )
        for each in objects
    ]
    named = len(set(said)) == len(said) and all(said)
    for i, (name, each) in enumerate(zip(said, objects, strict=True)):
        if named:
            yield f"/{name}", {key: value for key, value in each.items() if value != name}
        else:
            yield f"[{i}]", dict(each)


def are_names(key: str, value: Any) -> bool:
    """Whether these are names of joints beside their signals: distinct words, whose key says so."""
    words = isinstance(value, list) and bool(value) and all(isinstance(entry, str) for entry in value)
    return words and len(set(value)) == len(value) and bool(NAMES & set(split_words(key)))


def apart_from_names(columns: Mapping[str, list[Any]]) -> tuple[tuple[str, ...], dict[str, list[Any]]]:
    """(the names of joints, the columns without lists of names): those that every entry repeats, also above what they name
    ({"names": [...], "state": {"q": [...]}}); () where entries or lists say others, or none.
    """
    said = {key: [cell for cell in cells if cell] for key, cells in columns.items()}
    lists = {key: cells for key, cells in said.items() if cells and are_names(key.rpartition(".")[2], cells[0])}
    names = {tuple(map(str, cell)) for cells in lists.values() for cell in cells if isinstance(cell, list)}
    return names.pop() if len(names) == 1 else (), {k: cells for k, cells in columns.items() if k not in lists}


def flat(data: Mapping[str, Any], prefix: str = "", depth: int = 0) -> dict[str, Any]:
    """Nested objects as "outer.inner"."""
    result: dict[str, Any] = {}
    for key, value in data.items():
        name = prefix + _printable(key)
        if isinstance(value, dict) and depth < 20:
            result.update(flat(value, f"{name}.", depth + 1))
        else:
            result[name] = _printable(value) if isinstance(value, str) else value
    return result


def _printable(text: str) -> str:
    """JSON can escape half a character, which no terminal or file could show."""
    return text.encode("utf-8", "replace").decode("utf-8")


def columns_of(
    found: Mapping[str, list[Any]], where: str, warnings: list[str]
) -> tuple[dict[str, Array], dict[str, list[str]]]:
    """Columns of numbers, and of words; what was assumed to read them is added to `warnings`."""
    columns: dict[str, Array] = {}
    words: dict[str, list[str]] = {}
    for name, cells in found.items():
        values = numbers(cells, f"{where}, key '{name}'", "entry")
        if isinstance(values, list):
            clock = parse_clock(values)
            values = values if clock is None else clock.time
            warnings += [f"{where}, key '{name}': {clock.note}"] if clock is not None and clock.note else []
        if isinstance(values, list):
            words[name] = values
        elif values.size:
            columns[name] = values
    return columns, words
