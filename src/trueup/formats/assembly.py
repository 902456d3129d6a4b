# SPDX-License-Identifier: Apache-2.0
"""Makes a recording from tables as a mapping says."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.errors import ClockError, FormatError, MappingError, OtherFilesMappingError, unknown_name
from trueup.formats.blanks import of_a_topic, without_blanks
from trueup.formats.clock import Samples, guess_unit, increasing, row_offset, seconds
from trueup.formats.mapping import ChannelColumns, ChannelMap, TimeColumn
from trueup.formats.rules.joints import joint_labels
from trueup.formats.rules.names import is_time
from trueup.formats.table import Table, listing, shown
from trueup.recording import Channel, Recording, with_warnings
from trueup.rounding import DATE
from trueup.units import to_si


def assemble(tables: Sequence[Table], mapping: ChannelMap, name: str, provenance: Mapping[str, str]) -> Recording:
    """The recording that `mapping` makes of `tables`.

    Raises MappingError where the mapping names what is not there, and FormatError where the data are unsound.
    """
    _check_meant(tables, mapping)
    warnings = [warning for table in tables for warning in table.warnings]
    channels: dict[str, Channel] = {}
    sources: dict[str, Table] = {}
    for role, entry in mapping.channels.items():
        sources[role] = table = _table(role, entry, tables)
        values, labels = _values(role, entry, table)
        timed = _timed(role, entry, mapping.time, table, tables, values)
        samples = without_blanks(timed, role, topic=of_a_topic(values, table))
        missing = int(np.count_nonzero(np.isnan(samples.values)))
        warnings += samples.warnings
        gone = [label for label, column in zip(labels, samples.values.T, strict=True) if np.isnan(column).all()]
        if gone:
            warnings.append(f"{role}: no value at all of {listing(gone)}")
        if missing > len(gone) * len(samples.values):
            warnings.append(f"{role}: {missing} of {samples.values.size} values are missing")
        units = tuple(to_si(u)[0] for u in entry.units)
        unit = max(units, key=units.count) if units else to_si(entry.unit)[0]
        mixed = units if len(set(units)) > 1 else ()
        channels[role] = Channel(role, labels, unit, samples.time, samples.values, mixed)
    _check_together(channels, sources)
    channels, origin = _from_zero(channels)
    facts = {**provenance, **_metadata(tables), **({"time_origin": f"{origin!r} s"} if origin else {})}
    recording = Recording(name, channels, with_warnings(facts, dict.fromkeys(warnings)))
    return _renamed(recording, mapping.joints)


def _check_meant(tables: Sequence[Table], mapping: ChannelMap) -> None:
    """Raises OtherFilesMappingError where no column of any channel is there."""
    named = [pattern for entry in mapping.channels.values() for pattern in entry.columns]
    names = [name for table in tables for name in (*table.columns, *table.text)]
    if not any(_matches(pattern, name) for pattern in named for name in names):
        raise OtherFilesMappingError(
            f"{tables[0].path} has no column '{named[0]}'; columns are: {listing(names)}. The mapping names none of them"
        )


def _check_together(channels: Mapping[str, Channel], sources: Mapping[str, Table]) -> None:
    """Raises ClockError where a file's clock counts from another instant: further away than the longer of two is long."""
    spans = {role: (float(c.time[0]), float(c.time[-1])) for role, c in channels.items() if len(c.time) > 1}
    most = max(spans, key=lambda role: len(channels[role].time), default="")
    for role, (begin, end) in spans.items():
        first, last = spans[most]
        if sources[role] is not sources[most] and max(begin - last, first - end) > max(end - begin, last - first):
            raise ClockError(
                f"{sources[role].path}: its clock goes from {begin:.10g} to {end:.10g} s, that of {sources[most].name} from "
                f"{first:.10g} to {last:.10g} s, so that no instant is in both (channels '{role}' and '{most}'): they count "
                "from different instants. Put both onto one clock in the files; or, where the difference is the same in all "
                f"logs, give the channels of one time_offset = seconds in the mapping ({first - begin:.12g} if they began "
                "together)"
            )


def _table(role: str, entry: ChannelColumns, tables: Sequence[Table]) -> Table:
    """The one table that holds the channel's columns."""
    if entry.file:
        found = [table for table in tables if table.name == entry.file or _matches(entry.file, table.name)]
        if not found:
            known = listing(table.name for table in tables)
            raise MappingError(f"channel '{role}': no file or topic '{entry.file}'; there are: {known}")
    else:
        found = list(tables)
    holding = [table for table in found if all(_matching(pattern, table) for pattern in entry.columns)]
    if len(holding) == 1:
        return holding[0]
    if len(holding) > 1:
        names = listing(table.name for table in holding)
        raise MappingError(f"channel '{role}': its columns are in several files ({names}); add file = \"...\"")
    for pattern in entry.columns:
        for table in found:
            if pattern in table.text:
                word = shown(next((cell for cell in table.text[pattern] if cell), ""))
                raise MappingError(f"channel '{role}': column '{pattern}' of {table.path} holds words such as {word}")
    table = max(found, key=lambda t: sum(bool(_matching(pattern, t)) for pattern in entry.columns))
    pattern = next(pattern for pattern in entry.columns if not _matching(pattern, table))
    raise MappingError(
        f"channel '{role}': {table.path} has no column '{pattern}'; columns are: {listing(table.columns)}"
    )


def _matching(pattern: str, table: Table) -> list[str]:
    """The columns of numbers that a name or pattern stands for, in the file's order."""
    if pattern in table.columns:
        return [pattern]
    return [name for name in table.columns if _matches(pattern, name)]


def _matches(pattern: str, name: str) -> bool:
    # Brackets are common in column names ("q[0]"), so only * and ? are special.
    return bool(re.fullmatch(re.escape(pattern).replace(r"\*", ".*").replace(r"\?", "."), name))


def _values(role: str, entry: ChannelColumns, table: Table) -> tuple[Array, tuple[str, ...]]:
    """(T, k) in SI, and the labels."""
    names = list(dict.fromkeys(name for pattern in entry.columns for name in _matching(pattern, table)))
    parts = [table.columns[name] for name in names]
    raw = np.concatenate([part[:, None] if part.ndim == 1 else part for part in parts], axis=1)
    if entry.width > 1:
        raw = _reshaped(raw, entry.width, role, table)
    width = raw.shape[1]
    labels = entry.labels or _labels(names, table, width)
    if len(labels) != width:
        raise MappingError(
            f"channel '{role}': {len(labels)} labels ({listing(labels)}) for {width} columns of {table.path}"
        )
    scale, offset, sign = (
        _per_column(numbers, key, width, role)
        for key, numbers in (("scale", entry.scale), ("offset", entry.offset), ("sign", entry.sign))
    )
    if entry.units and len(entry.units) != width:
        raise MappingError(f"channel '{role}': {len(entry.units)} units ({listing(entry.units)}) for {width} labels")
    factor, zero = np.array([to_si(u)[1:] for u in entry.units or (entry.unit,)]).T
    with np.errstate(over="ignore", invalid="ignore"):
        values = (raw * scale + offset) * sign * factor + zero
    largest = np.sqrt(np.finfo(np.float64).max)  # squares of what is larger overflow: damage, not a measurement
    values[~(np.abs(values) < largest)] = np.nan
    return values, tuple(labels)


def _reshaped(raw: Array, width: int, role: str, table: Table) -> Array:
    """(T, width) from one number a line."""
    if raw.shape[1] != 1:
        raise MappingError(f"channel '{role}': width is for one number a line; {table.path} has {raw.shape[1]} a line")
    if len(raw) % width:
        raise FormatError(
            f"{table.path}: {len(raw)} numbers are no multiple of {width} (channel '{role}'): "
            f"{len(raw) % width} are left over, so the file is cut off or the width is wrong"
        )
    return raw.reshape(-1, width)


def _labels(names: Sequence[str], table: Table, width: int) -> tuple[str, ...]:
    if len(table.labels) == width:
        return table.labels
    if len(names) == width:
        return joint_labels(names)
    return tuple(f"joint_{i + 1}" for i in range(width))


def _per_column(numbers: tuple[float, ...], key: str, width: int, role: str) -> Array:
    if len(numbers) not in (1, width):
        raise MappingError(f"channel '{role}': {len(numbers)} numbers for {key}; give one, or {width}")
    return np.array(numbers)


def _timed(
    role: str, entry: ChannelColumns, time: TimeColumn, table: Table, tables: Sequence[Table], values: Array
) -> Samples:
    """The channel's values with their time."""
    if entry.time:
        own = _clock(entry.time, entry.time_unit, table)
        return _on_second_clock(entry, time, table, own, values)
    if entry.rate is not None or (time.rate is not None and not time.column):
        rate = entry.rate if entry.rate is not None else time.rate
        if rate is None or not len(values):
            raise FormatError(f"{table.path}: no samples")
        return Samples(np.arange(len(values)) / rate, values)
    source = _time_table(time, table, tables)
    if not time.column and not time.file:
        still = [
            f"{n} is {v.flat[0]:.16g} in all rows" for n, v in table.columns.items() if is_time(n) and np.ptp(v) == 0
        ]
        why = f" ({'; '.join(still)}: were digits lost?)" if still else ""
        raise MappingError(
            f"channel '{role}': no time for {table.path}{why}: name a column in [time] (columns are: "
            f"{listing((*table.columns, *table.text))}), or give rate = samples per second"
        )
    clock = _clock(time.column or next(iter(source.columns)), time.unit, source)
    if time.nanoseconds:
        clock = clock + seconds(_raw_clock(time.nanoseconds, source), "ns")
    if len(clock) != len(values):
        raise FormatError(
            f"{source.path} has {len(clock)} times, but channel '{role}' has {len(values)} samples in {table.path}"
        )
    return increasing(Samples(clock, values), source, time.repair, column=time.column)


def _on_second_clock(entry: ChannelColumns, time: TimeColumn, table: Table, own: Array, values: Array) -> Samples:
    offset, notes = entry.time_offset, ()
    if offset == "rows":
        main = _clock(time.column, time.unit, table)
        usable = np.isfinite(main) & np.isfinite(own)
        if not np.any(usable):
            raise FormatError(f"{table.path}: no row has both '{time.column}' and '{entry.time}'")
        offset, scatter = row_offset(main[usable], own[usable])
        notes = (
            f"{table.name}: clock '{entry.time}' was set to '{time.column}' by adding {offset:.6f} s, "
            f"as their rows say (scatter {scatter * 1e3:.2g} ms)",
        )
    samples = increasing(Samples(own, values, notes), table, time.repair, held=True, column=entry.time)
    return replace(samples, time=samples.time + offset)


def _time_table(time: TimeColumn, table: Table, tables: Sequence[Table]) -> Table:
    if not time.file:
        return table
    found = [t for t in tables if t.name == time.file or _matches(time.file, t.name)]
    if len(found) != 1:
        known = listing(t.name for t in tables)
        raise MappingError(f"[time]: {len(found)} files are '{time.file}'; files are: {known}")
    return found[0]


def _raw_clock(column: str, table: Table) -> Array:
    if column in table.text:
        word = shown(next((cell for cell in table.text[column] if cell), ""))
        raise MappingError(
            f"{table.path}: column '{column}' cannot be the time, as it holds words such as {word}; times are numbers, or "
            "read as 12:30:05.25, 2024-03-31 12:30:05.25 or 31.03.2024 12:30:05.25"
        )
    if column not in table.columns:
        raise MappingError(f"{table.path} has no column '{column}' for the time; columns are: {listing(table.columns)}")
    values = table.columns[column]
    if values.ndim != 1:
        raise MappingError(f"{table.path}: column '{column}' holds lists and cannot be the time")
    return values


def _clock(column: str, unit: str, table: Table) -> Array:
    """(T,) in s."""
    values = _raw_clock(column, table)
    return seconds(values, unit or table.units.get(column, "") or guess_unit(column, values))


def _from_zero(channels: Mapping[str, Channel]) -> tuple[dict[str, Channel], float]:
    """Clocks that count from a date moved to begin at 0, and by how much [s]."""
    first = min(float(c.time[0]) for c in channels.values())
    if abs(first) < DATE:
        return dict(channels), 0.0
    return {name: c.replace(time=c.time - first) for name, c in channels.items()}, first


def _metadata(tables: Sequence[Table]) -> dict[str, str]:
    """Facts that stand beside the signals, and short lists of events."""
    events = 50  # tables of words with at most so many rows are lists of them
    facts = {key: value for table in tables for key, value in table.metadata.items()}
    for table in tables:
        if table.text and table.length <= events:
            columns = [[f"{value:g}" for value in v] for v in table.columns.values() if v.ndim == 1]
            rows = zip(*columns, *table.text.values(), strict=True)
            facts[f"events in {table.name}"] = "; ".join(" ".join(row) for row in rows)
    return facts


def _renamed(recording: Recording, joints: Mapping[str, str]) -> Recording:
    known = {label for c in recording.channels.values() for label in c.labels}
    for old in joints:
        if old not in known:
            raise unknown_name("joint", old, known, f"{recording.name} ([joints] of the mapping)")
    return recording.rename(joints) if joints else recording
