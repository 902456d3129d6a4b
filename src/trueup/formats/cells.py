# SPDX-License-Identifier: Apache-2.0
"""Cells that hold more than a plain number: lists of numbers, lists of names. Parsed strictly, never evaluated."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.errors import FormatError
from trueup.formats.dialect import is_empty
from trueup.formats.table import shown

Place = Callable[[int], str]

_NAME = re.compile(r"'([^']+)'|\"+([^\"]+)\"+")
_NAMED = re.compile(r"(?:array|tensor|list|tuple)\((?:'d', ?)?(.*)\)$", re.DOTALL)


def parse_lists(cells: Sequence[str], place: Place) -> Array:
    """(T, k) from cells such as "[0.1, 0.2]", "(0.1 0.2)" or "array([0.1, 0.2])"; an empty cell is a row of NaN.

    Raises FormatError, naming the place, for a cell that is no list of numbers or has another length than most.
    """
    try:
        rows = json.loads("[" + ",".join(cells) + "]")
        values = np.array(rows, dtype=np.float64)
        if values.ndim >= 2 and len(values) == len(cells):
            return values.reshape(len(values), -1)
    except (ValueError, TypeError, OverflowError, RecursionError):
        pass  # something is unusual: read cell by cell, which finds out what and where
    return _one_by_one(cells, place)


def names_in(cell: str) -> tuple[str, ...]:
    """The names in a cell such as "['hip', 'knee']", as ROS messages list their joints; () in any other."""
    text = cell.strip()
    names = _NAME.findall(text)
    if len(text) < 2 or text[0] + text[-1] not in ("[]", "()") or _NAME.sub("", text[1:-1]).strip(" ,;\n"):
        return ()
    return tuple(one or other for one, other in names)


def numbered(cells: Sequence[str]) -> Array:
    """(T,) the same number for the same text, NaN for none."""
    seen: dict[str, int] = {}
    return np.array([seen.setdefault(c.strip(), len(seen)) if c.strip() else np.nan for c in cells], dtype=np.float64)


def _one_by_one(cells: Sequence[str], place: Place) -> Array:
    rows = [_row(cell) for cell in cells]
    lengths = [len(row) for row in rows if row]
    width = max(set(lengths), key=lengths.count) if lengths else 0
    for i, (cell, row) in enumerate(zip(cells, rows, strict=True)):
        if row is None:
            raise FormatError(f"{place(i)}: {shown(cell)} is not a list of numbers")
        if row and len(row) != width:
            raise FormatError(f"{place(i)}: the list has {len(row)} numbers, the others {width}: {shown(cell)}")
    return np.array([row or [np.nan] * width for row in rows], dtype=np.float64).reshape(len(cells), width)


def _row(cell: str) -> list[float] | None:
    """The numbers of one cell, [] where it is empty, None where it is no list of numbers."""
    text = cell.strip()
    if is_empty(text):
        return []
    named = _NAMED.match(text)
    text = named[1].strip() if named else text
    if len(text) < 2 or text[0] + text[-1] not in ("[]", "()"):
        return None
    parts = re.split(r"\s*[,;]\s*|\s+", text[1:-1].strip().rstrip(",").strip())
    try:
        return [float("nan") if is_empty(part) and part else float(part) for part in parts]
    except ValueError:
        return None
