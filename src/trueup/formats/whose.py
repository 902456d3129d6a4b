# SPDX-License-Identifier: Apache-2.0
"""Tables with lists spread over columns (position0, position1) whose rows say of whom they are (name0, name1), as of ROS."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.formats.table import JOINTS, Table

_ENTRY = re.compile(r"(?P<list>.*?[^\d\W])[ _./]?[\[(]?(?P<at>\d+)[\])]?(?P<rest>\D*)")
"""An entry of a list as a column: position0, position_0, position[0], position.0, and what may stand behind it (_deg)."""
_NAMES = re.compile(r"(?P<message>.*?)(?:joint_?|motor_?|actuator_?)?names?", re.IGNORECASE)
"""A list of names, and what stands before it: the message that it is of."""


def told_by_rows(table: Table) -> Table:
    """The table with a column for each name that its rows hold (position/elbow) in place of one for each entry of a list.

    `rostopic echo -p` writes messages so (field.name0, field.position0). Rows may name others, in another order, as where
    several publish on one topic: what a row does not name is missing there.
    """
    for message, names in _names(table).items():
        table = _by_name(table, message, names)
    return table


def _names(table: Table) -> dict[str, dict[int, str]]:
    """Lists of names among a table's words, by their message: each the columns of its entries by their places."""
    lists: dict[str, dict[int, str]] = {}
    for column in table.text:
        entry = _ENTRY.fullmatch(column)
        if entry is not None and not entry["rest"] and (match := _NAMES.fullmatch(entry["list"])) is not None:
            lists.setdefault(match["message"], {})[int(entry["at"])] = column
    return lists


def _numbers(table: Table, message: str) -> dict[str, dict[int, str]]:
    """Lists of numbers of a message by their name, each the columns of its entries by their places."""
    lists: dict[str, dict[int, str]] = {}
    for column, values in table.columns.items():
        entry = _ENTRY.fullmatch(column)
        if entry is not None and values.ndim == 1 and column.startswith(message):
            lists.setdefault(entry["list"] + entry["rest"], {})[int(entry["at"])] = column
    return lists


def _by_name(table: Table, message: str, names: Mapping[int, str]) -> Table:
    """The table with columns by name in place of those lists of numbers that are as long as the list of `names`."""
    cells = np.array([[cell.strip() for cell in table.text[column]] for column in names.values()])  # (k, T)
    every = [str(name) for name in dict.fromkeys(cells.T.ravel()) if name]
    twice = any(np.any(np.count_nonzero(cells == name, axis=0) > 1) for name in every[:JOINTS])
    lists = {k: v for k, v in _numbers(table, message).items() if v.keys() == names.keys()}
    if twice or not every or len(every) > JOINTS or not lists:
        return table
    first = {entries[min(entries)]: head for head, entries in lists.items()}  # whose place the made columns take
    gone = {column for entries in lists.values() for column in entries.values()}
    columns: dict[str, Array] = {}
    units: dict[str, str] = {}
    for column, values in table.columns.items():
        made = {column: values} if column not in gone else {}
        if column in first:
            numbers = np.stack([table.columns[lists[first[column]][k]] for k in names])
            made = {f"{first[column]}/{name}": _of(name, cells, numbers) for name in every}
        columns |= made
        units |= dict.fromkeys(made, table.units[column]) if column in table.units else {}
    text = {name: each for name, each in table.text.items() if name not in names.values()}
    return replace(table, columns=columns, units=units, text=text)


def _of(name: str, cells: Array, numbers: Array) -> Array:
    """(T,) what each row has for a name; NaN where it does not name it. `cells` and `numbers` are (k, T)."""
    here = cells == name
    at = np.argmax(here, axis=0)
    return np.where(here.any(axis=0), np.take_along_axis(numbers, at[None], axis=0)[0], np.nan)
