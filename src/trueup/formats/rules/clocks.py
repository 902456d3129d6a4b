# SPDX-License-Identifier: Apache-2.0
"""Finds the clocks among the columns: the main one, second ones, and which columns follow which."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.formats.clock import FASTEST, SLOWEST, guess_unit, on_and_on, round_of
from trueup.formats.mapping import TimeColumn
from trueup.formats.rules.names import is_time, listed, names_its_clock, says_nanoseconds, stem, ticks, words
from trueup.formats.table import Table, listing
from trueup.samples import COUNTS
from trueup.units import size_of, to_si

_RATES, _PERIODS = listed("fps hz rate frequency freq fs"), listed("dt ts period timestep step")
"""Words of how often samples were taken, and of how far they are apart, among facts beside the signals."""
_NOT = listed(
    "cutoff cut off filter simulation sim physics camera cameras image baud bit data steps pwm learning natural"
)
"""Words of other rates."""


@dataclass(frozen=True)
class Clocks:
    """What was found about time in the tables of one recording."""

    main: TimeColumn
    columns: Mapping[str, tuple[str, ...]]
    """Table name -> its columns that are clocks."""
    mains: Mapping[str, str]
    """Table name -> its own main clock ('' if it has none)."""
    widths: Mapping[str, int]
    """Table name -> numbers per sample, where a file has one number a line."""
    notes: tuple[str, ...] = ()

    def clock_of(self, table: Table, column: str) -> str:
        """The second clock that a column follows; '' for the main one."""
        main = self.mains[table.name]
        clocks = self.columns[table.name]
        parts = any(says_nanoseconds(name) for name in clocks)  # seconds and their rest are no clocks by themselves
        others = [
            name for name in clocks
            if name not in (main, self.main.nanoseconds)
            and not (says_nanoseconds(name) or (parts and _whole_seconds(table.columns[name])))
        ]  # fmt: skip
        for other in others:
            if names_its_clock(column, other, main) or _is_held_with(table.columns[column], table.columns[other]):
                return other
        return ""

    def keys_of(self, table: Table, clock: str) -> dict[str, Any]:
        """The keys of a mapping's channel that say which clock it follows."""
        main = self.mains[table.name]
        own = clock or (main if main != self.main.column else "")
        if not own or self.main.file:
            return {}
        unit = guess_unit(own, table.columns[own])
        if not clock:
            return {"time": own, "time_unit": unit}
        return {"time": own, "time_unit": unit, "time_offset": _offset(table, main, own, self.main.unit)}


def find_clocks(tables: Sequence[Table]) -> Clocks:
    """The clocks of these tables, which together are one recording."""
    found = {table.name: _clock_columns(table) for table in tables}
    mains = {table.name: _main(table, found[table.name]) for table in tables}
    single = _time_file(tables)
    if single is not None:
        return _with_time_file(single, tables, found)
    timed = [table for table in tables if mains[table.name]]
    if not timed:
        rates = _rates_said(tables)
        if len(set(rates.values())) == 1:
            said, rate = f"{' and '.join(rates)} of the file", next(iter(rates.values()))
            note = f"no column of time found: {rate:.6g} samples per second, as {said} has it"
            return Clocks(TimeColumn(rate=rate), found, mains, {}, (note,))
        there = "; ".join(f"{table.name}: {listing(table.columns)}" for table in tables)
        note = f"no column of time found ({there}): give rate = samples per second in [time]"
        return Clocks(TimeColumn(), found, mains, {}, (note,))
    names = [mains[table.name] for table in timed]
    table = timed[names.index(max(set(names), key=names.count))]
    column = mains[table.name]
    seconds = _whole_seconds(table.columns[column]) and guess_unit(column, table.columns[column]) == "s"
    fraction = _fraction(table, found[table.name]) if seconds else ""
    declared = "s" if fraction else table.units.get(column, "")
    unit = declared or guess_unit(column, table.columns[column])
    notes = [] if declared else [_unit_note(column, unit, table.columns[column])]
    untimed = [t.name for t in tables if not mains[t.name] and t.columns]
    notes += [f"no column of time in {listing(untimed)}: give a rate there"] if untimed else []
    return Clocks(TimeColumn(column=column, nanoseconds=fraction, unit=unit), found, mains, {}, tuple(notes))


def _rates_said(tables: Sequence[Table]) -> dict[str, float]:
    """Samples per second that files say beside their signals (fps = 50, dt = 0.02), by the name that says so."""
    found: dict[str, float] = {}
    for name, text in (fact for table in tables for said in table.metadata.items() for fact in _facts(*said)):
        plain = set(words(name.rpartition(".")[2]))
        unit = next((u for u in ("ms", "us", "ns") if u in plain), "s")
        try:
            value = float(text) * (1.0 if plain & _RATES else size_of(unit))
        except ValueError:
            continue
        rate = (
            value if plain & _RATES else 1.0 / value if value > 0.0 and plain & _PERIODS and not plain & _NOT else 0.0
        )
        if SLOWEST <= rate <= FASTEST and not plain & _NOT:
            found[name] = float(f"{rate:.9g}")
    return found


def _facts(name: str, text: str) -> Iterator[tuple[str, str]]:
    """A fact of a file; of one that is JSON, as data sets of demonstrations describe themselves, those in it."""
    try:
        content = json.loads(text) if text.lstrip().startswith("{") else None
    except ValueError:
        content = None
    if not isinstance(content, dict):
        yield name, text
        return
    for key, value in content.items():
        yield from _facts(f"{name}.{key}", json.dumps(value) if isinstance(value, dict) else str(value))


def _clock_columns(table: Table) -> tuple[str, ...]:
    """Columns that sound like a clock and hardly ever run back, or all do so; else one that ticks, or the first, if it runs
    like one.
    """
    named = [name for name, values in table.columns.items() if is_time(name) and _runs(values)]
    # The newest row first, as some loggers export: an error that says so is better than none that knows of a clock.
    named = named or [name for name, values in table.columns.items() if is_time(name) and _runs(-values)][:1]
    # Nanoseconds beside seconds start again every second, so they do not run.
    named += [name for name in table.columns if named and name not in named and says_nanoseconds(name)]
    if named:
        return tuple(named)
    ticking = [name for name, values in table.columns.items() if ticks(name) and _runs_evenly(values)]
    if ticking:
        return tuple(ticking[:1])
    first = next(iter(table.columns), "")
    nameless = all(name.startswith("column_") for name in table.columns)
    if nameless and len(table.columns) > 1 and _runs_evenly(table.columns[first]):
        return (first,)
    return ()


def _main(table: Table, clocks: Sequence[str]) -> str:
    """The clock with the most instants; the first of those that are nearly equal, of cameras the last."""
    fraction = _fraction(table, clocks)
    candidates = sorted((name for name in clocks if name != fraction), key=lambda name: bool(_NOT & set(words(name))))
    instants = {name: len(np.unique(table.columns[name])) for name in candidates}
    return next((name for name in candidates if instants[name] >= 0.9 * max(instants.values())), "")


def _time_file(tables: Sequence[Table]) -> Table | None:
    """A file that holds nothing but the time of the others."""
    alone = [t for t in tables if len(t.columns) == 1 and is_time(stem(t.name))]
    if len(alone) != 1 or len(tables) < 2 or not _runs(next(iter(alone[0].columns.values()))):
        return None
    return alone[0]


def _with_time_file(clock: Table, tables: Sequence[Table], found: Mapping[str, tuple[str, ...]]) -> Clocks:
    column = next(iter(clock.columns))
    others = [table for table in tables if table is not clock]
    widths = {
        table.name: table.length // clock.length
        for table in others
        if len(table.columns) == 1 and table.length > clock.length and table.length % clock.length == 0
    }
    main = TimeColumn(column=column, unit=guess_unit(stem(clock.name), clock.columns[column]), file=clock.name)
    notes = tuple(f"{name}: one number a line, {width} a sample" for name, width in widths.items())
    return Clocks(main, {**found, clock.name: (column,)}, {t.name: "" for t in tables}, widths, notes)


def _runs(values: Array) -> bool:
    """Whether a column goes forward nearly always, as the time of a (perhaps damaged) log does."""
    if values.ndim != 1:
        return False
    finite = values[np.isfinite(values)]
    if len(finite) < 2:
        return len(finite) == 1
    steps = np.diff(finite)
    return bool(np.any(steps > 0.0)) and float(np.mean(steps >= 0.0)) > 0.5


def _runs_evenly(values: Array) -> bool:
    if values.ndim != 1 or len(values) < 3:
        return False
    steps = np.diff(on_and_on(values, round_of(values, COUNTS)))
    if not np.all(steps > 0.0):
        return False
    # A column of row numbers is no clock.
    counts = bool(np.all(steps == 1.0)) and values[0] in (0.0, 1.0)
    return not counts and float(steps.max()) < 50.0 * float(np.median(steps))


def _fraction(table: Table, clocks: Sequence[str]) -> str:
    """The nanoseconds of a clock that is written as seconds and nanoseconds; '' if there is none."""
    for name in clocks:
        values = table.columns[name]
        if (
            says_nanoseconds(name)
            and values.ndim == 1
            and len(clocks) > 1
            and float(np.nanmax(values)) * size_of("ns") < 1.0
            and float(np.nanmin(values)) >= 0.0
        ):
            return name
    return ""


def _whole_seconds(values: Array) -> bool:
    """Whether a clock may be the seconds of which nanoseconds are the rest; a bag's own time beside a message's has both."""
    known = values[np.isfinite(values)]
    return bool(np.all(known == np.round(known)))


def _unit_note(column: str, unit: str, values: Array) -> str:
    steps = np.diff(values[np.isfinite(values)]) * size_of(unit)
    forward = steps[steps > 0.0]
    rate = f", which gives {1.0 / float(np.median(forward)):.4g} Hz" if forward.size else ""
    return f"time: column '{column}' taken as {unit}{rate}"


def _is_held_with(values: Array, clock: Array) -> bool:
    """Whether a column changes only when a slow clock does, and does change."""
    if len(clock) < 2:
        return False
    still = np.diff(clock) == 0.0
    changes = np.diff(values, axis=0) != 0.0
    changes = changes if changes.ndim == 1 else np.any(changes, axis=1)
    return bool(np.mean(still) > 0.2) and not np.any(changes[still])


def _offset(table: Table, main: str, own: str, main_unit: str) -> float | str:
    """0 where both clocks show the same time, "rows" where they count from different instants."""
    first = table.columns[main] * size_of(main_unit)
    second = table.columns[own] * to_si(guess_unit(own, table.columns[own]))[1]
    apart = float(np.nanmedian(np.abs(first - second)))
    return 0.0 if apart < 0.5 else "rows"
