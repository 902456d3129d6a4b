# SPDX-License-Identifier: Apache-2.0
"""Tables with one row for each joint and instant (columns time, servo_id, position), made one row for each instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array, Integers
from trueup.formats.cells import numbered
from trueup.formats.rules.joints import read as reading_of
from trueup.formats.rules.names import is_time, taken_apart, words
from trueup.formats.table import JOINTS, Table
from trueup.samples import MOSTLY

_COUNTED = frozenset(["id", "name", "number", "nr", "no"])
_WHOSE = frozenset(["servo", "motor", "joint", "dxl", "axis", "actuator", "drive", "marker"]) | _COUNTED
"""Words of a column that says which joint a row is of."""


def one_row_an_instant(table: Table) -> Table:
    """The table with columns for each joint in place of rows; as it is where rows are not of one joint each.

    Joints that were read one after the other are brought to the first one's times: what was measured is interpolated,
    what was commanded holds.
    """
    found = _whose(table)
    if found is None:
        return table
    whose, clock, rows = found
    times = {label: table.columns[clock][at] for label, at in rows.items()}
    every = np.unique(np.concatenate(list(times.values())))
    one_clock = sum(map(len, times.values())) > MOSTLY * len(every) * len(times)
    first = max(rows, key=lambda label: len(rows[label]))
    instants = every if one_clock else times[first]
    columns: dict[str, Array] = {clock: instants}
    units = {clock: table.units[clock]} if clock in table.units else {}
    for name in (n for n in table.columns if n not in (clock, whose)):
        for label, at in rows.items():
            column = f"{label}.{name}"
            columns[column] = _at(instants, times[label], table.columns[name][at], name, exact=one_clock)
            units |= {column: table.units[name]} if name in table.units else {}
    apart = "" if one_clock else (
        f"; they were read one after the other, so what was measured is interpolated to the times of {first}"
    )  # fmt: skip
    warning = (f"{table.name}: its rows are of one joint each, by column '{whose}' ({len(rows)} joints): read as columns, "
               f"one row an instant{apart}")  # fmt: skip
    places = table.rows if table.rows is not None else table.first_row + np.arange(table.length, dtype=np.int64)
    nearest = np.clip(np.searchsorted(times[first], instants), 0, len(rows[first]) - 1)
    return replace(table, columns=columns, text={}, units=units, rows=places[rows[first][nearest]],
                   warnings=(*table.warnings, warning))  # fmt: skip


def _whose(table: Table) -> tuple[str, str, Mapping[str, Integers]] | None:
    """The column that says which joint a row is of, the clock, and the rows of each joint by its label; None without any."""
    told: dict[str, Array | Sequence[str]] = {**table.text, **table.columns}
    for name, cells in told.items():
        plain = words(name)
        if not plain or not set(plain) <= _WHOSE or (isinstance(cells, np.ndarray) and cells.ndim > 1):
            continue
        rows = _rows(name, cells)
        for clock in (c for c, values in table.columns.items() if rows and is_time(c) and values.ndim == 1):
            if _are_of_one_each(table.columns[clock], rows):
                return name, clock, rows
    return None


def _rows(name: str, cells: Array | Sequence[str]) -> dict[str, Integers]:
    """The rows of each joint, by a label for it; {} where these are no joints."""
    kind = next((word for word in words(name) if word not in _COUNTED), "id")
    if not isinstance(cells, np.ndarray):
        keys = numbered(cells)
        labels = {float(keys[i]): cell.strip() for i, cell in enumerate(cells)}
    else:
        keys = cells
        labels = {v: f"{kind}_{v:g}" for v in np.unique(keys[np.isfinite(keys)]).tolist()}
    if not np.all(np.isfinite(keys)) or np.any(keys != np.round(keys)) or not 1 < len(labels) <= JOINTS:
        return {}
    order = list(dict.fromkeys(keys.tolist()))
    return {labels[key]: np.flatnonzero(keys == key) for key in order}


def _are_of_one_each(clock: Array, rows: Mapping[str, Integers]) -> bool:
    """Whether time goes on for each joint, while rows take joints in turn, or all at an instant, or begin anew for each.

    One motor that is moved after the other, or a motor's own whole numbers, are columns of another meaning.
    """
    if not np.all(np.isfinite(clock)) or min(map(len, rows.values())) < 2:
        return False
    if any(np.any(np.diff(clock[at]) <= 0.0) for at in rows.values()):
        return False
    in_turn = np.mean(np.concatenate([np.diff(at) for at in rows.values()]) == len(rows)) > MOSTLY
    at_once = len(np.unique(clock)) * len(rows) * MOSTLY < len(clock)
    return bool(in_turn or at_once or np.any(np.diff(clock) < 0.0))


def _at(instants: Array, times: Array, values: Array, name: str, *, exact: bool) -> Array:
    """(T,) or (T, k) samples at other instants; NaN where there is none."""
    found = np.full((len(instants), *values.shape[1:]), np.nan)
    if exact:
        found[np.searchsorted(instants, times)] = values
        return found
    reading = reading_of(taken_apart(name))
    if reading.command or not reading.kind or values.ndim > 1:
        last = np.searchsorted(times, instants, side="right") - 1
        return values[np.clip(last, 0, None)]
    return np.interp(instants, times, values)
