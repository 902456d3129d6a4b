# SPDX-License-Identifier: Apache-2.0
"""What every reader delivers: named columns of numbers, and where each row came from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeGuard

import numpy as np

from trueup.arrays import Array, Integers
from trueup.errors import FormatError

JOINTS = 64
"""Of a robot, at most: what counts further, or is longer, is of something else."""


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of one file, or of one topic of a bag. All columns have the same number of rows."""

    name: str
    """How a mapping names it: the file's name, or the topic."""
    path: str
    """For messages and provenance."""
    columns: Mapping[str, Array]
    """Name -> (T,), or (T, k) where each cell is a list; NaN is a missing cell."""
    text: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Columns that hold words."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units that the file itself declares."""
    labels: tuple[str, ...] = ()
    """Names for the entries of list-valued columns, where something beside the table tells them."""
    named: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """The same for single columns, where a data set describes each."""
    row_word: str = "row"
    """What a row is called: line, row, entry, message."""
    first_row: int = 1
    """Number of the first row in that counting."""
    rows: Integers | None = None
    """(T,) number of each row, where they do not follow one another (comments and blank lines between them)."""
    metadata: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def length(self) -> int:
        """Number of rows."""
        return max((len(values) for values in self.columns.values()), default=0)

    def place(self, row: int) -> str:
        """Where row number `row` (from 0) is in the file, for messages: "line 12"."""
        number = int(self.rows[row]) if self.rows is not None and row < len(self.rows) else self.first_row + row
        return f"{self.row_word} {number}"

    def width(self, column: str) -> int:
        """How many numbers a cell of `column` holds."""
        values = self.columns[column]
        return 1 if values.ndim == 1 else values.shape[1]


def listing(names: Iterable[str], limit: int = 40) -> str:
    """Names for a message: "a, b, c"; at most `limit` of them."""
    every = list(names)
    more = f", ... ({len(every)} in all)" if len(every) > limit else ""
    return (", ".join(every[:limit]) + more) or "none"


def unique_names(names: Sequence[str]) -> list[str]:
    """Names made unique: an empty one becomes column_3 (counted from 1), a second 't' becomes 't.2'."""
    used: set[str] = set()
    result: list[str] = []
    for i, name in enumerate(names):
        base = name.strip() or f"column_{i + 1}"
        unique, count = base, 1
        while unique in used:
            count += 1
            unique = f"{base}.{count}"
        used.add(unique)
        result.append(unique)
    return result


def numbers(cells: Sequence[object], where: str, row_word: str, first: int = 1) -> Array | list[str]:
    """(T,) or (T, k) floats from cells that hold numbers, lists of numbers, or nothing (None -> NaN).

    Returns the cells as text where most of them are words or lists of words. Raises FormatError for a word among numbers,
    and for lists of different lengths; the message names the cell.
    """
    cells = [" ".join(cell) if _are_words(cell) else cell for cell in cells]
    words = [i for i, cell in enumerate(cells) if isinstance(cell, str)]
    filled = sum(cell is not None for cell in cells)
    if words and len(words) * 2 > filled:
        return ["" if cell is None else str(cell) for cell in cells]
    if words:
        raise FormatError(f"{where}, {row_word} {first + words[0]}: {shown(cells[words[0]])} is not a number")
    lists = [len(cell) for cell in cells if isinstance(cell, (list, tuple))]
    width = max(set(lists), key=lists.count) if lists else 0
    rows: list[object] = []
    for i, cell in enumerate(cells):
        entry = _row(cell, width)
        if entry is None:
            kind = f"a list of {width} numbers like the others" if width else "a number"
            raise FormatError(f"{where}, {row_word} {first + i}: {shown(cell)} is not {kind}")
        rows.append(entry)
    try:
        return np.array(rows, dtype=np.float64).reshape((len(rows), width) if lists else (len(rows),))
    except (TypeError, ValueError, OverflowError) as error:
        raise FormatError(f"{where}: cannot be read as numbers ({error})") from None


def shown(cell: object, limit: int = 60) -> str:
    """A cell's content for a message, shortened."""
    text = repr(cell)
    return text if len(text) <= limit else text[:limit] + "..."


def _row(cell: object, width: int) -> float | list[float] | None:
    """The cell as one float or `width` floats; None where it cannot be."""
    if width == 0:
        return _number(cell)
    if cell is None:
        return [np.nan] * width
    if not isinstance(cell, (list, tuple)) or len(cell) != width:
        return None
    entries = [_number(entry) for entry in cell]
    return None if any(entry is None for entry in entries) else [entry for entry in entries if entry is not None]


def _are_words(cell: object) -> TypeGuard[Sequence[str]]:
    return isinstance(cell, (list, tuple)) and bool(cell) and all(isinstance(entry, str) for entry in cell)


def _number(cell: object) -> float | None:
    if cell is None:
        return float("nan")
    if not isinstance(cell, (int, float)):
        return None
    try:
        return float(cell)
    except OverflowError:  # an integer of hundreds of digits
        return None
