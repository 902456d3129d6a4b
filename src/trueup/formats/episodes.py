# SPDX-License-Identifier: Apache-2.0
"""Files that hold many runs one after the other, and the names that a data set of them keeps beside (LeRobot's layout)."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.formats.cells import numbered
from trueup.formats.rules.names import words
from trueup.formats.table import Table

INFO = Path("meta", "info.json")
"""Where a LeRobot data set says what its columns hold, from its root."""
_COUNTERS = frozenset(["index", "frame", "episode", "task", "id"])
_RUNS = frozenset(["run", "trial", "trip", "session", "drive", "route", "segment"])
_WHICH = frozenset(["id", "number", "nr", "no", "name", "index"])


def is_description(folder: Path) -> bool:
    """Whether a folder only describes the data set that it lies in."""
    return folder.name == INFO.parent.name and (folder / INFO.name).is_file()


def described(table: Table, path: Path) -> Table:
    """The table with the names that the data set around its file gives to the numbers of list-valued columns."""
    above = 4  # folders between a data file and the root of its set
    for root in list(path.absolute().parents)[:above]:
        if (root / INFO).is_file():
            return replace(table, named=_names(root / INFO, table))
    return table


def episodes(table: Table, stem: str) -> list[tuple[str, Table]]:
    """(name, table) of each run in a table with a column that numbers them; the table under `stem` where none does.

    Columns that only count frames, episodes or tasks are left out then: they are no signals.
    """
    told = {**{name: numbered(cells) for name, cells in table.text.items()}, **table.columns}
    found = next((name for name, values in told.items() if _numbers_runs(name, values, name in table.text)), None)
    if found is None:
        return [(stem, table)]
    numbers = told[found]
    columns = {
        name: values for name, values in table.columns.items() if name != found and not set(words(name)) <= _COUNTERS
    }
    labels = table.text.get(found)
    table = replace(table, columns=columns, text={name: cells for name, cells in table.text.items() if name != found})
    if len(np.unique(numbers)) == 1:
        return [(stem, table)]
    stem = "episode" if table.named else stem
    firsts = np.unique(numbers, return_index=True)[1]
    return [
        (
            f"{stem}_{str(labels[first]).strip() if labels is not None else int(numbers[first])}",
            _rows(table, np.flatnonzero(numbers == numbers[first])),
        )
        for first in np.sort(firsts).tolist()
    ]


def _numbers_runs(name: str, values: Array, texts: bool) -> bool:
    """Whether a column says which run a row is of: whole numbers or texts, each run in one piece."""
    plain = set(words(name))
    named = bool(plain & _RUNS) and plain <= _RUNS | _WHICH and (texts or bool(plain & _WHICH))
    counted = "episode" in plain and plain <= _COUNTERS
    if not (named or counted) or values.ndim != 1:
        return False
    if not len(values) or not np.all(np.isfinite(values)) or np.any(values != np.round(values)):
        return False
    return len(np.unique(values)) == 1 + np.count_nonzero(np.diff(values))


def _rows(table: Table, rows: Any) -> Table:
    at = table.rows[rows] if table.rows is not None else rows + table.first_row
    return replace(
        table,
        columns={name: values[rows] for name, values in table.columns.items()},
        text={name: [cells[i] for i in rows] for name, cells in table.text.items()},
        rows=np.asarray(at, dtype=np.int64),
    )


def _names(info: Path, table: Table) -> dict[str, tuple[str, ...]]:
    """Column to names, where the set's description has as many as the column is wide; {} where it cannot be read."""
    try:
        features = json.loads(info.read_text(encoding="utf-8"))["features"]
    except (OSError, ValueError, RecursionError, KeyError, TypeError):
        return {}
    if not isinstance(features, dict):
        return {}
    found = {column: _listed(features.get(column)) for column in table.columns}
    return {
        column: names
        for column, names in found.items()
        if len(names) == len(set(names)) == table.width(column) and table.columns[column].ndim == 2
    }


def _listed(feature: Any) -> tuple[str, ...]:
    """Names of one feature: a list, or lists by kind ({"motors": [...]})."""
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):
        names = [entry for part in names.values() for entry in (part if isinstance(part, list) else [])]
    return tuple(names) if isinstance(names, list) and all(isinstance(n, str) for n in names) else ()
