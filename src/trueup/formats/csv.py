# SPDX-License-Identifier: Apache-2.0
"""Reads text tables: any separator, with or without names, quoted lists in cells, comments, decimal commas."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from trueup import files
from trueup.arrays import Array, Integers
from trueup.errors import FormatError
from trueup.formats.cells import names_in, parse_lists
from trueup.formats.dates import parse_clock
from trueup.formats.dialect import Dialect, is_empty, is_number, sniff, split
from trueup.formats.table import Table, listing, shown
from trueup.units import size_of

_NULLS = ["", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "na", "n/a", "null", "NULL", "None", "none", "-", "--"]
# Lines that are blank or a comment, in the middle of the data.
_SKIPPED_LINE = re.compile(rb"^[ \t]*(?:$|#|%|//)", re.MULTILINE)
# A list of numbers that nobody quoted, as `print(time, positions)` leaves it.
_BARE_LIST = re.compile(rb"(?<=[,;\t |])(\[(?=[^\]\n]*\d)[\d.eE+\-, \tnaNif]*\])")
_BLANKS = re.compile(rb"[ \t]+")


@dataclass(frozen=True)
class _Body:
    """The lines of data alone, and the number that each has in the file."""

    data: bytes
    first_line: int
    lines: Integers | None

    def number(self, row: int) -> int:
        return int(self.lines[row]) if self.lines is not None and row < len(self.lines) else self.first_line + row

    def texts(self) -> Iterator[tuple[int, str]]:
        """Every line with its number in the file."""
        for i, line in enumerate(self.data.rstrip(b"\n").split(b"\n")):
            yield self.number(i), line.decode("utf-8", "replace")


def read(path: Path) -> Table:
    """The table in a text file. Raises FormatError naming file, line, column and value of what is wrong."""
    data = _text(path)
    head = [line.decode("utf-8") for line in data[: 1 << 18].split(b"\n")[:200]]
    if len(data) > 1 << 18:
        head = head[:-1] or head  # the last one may be cut
    dialect = sniff(head, str(path))
    body = _body(data, dialect)
    body, warnings = _without_cut_end(body, data.endswith(b"\n"), dialect, path)
    arrow = _parse(body, dialect, path)
    columns: dict[str, Array] = {}
    text: dict[str, list[str]] = {}
    for name in dialect.names:
        values = _column(arrow[name], name, body, dialect, path, warnings)
        if isinstance(values, list):
            text[name] = values
        elif values is not None:
            columns[name] = values
    empty = [name for name in dialect.names if name not in columns and name not in text]
    if empty:
        warnings.append(f"{path.name}: nothing at all stands in column {listing(empty, 8)}")
    if not columns:
        raise FormatError(f"{path}: no column of numbers; columns are: {listing(dialect.names)}")
    listed = {cell for cells in text.values() for cell in cells if names_in(cell)}
    return Table(
        name=path.name,
        path=str(path),
        columns=columns,
        text=text,
        labels=names_in(listed.pop()) if len(listed) == 1 else (),
        units=dialect.units,
        row_word="line",
        first_row=body.first_line,
        rows=body.lines,
        metadata={"preamble": "\n".join(dialect.preamble)} if any(dialect.preamble) else {},
        warnings=tuple(warnings),
    )


def _text(path: Path) -> bytes:
    """The file as UTF-8 with plain line ends. Raises FormatError where it is empty or no text."""
    data = files.content(path, FormatError)
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        data = data.decode("utf-16", "replace").encode()
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if not data.strip():
        raise FormatError(f"{path} is empty")
    nul = data.find(b"\0")
    start = np.frombuffer(data[:4096], dtype=np.uint8)
    control = np.count_nonzero((start < 32) & (start != 9) & (start != 10))
    if control > 0.05 * len(start):
        raise FormatError(f"{path} is not a text file (binary data in its first {len(start)} bytes)")
    if nul >= 0:
        line = data.count(b"\n", 0, nul) + 1
        raise FormatError(f"{path}, line {line}: a zero byte; the file is damaged")
    if b"[" in data[: 1 << 16] and b'"' not in data[: 1 << 16]:
        data = _BARE_LIST.sub(rb'"\1"', data)
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1").encode()
    return data


def _body(data: bytes, dialect: Dialect) -> _Body:
    """The data without the head, without comments and blank lines."""
    start = 0
    for _ in range(dialect.first):
        start = data.index(b"\n", start) + 1
    body = data[start:].rstrip(b"\n")
    numbers: Integers | None = None
    if _SKIPPED_LINE.search(body):
        lines = body.split(b"\n")
        kept = [i for i, line in enumerate(lines) if not _SKIPPED_LINE.match(line)]
        numbers = np.array(kept, dtype=np.int64) + dialect.first + 1
        body = b"\n".join(lines[i] for i in kept)
    if dialect.separator == " ":
        body = b"\n".join(line.strip() for line in _BLANKS.sub(b" ", body).split(b"\n"))
    return _Body(body, dialect.first + 1, numbers)


def _without_cut_end(body: _Body, ended: bool, dialect: Dialect, path: Path) -> tuple[_Body, list[str]]:
    """Drops a last line that was cut off while it was written; everything above it is sound."""
    at = body.data.rfind(b"\n")
    line = body.data[at + 1 :].decode("utf-8", "replace")
    cells = split(line, dialect.separator)
    cut = len(cells) < len(dialect.names) or line.count('"') % 2 == 1
    if not cut and not ended:
        above = split(body.data[:at].rsplit(b"\n", 1)[-1].decode("utf-8", "replace"), dialect.separator)
        cut = at > 0 and any(_is_cut(cell, other, dialect.decimal) for cell, other in zip(cells, above, strict=False))
    if not cut:
        return body, []
    rows = body.data.count(b"\n")
    if at < 0:
        raise FormatError(f"{path}, line {body.number(0)}: the only line of data is cut off: {shown(line)}")
    warning = f"{path.name}: the last line ({body.number(rows)}) is cut off and was dropped: {shown(line)}"
    return _Body(body.data[:at], body.first_line, body.lines), [warning]


def _is_cut(cell: str, above: str, decimal: str) -> bool:
    """Whether a cell of the last line misses its end: a list that is not closed, a number that is none."""
    if above[:1] in ("[", "("):
        return cell[-1:] not in ("]", ")") and not is_empty(cell)
    empty = is_empty(cell) and not cell.startswith("-")
    return is_number(above, decimal) and not is_number(cell, decimal) and not empty


def _parse(body: _Body, dialect: Dialect, path: Path) -> pa.Table:
    ragged: list[int] = []

    def skip(row: pacsv.InvalidRow) -> str:
        ragged.append(row.actual_columns)
        return "skip"

    longest = max(len(line) for line in body.data[: 1 << 20].split(b"\n"))
    try:
        table = pacsv.read_csv(
            io.BytesIO(body.data),
            read_options=pacsv.ReadOptions(column_names=list(dialect.names), block_size=max(1 << 22, 8 * longest)),
            parse_options=pacsv.ParseOptions(delimiter=dialect.separator, invalid_row_handler=skip),
            convert_options=pacsv.ConvertOptions(
                strings_can_be_null=True, null_values=_NULLS, decimal_point=dialect.decimal
            ),
        )
    except pa.ArrowException as error:
        _raise_for_lines(body, dialect, path)
        raise FormatError(f"{path}: cannot be read as a table ({error})") from None
    rows = body.data.count(b"\n") + 1
    if ragged or table.num_rows != rows:
        _raise_for_lines(body, dialect, path)
        raise FormatError(f"{path}: {rows} lines of data, but {table.num_rows} could be read; look for a stray quote")
    return table


def _raise_for_lines(body: _Body, dialect: Dialect, path: Path) -> None:
    """Finds the first line that does not have as many cells as the others, and raises FormatError for it."""
    width = len(dialect.names)
    for number, line in body.texts():
        if line.count('"') % 2:
            raise FormatError(f"{path}, line {number}: a quote is not closed: {shown(line)}")
        cells = split(line, dialect.separator)
        if len(cells) != width:
            raise FormatError(
                f"{path}, line {number}: {len(cells)} cells, but there are {width} columns: {shown(line)}"
            )


def _column(
    column: pa.ChunkedArray, name: str, body: _Body, dialect: Dialect, path: Path, warnings: list[str]
) -> Array | list[str] | None:
    """Numbers, words, or None where every cell is empty; what was assumed to read them is added to `warnings`."""
    kind = column.type
    if pa.types.is_null(kind):
        return None
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind):
        return _floats(column)
    if pa.types.is_timestamp(kind):
        return _floats(column.cast(pa.timestamp("ns", tz=kind.tz)).cast(pa.int64())) * size_of("ns")
    if pa.types.is_time(kind):
        return _floats(column.cast(pa.time64("ns")).cast(pa.int64())) * size_of("ns")
    cells = ["" if cell is None else str(cell) for cell in column.to_pylist()]
    return _from_words(cells, name, body, dialect, path, warnings)


def _from_words(
    cells: list[str], name: str, body: _Body, dialect: Dialect, path: Path, warnings: list[str]
) -> Array | list[str]:
    def place(row: int) -> str:
        return f"{path}, line {body.number(row)}, column '{name}'"

    filled = [cell for cell in cells if not is_empty(cell)]
    if any("\n" in cell for cell in filled):
        _raise_for_lines(body, dialect, path)
    lists = sum(cell.lstrip()[:1] in ("[", "(") or cell.startswith("array(") for cell in filled)
    if filled and names_in(filled[0]):
        return cells
    if lists and lists * 2 >= len(filled):
        return parse_lists(cells, place)
    clock = parse_clock(cells)
    if clock is not None:
        warnings += [f"{path.name}, column '{name}': {clock.note}"] if clock.note else []
        return clock.time
    good = sum(is_number(cell, dialect.decimal) for cell in filled)
    if good * 2 <= len(filled):
        return cells
    values = np.full(len(cells), np.nan)
    for i, cell in enumerate(cells):
        try:
            values[i] = np.nan if is_empty(cell) else float(cell.replace(",", ".") if dialect.decimal == "," else cell)
        except ValueError:
            again = (
                "; the header stands there again: was it begun anew? Make a file of each part" if cell == name else ""
            )
            raise FormatError(f"{place(i)}: {shown(cell)} is not a number{again}") from None
    return values


def _floats(column: pa.ChunkedArray) -> Array:
    """(T,) float64 with NaN where a cell is empty."""
    # Arrow's casts take a while to load, and most columns need none.
    wide = column if column.type == pa.float64() else column.cast(pa.float64(), safe=False)
    return np.concatenate([_chunk(chunk) for chunk in wide.chunks] or [np.empty(0)])


def _chunk(chunk: pa.Array) -> Array:
    if chunk.null_count:
        return np.array(chunk.to_numpy(zero_copy_only=False), dtype=np.float64)
    # Straight from the buffer where nothing is missing: to_numpy() would load pandas, half a second.
    return np.frombuffer(chunk.buffers()[1], dtype=np.float64)[chunk.offset : chunk.offset + len(chunk)]
