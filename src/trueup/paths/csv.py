# SPDX-License-Identifier: Apache-2.0
"""Paths from and to CSV: columns x, y in m, and speed in m/s if it is known."""

from __future__ import annotations

import csv
import os
from pathlib import Path as FilePath

import numpy as np

from trueup import files
from trueup.errors import FormatError
from trueup.paths.path import SPACING, Path
from trueup.paths.speed import SpeedLimits

_SPELLINGS = {"x": ("x", "x_m", "pos_x", "px"), "y": ("y", "y_m", "pos_y", "py"),
              "speed": ("speed", "v", "speed_mps", "velocity", "v_mps")}  # fmt: skip


def read_path(
    file: str | os.PathLike[str], *, speed: float = 0.5, limits: SpeedLimits | None = None, spacing: float = SPACING,
    spline: bool = False,
) -> Path:  # fmt: skip
    """The path in a CSV file: a header that names x and y, or two bare columns; `speed` m/s where the file has none.

    `spline`: the points are waypoints of a smooth curve, not corners. Raises FormatError with file and line.
    """
    where = FilePath(file)
    text = files.text(where, FormatError)
    delimiter = max(",;\t", key=text.count)
    rows = [
        (n, r) for n, r in enumerate(csv.reader(text.splitlines(), delimiter=delimiter), 1) if any(map(str.strip, r))
    ]
    rows = [(n, r) for n, r in rows if not r[0].lstrip().startswith("#")]
    if not rows:
        raise FormatError(f"path '{where}' is empty")
    columns, rows = _columns(where, rows)
    table = np.array([[_number(where, n, r, c) for c in columns.values()] for n, r in rows])
    given = dict(zip(columns, table.T, strict=True))
    points = np.stack([given["x"], given["y"]], axis=1)
    if spline:
        return Path.from_spline(where.stem, points, speed=speed, limits=limits, spacing=spacing)
    return Path.from_points(where.stem, points, speed=given.get("speed", speed), limits=limits, spacing=spacing)


def _columns(where: FilePath, rows: list[tuple[int, list[str]]]) -> tuple[dict[str, int], list[tuple[int, list[str]]]]:
    first = [cell.strip().lower() for cell in rows[0][1]]
    try:
        [float(cell) for cell in first[:2]]
    except ValueError:
        found = {k: next((i for i, c in enumerate(first) if c in names), -1) for k, names in _SPELLINGS.items()}
        missing = [k for k in ("x", "y") if found[k] < 0]
        if missing:
            raise FormatError(
                f"path '{where}', line {rows[0][0]}: no column '{missing[0]}'; columns are: {', '.join(first)}"
            ) from None
        return {k: i for k, i in found.items() if i >= 0}, rows[1:]
    if len(first) < 2:
        raise FormatError(f"path '{where}', line {rows[0][0]}: two columns (x, y) are needed, there is one")
    return {"x": 0, "y": 1}, rows


def _number(where: FilePath, line: int, row: list[str], column: int) -> float:
    try:
        value = float(row[column])
    except (ValueError, IndexError):
        shown = row[column] if column < len(row) else "nothing"
        raise FormatError(f"path '{where}', line {line}, column {column + 1}: '{shown}' is not a number") from None
    if not np.isfinite(value):
        raise FormatError(f"path '{where}', line {line}, column {column + 1}: {value} is not a finite number")
    return value
