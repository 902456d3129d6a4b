# SPDX-License-Identifier: Apache-2.0
"""Reads JSON: a list of entries (one object a sample), columns by name, or one object a line."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from trueup import files
from trueup.errors import FormatError
from trueup.formats.entries import NAMES, apart_from_names, columns_of, flat, from_entries
from trueup.formats.rules.names import words as split_words
from trueup.formats.table import Table, shown


def read(path: Path) -> Table:
    """The table in a JSON file; facts beside it go to `metadata`.

    Raises FormatError naming line and column of a syntax error, or entry, key and value of what is no number.
    """
    text = files.text(path, FormatError)
    if not text.strip():
        raise FormatError(f"{path} is empty")
    data, warnings = _parse(text, path)
    labels, found = apart_from_names(_find(data, path))
    columns, words = columns_of(found, str(path), warnings)
    if not columns:
        raise FormatError(f"{path}: no numbers found in its {len(found)} {'keys' if found else 'entries'}")
    metadata = _facts(data) if isinstance(data, dict) else {}
    labels = labels or (_names(data) if isinstance(data, dict) else ())
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
        return from_entries(data, path, "")
    if not isinstance(data, dict):
        raise FormatError(f"{path}: holds {shown(data)}; a list of entries or columns by name is needed")
    lists = {key: value for key, value in flat(data).items() if isinstance(value, list) and value}
    entries = {key: value for key, value in lists.items() if isinstance(value[0], dict)}
    if entries:
        longest = max(entries, key=lambda key: len(entries[key]))
        return from_entries(entries[longest], path, longest)
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


def _facts(data: Mapping[str, Any]) -> dict[str, str]:
    """Single values at the top, such as a mass or a gain, and short lists of numbers, such as a gain for each joint."""
    return {key: str(value) for key, value in _single(flat(data)) if len(str(value)) < 200}


def _single(data: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in data.items():
        listed = isinstance(value, list) and all(isinstance(entry, (int, float)) for entry in value)
        if value is not None and (listed or not isinstance(value, (list, dict))):
            yield key, value


def _names(data: Mapping[str, Any]) -> tuple[str, ...]:
    """The names of joints beside the signals: the only list of words whose key says so; () without one."""
    found = [
        tuple(value) for key, value in flat(data).items()
        if isinstance(value, list) and value and all(isinstance(entry, str) for entry in value)
        and NAMES & set(split_words(key))
    ]  # fmt: skip
    return found[0] if len(found) == 1 and len(set(found[0])) == len(found[0]) else ()
