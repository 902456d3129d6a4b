# SPDX-License-Identifier: Apache-2.0
"""Columns of time made into seconds that strictly increase, or a named error that says where they do not."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Mask
from trueup.errors import ClockError, FormatError
from trueup.formats.mapping import Repair
from trueup.formats.table import Table
from trueup.instant import usual_step
from trueup.rounding import DATE
from trueup.samples import COUNTS
from trueup.units import canonical, numbers_of, size_of

# Rates between these [Hz] are believed when the unit of a clock is guessed.
SLOWEST, FASTEST = 2.0, 20_000.0
_ROUNDS = tuple(counts * size_of(unit) for counts in COUNTS for unit in ("ms", "us", "ns"))
_DATED = DATE, DATE * numbers_of("ms")
"""s since 1970 of what is a date, in one unit alone: each is a thousand times the next."""


@dataclass(frozen=True)
class Samples:
    """Values with the time and the row of each."""

    time: Array
    """(T,) in s."""
    values: Array
    """(T, k)."""
    warnings: tuple[str, ...] = ()


def guess_unit(name: str, values: Array) -> str:
    """The unit of a clock: from the column's name, else the one for which dates or rates are plausible."""
    declared = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]\s*$", name)
    candidates = [declared[1]] if declared else []
    candidates += re.split(r"[^A-Za-zµ]+", name)[-1:]
    for candidate in candidates:
        unit = canonical(candidate)
        # Bare 's' and 'min' at the end of a name are too short to be sure ("times_s" is, "t_min" is a minimum).
        if unit in ("s", "ms", "us", "ns") or (unit == "min" and declared):
            return unit
    finite = values[np.isfinite(values)]
    steps = np.diff(finite)
    steps = steps[steps > 0.0]
    if not steps.size:
        return "s"
    sizes = {unit: size_of(unit) for unit in ("s", "ms", "us", "ns")}
    step = float(np.median(steps))
    rated = [unit for unit, size in sizes.items() if SLOWEST <= 1.0 / (step * size) <= FASTEST]
    # Microseconds from half an hour ago look like a date in seconds, at which nothing would be sampled.
    for unit in rated or sizes:
        if _DATED[0] < abs(float(finite[0])) * sizes[unit] < _DATED[1]:
            return unit
    return rated[0] if rated else "s"


def seconds(values: Array, unit: str) -> Array:
    """(T,) in s."""
    return values * size_of(unit)


def increasing(samples: Samples, table: Table, repair: Repair, *, held: bool = False, column: str = "") -> Samples:
    """The samples with time that strictly increases; `column` is its name, for messages.

    `held` says that the clock is a slow one logged together with a faster one: rows that repeat its last sample are
    then expected and left out. Raises FormatError, a ClockError where a mapping can mend it, saying where, how often and
    what to do about it.
    """
    samples = _completed(_going_on(_without_lost_time(samples, table, repair), table))
    if len(samples.time) == 0:
        raise FormatError(f"{table.path}: no samples")
    steps = np.diff(samples.time)
    if np.all(steps > 0.0):
        return samples
    if repair:
        return _repaired(samples, table, repair)
    once = _once(samples)
    if np.all(np.diff(samples.time[once]) > 0.0):
        return _without_placeholder(_without_repeats(samples, once, table, held), table, held)
    back = np.flatnonzero(steps < 0.0)
    within = f" in column '{column}'" if column else ""
    if 2 * back.size > steps.size:
        raise ClockError(
            f"{table.path}: time runs backwards, from {samples.time[0]:.9g} to {samples.time[-1]:.9g} s"
            f'{within} ({back.size} of {steps.size} steps); set repair = "sort" in [time] of the mapping to order the rows, '
            "if they stand newest first"
        )
    if back.size:
        i = int(back[0])
        raise ClockError(
            f"{table.path}, {table.place(i + 1)}: time goes back from {samples.time[i]:.13g} to "
            f'{samples.time[i + 1]:.13g} s{within} ({back.size} such rows); set repair = "sort" in [time] of the mapping to '
            'order the rows, "drop" to leave out those that go back, or "continue" where the clock was set back and rows '
            "stand as they were sampled"
        )
    again = np.flatnonzero(once[1:] & (steps == 0.0)) + 1
    i = int(again[0])
    raise ClockError(
        f"{table.path}, {table.place(i)}: time {samples.time[i]:.9g} s again, with other values ({again.size} such rows of "
        f'{len(steps) + 1}){within}; set repair = "drop" in [time] of the mapping to keep the first of each, or give a rate'
    )


def _completed(samples: Samples) -> Samples:
    """The samples with rows of one instant made one where they complement one another: each topic of a merged log fills its
    own columns (PlotJuggler's CSV), and two of them may have come at once.
    """
    time, values = samples.time, samples.values
    if len(time) < 2 or np.all(np.diff(time) != 0.0):
        return samples
    run = np.concatenate([[0], np.cumsum(np.diff(time) != 0.0)])
    first = np.flatnonzero(np.diff(run, prepend=-1))
    lowest, highest = (f.reduceat(values, first, axis=0) for f in (np.fmin, np.fmax))
    gaps = np.logical_or.reduceat(np.isnan(values).any(axis=1), first)
    whole = gaps & ~np.any(lowest < highest, axis=1)
    kept = ~whole[run]
    kept[first] = True
    values = np.where(whole[run][:, None], lowest[run], values)
    return Samples(time[kept], values[kept], samples.warnings)


def _going_on(samples: Samples, table: Table) -> Samples:
    """The samples with a clock that goes on where its counter began anew: where all steps back are whole rounds of one."""
    whole = round_of(samples.time, _ROUNDS)
    if not whole:
        return samples
    times = int(np.count_nonzero(np.diff(samples.time) < 0.0))
    warning = f"{table.name}: its clock began anew after {whole:.9g} s ({times} times), as full counters do"
    return Samples(on_and_on(samples.time, whole), samples.values, (*samples.warnings, warning))


def round_of(values: Array, wholes: tuple[float, ...]) -> float:
    """Which of `wholes` a clock (T,) steps back by wherever it steps back; 0.0 where it never does, or by something else."""
    steps = np.diff(values)
    back = steps < 0.0
    usual = float(np.median(steps)) if steps.size else 0.0
    if not back.any() or usual <= 0.0:
        return 0.0
    fits = (w for w in wholes if np.all(np.abs(steps[back] + w - usual) < min(10.0 * usual, 0.1 * w)))
    return next(fits, 0.0)


def on_and_on(values: Array, whole: float) -> Array:
    """(T,) a clock that goes on wherever its counter began anew."""
    return values + whole * np.concatenate([[0.0], np.cumsum(np.diff(values) < 0.0)])


def row_offset(main: Array, own: Array) -> tuple[float, float]:
    """What to add to a second clock (T,) to get the main one (T,), both in s, and how much it scatters.

    A slow clock is held over several rows; only rows where it changes tell when a sample arrived, and on average it
    arrived half a row before.
    """
    fresh = np.flatnonzero(np.diff(own) > 0.0) + 1
    if not fresh.size:
        return float(main[0] - own[0]), 0.0
    gaps = main[fresh] - own[fresh]
    is_held = len(fresh) < len(own) - 1
    half = 0.5 * usual_step(main) if is_held else 0.0
    return float(np.median(gaps)) - half, float(np.std(gaps))


def _without_lost_time(samples: Samples, table: Table, repair: Repair) -> Samples:
    lost = np.flatnonzero(~np.isfinite(samples.time))
    if not lost.size:
        return samples
    if not repair:
        raise ClockError(
            f"{table.path}, {table.place(int(lost[0]))}: the time is missing ({lost.size} such rows); "
            'set repair = "drop" in [time] of the mapping to leave them out'
        )
    keep = np.isfinite(samples.time)
    warning = f"{table.name}: {lost.size} rows without a time were left out"
    return Samples(samples.time[keep], samples.values[keep], (*samples.warnings, warning))


def _repaired(samples: Samples, table: Table, repair: Repair) -> Samples:
    time, values = samples.time, samples.values
    if repair == "continue":
        steps, usual = np.diff(time), usual_step(time)
        back = steps < 0.0
        time = time + np.concatenate([[0.0], np.cumsum(np.where(back, usual - steps, 0.0))])
        set_back = (
            f"{table.name}: where its clock goes back ({np.count_nonzero(back)} times) it goes on by {usual:.4g} s"
        )
        if back.any():
            samples = Samples(time, values, (*samples.warnings, f"{set_back}, as the mapping asks"))
        if np.all(np.diff(time) > 0.0):
            return samples
    order = np.argsort(time, kind="stable") if repair == "sort" else np.arange(len(time))
    moved = int(np.count_nonzero(order != np.arange(len(time))))
    time, values = time[order], values[order]
    highest = np.maximum.accumulate(time)
    keep = np.concatenate([[True], time[1:] > highest[:-1]])
    dropped = int(np.count_nonzero(~keep))
    what = f"{moved} rows were moved to their place in time, " if repair == "sort" else ""
    reason = "repeat a time" if repair == "sort" else "do not advance in time"
    warning = f"{table.name}: {what}{dropped} rows that {reason} were left out, as the mapping asks"
    return Samples(time[keep], values[keep], (*samples.warnings, warning))


def _once(samples: Samples) -> Mask:
    """(T,) whether a row says something: not one that stands further up already, with its time and values."""
    _, first, which = np.unique(samples.time, return_index=True, return_inverse=True)
    earlier = first[which]
    same = np.all((samples.values == samples.values[earlier]) | np.isnan(samples.values), axis=1)
    return ~same | (earlier == np.arange(len(earlier)))


def _without_repeats(samples: Samples, once: Mask, table: Table, held: bool) -> Samples:
    repeats = int(np.count_nonzero(~once))
    warning = f"{table.name}: {repeats} of {len(once)} rows that repeat the time and values of one before were left out"
    warnings = samples.warnings if held else (*samples.warnings, warning)
    return Samples(samples.time[once], samples.values[once], warnings)


def _without_placeholder(samples: Samples, table: Table, held: bool) -> Samples:
    """Drops the zeros that stand in a slow clock's columns before its first message."""
    time, values = samples.time, samples.values
    if not held or len(time) < 4 or time[0] != 0.0 or np.any(values[0] != 0.0):
        return samples
    if time[1] - time[0] < 20.0 * usual_step(time):
        return samples
    warning = f"{table.name}: rows with all zeros before the second clock's first sample were left out"
    return Samples(time[1:], values[1:], (*samples.warnings, warning))
