# SPDX-License-Identifier: Apache-2.0
"""Reads JSON: a list of entries (one object a sample), columns by name, or one object a line."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from trueup import files
from trueup.arrays import Array
from trueup.errors import FormatError
from trueup.formats.dates import parse_clock
from trueup.formats.rules.names import words as split_words
from trueup.formats.table import Table, numbers, shown

_NAMES = frozenset(["name", "names", "joints", "labels"])
"""Words of a key below which the names of joints stand."""


def read(path: Path) -> Table:
    """The table in a JSON file; facts beside it go to `metadata`.

    Raises FormatError naming line and column of a syntax error, or entry, key and value of what is no number.
    """
    text = files.text(path, FormatError)
    if not text.strip():
        raise FormatError(f"{path} is empty")
    data, warnings = _parse(text, path)
    found = _find(data, path)
    columns, words = _columns(found, str(path), warnings)
    if not columns:
        raise FormatError(f"{path}: no numbers found in its {len(found)} {'keys' if found else 'entries'}")
    metadata = _facts(data) if isinstance(data, dict) else {}
    labels = _names(data) if isinstance(data, dict) else ()
    return Table(path.name, str(path), columns, words, labels=labels, row_word="entry", metadata=metadata,
                 warnings=tuple(warnings))  # fmt: skip


def _parse(text: str, path: Path) -> tuple[Any, list[str]]:
    try:
        return json.loads(text), []
    except RecursionError:
        raise FormatError(f"{path}: lists nested too deeply") from None
    except ValueError as error:
        lines = text.strip().split("\n")
        if len(lines) > 1 and lines[0].strip().endswith("}"):
            return _parse_lines(lines, path)
        where = f", line {error.lineno}, column {error.colno}" if isinstance(error, json.JSONDecodeError) else ""
        reason = error.msg if isinstance(error, json.JSONDecodeError) else str(error)
        raise FormatError(f"{path}{where}: not valid JSON ({reason}); is the file cut off?") from None


def _parse_lines(lines: Sequence[str], path: Path) -> tuple[list[Any], list[str]]:
    """One object a line; a last line that was cut off is dropped."""
    entries: list[Any] = []
    for i, line in enumerate(lines):
        if not line.strip():
            continue
        try:
            entries.append(json.loads(line))
        except (ValueError, RecursionError) as error:
            if i == len(lines) - 1 and entries:
                return entries, [f"{path.name}: the last line ({i + 1}) is cut off and was dropped: {shown(line)}"]
            raise FormatError(f"{path}, line {i + 1}: not valid JSON ({error}): {shown(line)}") from None
    return entries, []


def _find(data: Any, path: Path) -> dict[str, list[Any]]:
    """Cells by column name, from the shapes that logs have."""
    if isinstance(data, list):
        return _from_entries(data, path, "")
    if not isinstance(data, dict):
        raise FormatError(f"{path}: holds {shown(data)}; a list of entries or columns by name is needed")
    lists = {key: value for key, value in _flat(data).items() if isinstance(value, list) and value}
    entries = {key: value for key, value in lists.items() if isinstance(value[0], dict)}
    if entries:
        longest = max(entries, key=lambda key: len(entries[key]))
        return _from_entries(entries[longest], path, longest)
    lengths = [len(value) for value in lists.values()]
    if not lengths:
        raise FormatError(f"{path}: holds no list of samples; its keys are: {', '.join(map(str, data)) or 'none'}")
    usual = max(set(lengths), key=lambda n: (lengths.count(n), n))
    odd = {key: len(value) for key, value in lists.items() if len(value) != usual and abs(len(value) - usual) <= 2}
    if odd and usual > 4:
        key = next(iter(odd))
        raise FormatError(f"{path}: column '{key}' has {odd[key]} samples, the others {usual}")
    columns = {key: value for key, value in lists.items() if len(value) == usual}
    outer = {key.rpartition(".")[0] for key in columns}
    if len(outer) == 1:  # all in one object: its name says nothing
        return {key.rpartition(".")[2]: value for key, value in columns.items()}
    return columns


def _from_entries(entries: Sequence[Any], path: Path, key: str) -> dict[str, list[Any]]:
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
        for name, value in _flat(_with_named_lists(entry)).items():
            if name not in columns:  # setdefault would make a list for every cell
                columns[name] = [None] * len(entries)
            columns[name][i] = value
    return columns


def _with_named_lists(entry: Mapping[str, Any], depth: int = 0) -> dict[str, Any]:
    """An entry in which lists of numbers beside a list of as many names are one number for each name, as ROS says what of a
    message is which joint's; messages may name other joints, in another order.
    """
    named = {key: value for key, value in entry.items() if _are_names(key, value)}
    made: dict[str, Any] = {}
    beside: set[str] = set()
    for key, value in entry.items():
        by = next((n for n in named if isinstance(value, list) and n != key and len(named[n]) == len(value)), None)
        if isinstance(value, dict) and depth < 20:
            made[key] = _with_named_lists(value, depth + 1)
        elif depth < 20 and isinstance(value, list) and value and all(isinstance(each, dict) for each in value):
            made |= {f"{key}{part}": _with_named_lists(each, depth + 1) for part, each in _by_part(value)}
        elif by is not None and key not in named:
            beside.add(by)
            made |= {f"{key}/{name}": each for name, each in zip(named[by], value, strict=True)}
        else:
            made[key] = value
    return {key: value for key, value in made.items() if key not in beside}


def _by_part(objects: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, dict[str, Any]]]:
    """(what tells it apart, object) of each in a list of them, as a bus of motors has one for each: by the name that it says
    of itself, or by its place.
    """
    said = [
        next(
            (str(value) for key, value in each.items() if isinstance(value, str) and _NAMES & set(split_words(key))), ""
        )
        for each in objects
    ]
    named = len(set(said)) == len(said) and all(said)
    for i, (name, each) in enumerate(zip(said, objects, strict=True)):
        if named:
            yield f"/{name}", {key: value for key, value in each.items() if value != name}
        else:
            yield f"[{i}]", dict(each)


def _are_names(key: str, value: Any) -> bool:
    """Whether these are names of joints beside their signals: distinct words, whose key says so."""
    words = isinstance(value, list) and bool(value) and all(isinstance(entry, str) for entry in value)
    return words and len(set(value)) == len(value) and bool(_NAMES & set(split_words(key)))


def _columns(
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


def _flat(data: Mapping[str, Any], prefix: str = "", depth: int = 0) -> dict[str, Any]:
    """Nested objects as "outer.inner"."""
    result: dict[str, Any] = {}
    for key, value in data.items():
        name = prefix + _printable(key)
        if isinstance(value, dict) and depth < 20:
            result.update(_flat(value, f"{name}.", depth + 1))
        else:
            result[name] = _printable(value) if isinstance(value, str) else value
    return result


def _printable(text: str) -> str:
    """JSON can escape half a character, which no terminal or file could show."""
    return text.encode("utf-8", "replace").decode("utf-8")


def _facts(data: Mapping[str, Any]) -> dict[str, str]:
    """Single values at the top, such as a mass or a gain, and short lists of numbers, such as a gain for each joint."""
    return {key: str(value) for key, value in _single(_flat(data)) if len(str(value)) < 200}


def _single(data: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in data.items():
        listed = isinstance(value, list) and all(isinstance(entry, (int, float)) for entry in value)
        if value is not None and (listed or not isinstance(value, (list, dict))):
            yield key, value


def _names(data: Mapping[str, Any]) -> tuple[str, ...]:
    """The names of joints beside the signals: the only list of words whose key says so; () without one."""
    found = [
        tuple(value) for key, value in _flat(data).items()
        if isinstance(value, list) and value and all(isinstance(entry, str) for entry in value)
        and _NAMES & set(split_words(key))
    ]  # fmt: skip
    return found[0] if len(found) == 1 and len(set(found[0])) == len(found[0]) else ()
