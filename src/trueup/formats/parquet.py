# SPDX-License-Identifier: Apache-2.0
"""Writes and reads recordings as Parquet, one file each, with units, labels and provenance in the metadata.

The columns are plain ones that any tool shows: 'time', 'position/elbow', ...; channels with instants of their own have
'<channel>/time'. Shorter columns are filled up with nulls. Any other Parquet file is read as a table.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from trueup.arrays import Array
from trueup.errors import FormatError, OutputError
from trueup.formats.aside import written_aside
from trueup.formats.dates import parse_clock
from trueup.formats.entries import apart_from_names, columns_of, from_entries
from trueup.formats.table import Table, listing, numbers
from trueup.recording import Channel, Recording
from trueup.units import size_of

_KEY = b"trueup"
_VERSION = 1


def write(recording: Recording, path: Path) -> None:
    """Writes a recording aside and puts it in place of `path`. Raises OutputError; then `path` is as it was."""
    table = _to_table(recording)
    with written_aside(path) as temporary:
        try:
            pq.write_table(table, temporary, compression="zstd", write_page_checksum=True)
        except pa.ArrowException as error:
            raise OutputError(f"cannot write '{path}': {error}; what was there before is untouched") from error


def read(path: Path) -> Recording | Table:
    """The recording that `write` wrote, or the table in a Parquet file from elsewhere. Raises FormatError."""
    try:
        table = pq.read_table(path, page_checksum_verification=True, use_threads=False)
        header = (table.schema.metadata or {}).get(_KEY)
        if header is None:
            return _foreign(table, path)
        return _to_recording(table, json.loads(header), path)
    except FormatError:
        raise
    except Exception as error:  # damaged bytes surface as many kinds of error, in Arrow and in what its content breaks
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(f"{path}: cannot be read as Parquet ({reason})") from error


def _to_table(recording: Recording) -> pa.Table:
    rows = max(len(c.time) for c in recording.channels.values())
    columns: dict[str, pa.Array] = {}
    clocks: list[tuple[Array, str]] = []
    entries = []
    for name, channel in recording.channels.items():
        clock = next((key for time, key in clocks if np.array_equal(time, channel.time)), "")
        if not clock:
            clock = f"{name}/time" if clocks else "time"
            clocks.append((channel.time, clock))
            columns[clock] = _filled(channel.time, rows)
        names = [f"{name}/{label}" for label in channel.labels]
        for column, values in zip(names, channel.values.T, strict=True):
            columns[_free(column, columns)] = _filled(values, rows)
        entry = {"name": name, "labels": channel.labels, "unit": channel.unit, "time": clock, "rows": len(channel.time)}
        entries.append({**entry, "columns": list(columns)[-len(names) :]})
    header = {
        "version": _VERSION,
        "name": recording.name,
        "channels": entries,
        "provenance": dict(recording.provenance),
    }
    table = pa.table(columns)
    return table.replace_schema_metadata({_KEY: json.dumps(header).encode()})


def _free(name: str, used: Mapping[str, Any]) -> str:
    """A column name not in use: the label 'time' would collide with a clock."""
    while name in used:
        name += "'"
    return name


def _filled(values: Array, rows: int) -> pa.Array:
    """`values` with nulls up to `rows`; NaN stays NaN."""
    padding = pa.nulls(rows - len(values), pa.float64())
    return pa.concat_arrays([pa.array(values, from_pandas=False), padding])


def _to_recording(table: pa.Table, header: Mapping[str, Any], path: Path) -> Recording:
    if header["version"] > _VERSION:
        raise FormatError(f"{path}: format version {header['version']}; this trueup reads up to {_VERSION}: update it")
    channels = {}
    for entry in header["channels"]:
        rows = entry["rows"]
        time = _plain(table, entry["time"], rows)
        values = np.stack([_plain(table, column, rows) for column in entry["columns"]], axis=1)
        channels[entry["name"]] = Channel(entry["name"], tuple(entry["labels"]), entry["unit"], time, values)
    return Recording(header["name"], channels, header["provenance"])


def _plain(table: pa.Table, column: str, rows: int) -> Array:
    return table[column].slice(0, rows).to_numpy().astype(np.float64)


def _foreign(table: pa.Table, path: Path) -> Table:
    """Columns of numbers and lists of numbers; structs are taken apart."""
    for _ in range(8):
        if not any(pa.types.is_struct(field.type) for field in table.schema):
            break
        table = table.flatten()
    columns, words, notes = dict[str, Array](), dict[str, list[str]](), list[str]()
    nested, table = _by_name(table)
    for prefix, samples in nested.items():
        _, cells = apart_from_names(from_entries(samples, path, prefix))
        found, said = columns_of(cells, str(path), notes)
        columns |= {f"{prefix}{name}": values for name, values in found.items()}
        words |= {f"{prefix}{name}": values for name, values in said.items()}
    for name in dict.fromkeys(table.column_names):
        values = _values(table.column(table.column_names.index(name)), f"{path}, column '{name}'", notes)
        if isinstance(values, list):
            words[name] = values
        elif values is not None and values.size:
            columns[name] = values
    if not columns:
        raise FormatError(f"{path}: no column of numbers; columns are: {listing(table.column_names)}")
    return Table(path.name, str(path), columns, words, warnings=tuple(notes))


def _by_name(table: pa.Table) -> tuple[dict[str, list[dict[str, Any]]], pa.Table]:
    """Lists beside a list of the names of joints, or of structs, as samples of what stands in one struct (by its name); and
    the table without them.
    """
    lists = [n for n in dict.fromkeys(table.column_names) if _is_list(table.schema.field(n).type)]
    tells = {n.rpartition(".")[0] for n in lists if not _of_numbers(table.schema.field(n).type.value_type)}
    samples: dict[str, list[dict[str, Any]]] = {}
    for outer in tells:
        own = [n for n in lists if n.rpartition(".")[0] == outer]
        part = table.select(own).rename_columns([n.rpartition(".")[2] for n in own])
        samples[f"{outer}." if outer else ""] = part.to_pylist()
        table = table.drop_columns(own)
    return samples, table


def _is_list(kind: pa.DataType) -> bool:
    return pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)


def _of_numbers(kind: pa.DataType) -> bool:
    return not (pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_struct(kind))


def _values(column: pa.ChunkedArray, where: str, notes: list[str]) -> Array | list[str] | None:
    kind = column.type
    if pa.types.is_dictionary(kind):
        column = column.cast(kind.value_type)
        kind = column.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        exact = pa.timestamp("ns", tz=kind.tz) if pa.types.is_timestamp(kind) else pa.duration("ns")
        return _floats(column.cast(exact).cast(pa.int64())) * size_of("ns")
    if (
        pa.types.is_boolean(kind)
        or pa.types.is_integer(kind)
        or pa.types.is_floating(kind)
        or pa.types.is_decimal(kind)
    ):
        return _floats(column.cast(pa.float64(), safe=False))
    if _is_list(kind):
        return numbers(column.to_pylist(), where, "row")
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        cells = ["" if cell is None else cell for cell in column.to_pylist()]
        clock = parse_clock(cells)
        if clock is not None and clock.note:
            notes.append(f"{where}: {clock.note}")
        return cells if clock is None else clock.time
    return None


def _floats(column: pa.ChunkedArray) -> Array:
    return np.array(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=np.float64)
