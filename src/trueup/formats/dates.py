# SPDX-License-Identifier: Apache-2.0
"""Cells that hold times of day, with or without a date, as people and their programs write them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date

import numpy as np

from trueup.arrays import Array
from trueup.units import size_of

_CLOCK = re.compile(
    r"(?:(?P<date>\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/.]\d{1,2}[-/.]\d{4})(?:T|,? +))?"
    r"(?P<hours>\d{1,2}):(?P<minutes>\d\d):(?P<seconds>\d\d(?:[.,]\d+)?)"
    r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?(?:Z|[+-]\d\d:?\d\d)?"
)
_ORDERS = {"day": "dmy", "month": "mdy"}
"""What comes first where the year comes last -> the order of day, month and year."""


@dataclass(frozen=True)
class Instants:
    """Times read from words."""

    time: Array
    """(T,) in s: since 1970 where all cells have a date, as if their zone were UTC; else since midnight, and on into the
    next day."""
    note: str = ""
    """What was assumed about their dates; '' where these leave nothing open."""


def parse_clock(cells: Sequence[str]) -> Instants | None:
    """The times in cells such as "12:30:05.250" or "31.03.2024 00:59:50"; None where a cell is none.

    Day and month of a date that ends with the year are told apart by what is a date, and dots set days first; where both
    orders are possible the one counts in which the cells are less far apart.
    """
    matches = [_CLOCK.fullmatch(cell.strip()) for cell in cells]
    found = [m for m in matches if m is not None]
    if len(found) < len(cells):
        return None
    of_day = np.array([_of_day(m) for m in found], dtype=np.float64)
    day = 24 * size_of("h")
    dates = [m["date"] for m in found]
    if not all(dates):
        return Instants(of_day + day * np.cumsum(np.diff(of_day, prepend=of_day[:1]) < -day / 2))
    numbered = _days(dict.fromkeys(dates))
    if numbered is None:
        return None
    days, note = numbered
    return Instants(of_day + day * np.array([days[d] for d in dates], dtype=np.float64), note)


def _of_day(match: re.Match[str]) -> float:
    """Seconds since midnight."""
    hours = int(match["hours"])
    if match["half"]:
        hours = hours % 12 + (12 if match["half"] in "Pp" else 0)
    return hours * size_of("h") + int(match["minutes"]) * size_of("min") + float(match["seconds"].replace(",", "."))


def _days(dates: Iterable[str]) -> tuple[dict[str, int], str] | None:
    """Days since 1970 of each date, and what was assumed; None where one is no date."""
    split = {d: [int(part) for part in re.split(r"[-/.]", d)] for d in dates}
    readings = {}
    for first, order in _ORDERS.items():
        read = {
            d: _since_1970(parts if parts[0] > 31 else [parts[order.index(c)] for c in "ymd"])
            for d, parts in split.items()
        }
        days = {d: number for d, number in read.items() if number is not None}
        if len(days) == len(split):
            readings[first] = days
    if not readings:
        return None
    plain = next(iter(split))
    known = len(readings) == 1 or readings["day"] == readings["month"] or "." in plain
    best = min(readings, key=lambda first: 0 if known else np.ptp(list(readings[first].values())))
    order = " and ".join((best, *(x for x in _ORDERS if x != best)))
    note = "" if known else f"dates such as {plain} were read as {order}: that matters only beside files of other dates"
    return readings[best], note


def _since_1970(parts: Sequence[int]) -> int | None:
    """Days from the first of 1970 to year, month, day; None where that is no date."""
    try:
        return date(*parts).toordinal() - date(1970, 1, 1).toordinal()
    except ValueError:
        return None
