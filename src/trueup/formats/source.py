# SPDX-License-Identifier: Apache-2.0
"""Finds the files behind a path and which of them make one recording together."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from trueup import files
from trueup.errors import FormatError
from trueup.formats import csv, hdf5, json, matlab, npz, parquet, rosbag
from trueup.formats.echoed import with_names
from trueup.formats.episodes import described, episodes, is_description
from trueup.formats.long import one_row_an_instant
from trueup.formats.per_joint import joined
from trueup.formats.rules.joints import read as reading_of
from trueup.formats.rules.names import stem, taken_apart
from trueup.formats.table import Table, listing
from trueup.formats.whose import told_by_rows
from trueup.recording import Recording, with_warnings

_TEXT = (".csv", ".tsv", ".txt", ".dat", ".log", ".asc")
_READERS = {
    **dict.fromkeys(_TEXT, csv.read),
    **dict.fromkeys((".json", ".jsonl", ".ndjson", ".catalog"), json.read),
    **dict.fromkeys((".npz", ".npy"), npz.read),
    **dict.fromkeys((".parquet", ".pq"), parquet.read),
    ".mat": matlab.read,
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), hdf5.read),
}
_ELSEWHERE = {
    "any spreadsheet writes CSV": (".xlsx", ".xls", ".ods"),
    "a pickle may run anything when it is loaded: load it yourself, and write arrays by numpy.savez or a table as CSV": (
        ".pkl", ".pickle", ".pt", ".pth", ".joblib",
    ),
    "PX4's ulog2csv makes CSV files of it, one for each topic": (".ulg",),
}  # fmt: skip
"""What to do with files of other programs, and how their names end."""
_DIGITS = re.compile(r"\d+(?:\.\d+)?")
_NAME = re.compile(r"[A-Za-z_][\w./-]*")


@dataclass(frozen=True)
class Source:
    """What one recording is made from."""

    name: str
    paths: tuple[Path, ...]
    tables: tuple[Table, ...]
    recording: Recording | None = None
    """Set where the file holds a whole recording already."""
    reader: str = ""


def sources(paths: Iterable[str | Path], *, together: bool) -> list[Source]:
    """The recordings behind files and folders; `together`: the files of a folder are one recording in any case.

    Raises FormatError for what is not there or cannot be read.
    """
    found: list[Source] = []
    for path in _without_notes([Path(entry) for entry in paths]):
        if not path.is_dir():
            files.check(path, FormatError)
        found += _folder(path, together) if path.is_dir() and not rosbag.is_bag(path) else _file(path)
    return found


def _without_notes(paths: Sequence[Path]) -> list[Path]:
    """Without files that are notes on others of these."""
    return [p for p in paths if not (_is_note(p) and p.with_suffix(".parquet") in paths)]


def _is_note(path: Path) -> bool:
    """Whether a JSON file goes by the name of a Parquet file beside it: it is about that, as in a campaign's folder."""
    return path.suffix.lower() == ".json" and path.with_suffix(".parquet").is_file()


def is_recording(path: Path) -> bool:
    """Whether a path may hold a recording, by its ending and what is beside it; a folder may where it has any."""
    if path.is_dir() and not rosbag.is_bag(path):
        return any(is_recording(entry) for entry in path.iterdir() if not entry.name.startswith("."))
    return rosbag.is_bag(path) or (path.suffix.lower() in _READERS and not _is_note(path) and not _is_prose(path))


def checksums(paths: Sequence[Path]) -> dict[str, str]:
    """The SHA-256 of each file, by its name."""
    files = [file for path in paths for file in (sorted(path.iterdir()) if path.is_dir() else [path])]
    return {file.name: _sha256(file) for file in files if file.is_file()}


def _file(path: Path) -> list[Source]:
    """The recording in a file, or one for each run that it holds."""
    for part in path.iterdir() if path.is_dir() else [path]:
        files.check(part, FormatError)
    if rosbag.is_bag(path):
        return [Source(path.stem if path.is_file() else path.name, (path,), tuple(rosbag.read(path)), reader="bag")]
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        known = listing([*_READERS, ".mcap", ".db3", ".bag"])
        hint = next((f"; {how}" for how, ends in _ELSEWHERE.items() if path.suffix.lower() in ends), "")
        raise FormatError(f"{path}: files that end in '{path.suffix}' are not known; known are: {known}{hint}")
    result = reader(path)
    kind = path.suffix.lower().lstrip(".")
    if isinstance(result, Recording):
        return [Source(path.stem, (path,), (), result, kind)]
    if isinstance(result, list):
        return [Source(name, (path,), tuple(tables), reader=kind) for name, tables in result]
    runs = episodes(described(told_by_rows(with_names(result)), path), path.stem)
    return [Source(name, (path,), (one_row_an_instant(table),), reader=kind) for name, table in runs]


def _folder(path: Path, together: bool) -> list[Source]:
    """The recordings in a folder: the files complement each other, or are one recording each, or are in folders.

    Folders beside files are not read (they may be older drives, or results), and the first recording says so.
    """
    try:
        entries = sorted(entry for entry in path.iterdir() if not entry.name.startswith("."))
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror or error})") from None
    readable = [e for e in entries if e.is_file() and (e.suffix.lower() in _READERS or rosbag.is_bag(e))]
    files = _without_notes(readable)
    names = {file: labels for file in files if (labels := _names_in(file))}
    data = [file for file in files if file not in names and not _is_prose(file)]
    if not data:
        below = [s for e in entries if e.is_dir() and not is_description(e) for s in _below(e, together)]
        if not below:
            raise FormatError(f"{path}: no file here can be read; files are: {listing(e.name for e in entries)}")
        return below
    first, *others = _of_files(path, files, data, names.values(), together)
    beside = [e.name for e in entries if e.is_dir() and not is_description(e) and is_recording(e)]
    if not beside:
        return [first, *others]
    word = (
        f"{path.name}: its own files ({listing((file.name for file in data), 3)}) were read, not the folders beside them: "
        f"{listing(beside, 5)}; name these, or move the files away, to read the folders"
    )
    return [_with_warning(first, word), *others]


def _of_files(
    path: Path, files: Sequence[Path], data: Sequence[Path], names: Iterable[tuple[str, ...]], together: bool
) -> list[Source]:
    """The recordings in the files of a folder: `data` of them hold numbers; `names` are those that others list."""
    parts = [part for file in data for part in _file(file)]
    tables = tuple(table for part in parts for table in part.tables)
    one = joined(tables) if len(tables) == len(parts) > 1 else None
    if one is not None and not together:
        return [_labelled(Source(path.name, tuple(files), (one,), reader=parts[0].reader), names)]
    alone = any(part.recording is not None or part.reader == "bag" for part in parts)
    if alone or len(parts) == 1 or not (together or _complement(tables)):
        return [_labelled(part, names) for part in parts]
    whole = Source(path.name, tuple(files), tables, reader="+".join(dict.fromkeys(part.reader for part in parts)))
    return [_labelled(whole, names)]


def _below(entry: Path, together: bool) -> list[Source]:
    if rosbag.is_bag(entry):
        return _file(entry)
    readable = [e for e in entry.rglob("*") if e.is_file() and (e.suffix.lower() in _READERS or rosbag.is_bag(e))]
    return _folder(entry, together) if readable else []


def _names_in(path: Path) -> tuple[str, ...]:
    """The names in a file that lists joints, one a line; () for any other file."""
    if path.suffix.lower() not in _TEXT or path.stat().st_size > 1 << 16:
        return ()
    try:
        lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (UnicodeDecodeError, OSError):
        return ()
    return tuple(lines) if lines and all(_NAME.fullmatch(line) for line in lines) else ()


def _is_prose(path: Path) -> bool:
    """Whether a text file beside recordings holds sentences: at most two of its lines have two numbers, or are one."""
    if path.suffix.lower() not in _TEXT or path.suffix.lower() in (".csv", ".tsv") or not path.is_file():
        return False
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            begin = file.read(1 << 16)
    except OSError:
        return False
    lines = [line.strip().lstrip("+-") for line in begin.splitlines()]
    return sum(len(_DIGITS.findall(line)) > 1 or bool(_DIGITS.fullmatch(line)) for line in lines) < 3


def _complement(tables: Sequence[Table]) -> bool:
    """Whether files are parts of one recording rather than runs: other columns, or other roles in their names."""
    said = [reading_of(taken_apart(stem(table.name))) for table in tables]
    kinds = {(tuple(t.columns), tuple(t.text), one.kind, one.command) for t, one in zip(tables, said, strict=True)}
    return len(kinds) == len(tables)


def _labelled(source: Source, names: Iterable[tuple[str, ...]]) -> Source:
    labels = next(iter(names), ())
    if not labels:
        return source
    return replace(source, tables=tuple(replace(t, labels=t.labels or labels) for t in source.tables))


def _with_warning(source: Source, word: str) -> Source:
    """The source with one more warning about it."""
    if source.recording is not None:
        known = source.recording
        return replace(source, recording=known.replace(provenance=with_warnings(known.provenance, [word])))
    table, *others = source.tables
    return replace(source, tables=(replace(table, warnings=(*table.warnings, word)), *others))


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
