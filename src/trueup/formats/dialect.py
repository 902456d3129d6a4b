# SPDX-License-Identifier: Apache-2.0
"""How a text file is laid out: separator, decimal sign, comments, title lines, names of the columns, units."""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass

from trueup.errors import FormatError
from trueup.formats.table import listing, shown, unique_names
from trueup.units import canonical

COMMENT = re.compile(r"\s*(#|%|//)")
"""How a line that holds no data begins."""

_SEPARATORS = (",", ";", "\t", "|", " ")
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_EMPTY = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "--"})


@dataclass(frozen=True)
class Dialect:
    """The layout of one text file."""

    separator: str
    """A space stands for any run of blanks."""
    decimal: str
    names: tuple[str, ...]
    units: dict[str, str]
    first: int
    """Index of the first line of data."""
    preamble: tuple[str, ...]
    """Title lines and comments above the names."""


def sniff(lines: Sequence[str], path: str) -> Dialect:
    """The layout, told from a file's first lines. Raises FormatError where no line holds a number."""
    data = [line for line in lines if line.strip() and not COMMENT.match(line)]
    if len(data) == 1 and (names := _only_names(data[0])):
        raise FormatError(f"{path}: no rows; its only line names columns: {listing(names)}")
    sample = data[-60:]
    separator = max(_SEPARATORS, key=lambda s: _fit(sample, s))
    decimal = "," if separator != "," and _uses_decimal_comma(sample, separator) else "."
    rows = [split(line, separator) for line in sample]
    width = _usual([len(row) for row in rows])
    numeric = _numeric_columns([row for row in rows if len(row) == width], width, decimal)
    if not any(numeric):
        first = shown(data[0]) if data else "nothing"
        raise FormatError(f"{path}: no column of numbers found; the first line is {first}")
    first = next(
        (i for i, line in enumerate(lines) if _is_data(line, separator, width, numeric, decimal)),
        None,
    )
    if first is None:
        raise FormatError(f"{path}: no line of {width} numbers found")
    open_end = all(row[-1] == "" for row in rows[-10:] if len(row) == width)
    names, units, preamble = _head(lines[:first], separator, width, open_end, path)
    return Dialect(separator, decimal, names, units, first, preamble)


def split(line: str, separator: str) -> list[str]:
    """The cells of one line; quoted cells may hold the separator."""
    text = " ".join(line.split()) if separator == " " else line
    try:
        cells = next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        cells = text.split(separator)
    return [cell.strip() for cell in cells]


def is_number(cell: str, decimal: str = ".") -> bool:
    """Whether a cell reads as a number or a list of numbers (an empty one does not)."""
    if cell and (cell[0] in "[(" or cell.startswith(("array(", "tensor("))):
        return True
    try:
        float(cell.replace(",", ".") if decimal == "," else cell)
    except ValueError:
        return bool(re.fullmatch(r"0[xX][0-9a-fA-F]+|[\d-]{8,10}[T ][\d:.,Z+-]+|\d+:\d+:\d+([.,]\d+)?", cell))
    return True


def is_empty(cell: str) -> bool:
    """Whether a cell says that there is no value."""
    return cell.lower() in _EMPTY


def _only_names(line: str) -> list[str]:
    """The cells of a line of which none is a number; [] where one is, or there is but one."""
    cells = max((split(line, s) for s in _SEPARATORS if s != " "), key=len)
    plain = [cell for cell in cells if cell and not is_number(cell.strip("[]() "), "." if "," in line else ",")]
    return cells if len(cells) > 1 and len(plain) == len(cells) else []


def _fit(lines: Sequence[str], separator: str) -> tuple[float, int]:
    """How well a separator explains the lines: share of regular lines times share of numeric cells."""
    rows = [split(line, separator) for line in lines]
    width = _usual([len(row) for row in rows])
    if width < 2:
        return (0.0, 0)
    regular = [row for row in rows if len(row) == width]
    decimal = "." if separator == "," else ","
    cells = [cell for row in regular for cell in row]
    good = sum(is_number(cell, decimal) or is_empty(cell) for cell in cells)
    return (len(regular) / len(rows) * good / len(cells), width)


def _usual(counts: Sequence[int]) -> int:
    return max(set(counts), key=lambda n: (counts.count(n), n)) if counts else 0


def _uses_decimal_comma(lines: Sequence[str], separator: str) -> bool:
    cells = [cell for line in lines for cell in split(line, separator)]
    commas = sum(bool(_DECIMAL_COMMA.fullmatch(cell)) for cell in cells)
    points = sum("." in cell and is_number(cell) for cell in cells)
    return commas > points


def _numeric_columns(rows: Sequence[Sequence[str]], width: int, decimal: str) -> list[bool]:
    """For each column, whether most of its filled cells are numbers."""
    result = []
    for i in range(width):
        filled = [row[i] for row in rows if not is_empty(row[i])]
        # The names may be among the rows of a short file: one word is allowed besides the numbers.
        good = sum(is_number(cell, decimal) for cell in filled)
        result.append(good > 0 and good >= len(filled) - good)
    return result


def _is_data(line: str, separator: str, width: int, numeric: Sequence[bool], decimal: str) -> bool:
    """Whether a line holds values rather than names: most of its cells in columns of numbers are numbers."""
    if not line.strip() or COMMENT.match(line):
        return False
    cells = split(line, separator)
    if len(cells) != width:
        return False
    judged = [cell for cell, is_numeric in zip(cells, numeric, strict=True) if is_numeric and not is_empty(cell)]
    good = [cell for cell in judged if is_number(cell, decimal)]
    words = len(judged) - len(good)
    if words and good and _counts_up(good):
        return False  # names such as t,1,2,3
    return len(good) > words or not judged


def _counts_up(cells: Sequence[str]) -> bool:
    if len(cells) < 2 or not all(cell.isdigit() for cell in cells):
        return False
    steps = {int(b) - int(a) for a, b in itertools.pairwise(cells)}
    return steps == {1} and int(cells[0]) in (0, 1)


def _head(
    lines: Sequence[str], separator: str, width: int, open_end: bool, path: str
) -> tuple[tuple[str, ...], dict[str, str], tuple[str, ...]]:
    """Names and units of the columns, and the lines above them."""
    above = [line for line in lines if line.strip()]
    units: list[str] = []
    if len(above) > 1 and (found := _units_line(above[-1], separator, width)):
        units, above = found, above[:-1]
    cells: list[str] = []
    for line in reversed(above):
        cells = _names_in(line, separator, width, open_end)
        if len(cells) == width:
            break
        if not COMMENT.match(line) and len(cells) > 1 and separator != " ":
            raise FormatError(
                f"{path}: the line above the data has {len(cells)} names, the lines of data {width} cells"
            )
    named = len(cells) == width
    names = unique_names(cells if named else [""] * width)
    pairs = {name: unit for name, unit in zip(names, units, strict=False) if unit}
    return tuple(names), pairs, tuple(above[:-1] if named else above)


def _names_in(line: str, separator: str, width: int, open_end: bool) -> list[str]:
    """The cells of a line that may hold the names, with or without a comment sign."""
    bare = COMMENT.sub("", line, count=1).strip() if COMMENT.match(line) else line
    cells = _fitted(split(bare, separator), width, open_end)
    if len(cells) != width and COMMENT.match(line):
        return _fitted(split(bare, ","), width, open_end)  # numpy.savetxt(header="t, q1, q2")
    return cells


def _fitted(cells: list[str], width: int, open_end: bool) -> list[str]:
    """Names brought to `width`: a separator at the end of lines, or a column of row numbers without a name."""
    if len(cells) == width + 1 and not cells[-1]:
        return cells[:-1]
    if len(cells) == width - 1 and width > 2:
        return [*cells, ""] if open_end else ["", *cells]
    return cells


def _units_line(line: str, separator: str, width: int) -> list[str] | None:
    bare = COMMENT.sub("", line, count=1).strip() if COMMENT.match(line) else line
    cells = [cell.strip("[]() ") for cell in split(bare, separator)]
    known = [canonical(cell) for cell in cells]
    if len(cells) != width or None in known or not any(known):
        return None
    return [unit or "" for unit in known]
