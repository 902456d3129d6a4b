# SPDX-License-Identifier: Apache-2.0
"""Paths from CSV: columns x, y in m, and speed in m/s if it is known, named and in units as those of logs may be."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from pathlib import Path as FilePath

import numpy as np

from trueup import files
from trueup.errors import FormatError
from trueup.formats.rules import vehicles
from trueup.formats.rules.names import listed, words
from trueup.formats.rules.rule import Column
from trueup.formats.table import Table
from trueup.paths.path import SPACING, Path
from trueup.paths.speed import SpeedLimits

_SPEEDS = listed("speed velocity vel v")
_Row = tuple[int, list[str]]
"""The number of a line, and its cells."""


def read_path(
    file: str | os.PathLike[str], *, speed: float = 0.5, limits: SpeedLimits | None = None, spacing: float = SPACING,
    spline: bool = False,
) -> Path:  # fmt: skip
    """The path in a CSV file: a header that names x and y (east and north), as its first line or as the last comment, or two
    bare columns; `speed` m/s where the file has none.

    `spline`: the points are waypoints of a smooth curve, not corners. Raises FormatError with file and line.
    """
    where = FilePath(file)
    lines = files.text(where, FormatError).splitlines()
    delimiter = max(",;\t", key="\n".join(lines).count)
    cells = csv.reader(lines, delimiter=delimiter) if any(delimiter in n for n in lines) else map(str.split, lines)
    every = [(n, [cell.strip() for cell in row]) for n, row in enumerate(cells, 1) if any(map(str.strip, row))]
    rows = [(n, row) for n, row in every if not row[0].startswith("#")]
    if not rows:
        raise FormatError(f"path '{where}' is empty")
    said = [(n, [row[0].lstrip("# "), *row[1:]]) for n, row in every if row[0].startswith("#") and n < rows[0][0]]
    columns, rows = _columns(where, rows, said)
    table = np.array([[factor * _number(where, n, r, c) for c, factor in columns.values()] for n, r in rows])
    given = dict(zip(columns, table.T, strict=True))
    points = np.stack([given["x"], given["y"]], axis=1)
    if spline:
        return Path.from_spline(where.stem, points, speed=speed, limits=limits, spacing=spacing)
    return Path.from_points(where.stem, points, speed=given.get("speed", speed), limits=limits, spacing=spacing)


def _columns(
    where: FilePath, rows: list[_Row], comments: list[_Row]
) -> tuple[dict[str, tuple[int, float]], list[_Row]]:
    """Which column is x, y and the speed, with what one of its numbers is in SI; and the rows of numbers."""
    line, first = rows[0]
    if not _numeric(first):
        return _named(where, line, first), rows[1:]
    for at, names in reversed(comments):
        if len(names) == len(first) and {"x", "y"} <= set(_read(names)):
            return _named(where, at, names), rows
    if len(first) != 2:
        raise FormatError(
            f"path '{where}', line {line}: two columns (x, y) are needed, there is one" if len(first) == 1 else
            f"path '{where}', line {line}: {len(first)} columns without names; say in a first line which are x, y (m) and "
            "speed (m/s): x,y,speed"
        )  # fmt: skip
    return {"x": (0, 1.0), "y": (1, 1.0)}, rows


def _named(where: FilePath, line: int, names: Sequence[str]) -> dict[str, tuple[int, float]]:
    """Columns by what their names say. Raises FormatError where x or y is missing, or a speed cannot be told."""
    found, place = _read(names), f"path '{where}', line {line}"
    if {"latitude", "longitude"} <= set(found) and not {"x", "y"} & set(found):
        raise FormatError(
            f"{place}: latitude and longitude; a path is in m, in the frame in which the robot's place is logged: give x "
            "and y (or east and north) there"
        )
    for label in ("x", "y"):
        if label not in found:
            raise FormatError(f"{place}: no column '{label}'; columns are: {', '.join(names)}")
    unclear = [name for name in names if _SPEEDS & set(words(name))]
    if "speed" not in found and unclear:
        raise FormatError(
            f"{place}: is '{unclear[0]}' the speed to drive at? Call it speed (m/s), or leave it out; columns are: "
            f"{', '.join(names)}"
        )
    return {label: found[label] for label in ("x", "y", "speed") if label in found}


def _read(names: Sequence[str]) -> dict[str, tuple[int, float]]:
    """What names say of signals of a vehicle, the first of each kind, east and north as x and y where there are no others."""
    table = Table("path", "path", {str(i): np.zeros(1) for i in range(len(names))})
    found: dict[str, tuple[int, float]] = {}
    for i, name in enumerate(names):
        signal = vehicles.read(Column(table, str(i), name, "", "")) if name else None
        if signal is not None:
            found.setdefault(signal.kind, (i, signal.factor or 1.0))
    if not {"x", "y"} <= set(found) and {"east", "north"} <= set(found):
        found |= {"x": found["east"], "y": found["north"]}
    return found


def _numeric(row: Sequence[str]) -> bool:
    """Whether a row begins with numbers rather than with names."""
    try:
        [float(cell) for cell in row[:2]]
    except ValueError:
        return False
    return True


def _number(where: FilePath, line: int, row: list[str], column: int) -> float:
    try:
        value = float(row[column])
    except (ValueError, IndexError):
        shown = row[column] if column < len(row) else "nothing"
        raise FormatError(f"path '{where}', line {line}, column {column + 1}: '{shown}' is not a number") from None
    if not np.isfinite(value):
        raise FormatError(f"path '{where}', line {line}, column {column + 1}: {value} is not a finite number")
    return value
