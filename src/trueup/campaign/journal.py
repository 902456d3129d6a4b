# SPDX-License-Identifier: Apache-2.0
"""The journal of a campaign: append-only JSON lines, each safe on disk before anything follows from it.

What is journaled holds no instants, so that an interrupted campaign's journal equals an uninterrupted one's byte for
byte; when things happened stands in times.jsonl beside it.

Each line ends with a check sum over all that stands before it, so that an altered digit, a lost line and an exchanged
file are all seen. Lines written before there were check sums are read as they are, up to the first that has one.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TextIO, TypeVar

from trueup import files
from trueup.campaign.events import Event, from_plain, to_plain
from trueup.errors import JournalError, OutputError
from trueup.formats.aside import sync_folder, write_aside

E = TypeVar("E")

JOURNAL, TIMES, _LOCK = "journal.jsonl", "times.jsonl", "lock"
OUTCOMES = "recordings/trial-*.json"
"""What trials leave behind, from the campaign's folder."""
_MEND = "Restore it from a copy, or go on from the lines before: trueup resume {} --from-line {}"
_CHECKED = re.compile(rb'(.*),"check":"([0-9a-f]{16})"\}', re.DOTALL)


def reference_file(folder: Path, of: str, name: str) -> Path:
    """Where a campaign's folder has what the task's trial `of` follows."""
    of, name = ("".join(c if c.isalnum() or c in "-_" else "_" for c in part) for part in (of, name))
    return folder / "references" / f"{of}.{name}.csv"


def read_journal(folder: Path) -> tuple[Event, ...]:
    """All events of the campaign in `folder`, for reading only; a torn last line is left out.

    Raises JournalError where there is no journal, or a line is damaged, altered or of another version.
    """
    return _Content.of(folder / JOURNAL).events


def read_whole(folder: Path) -> tuple[Event, ...]:
    """The same, where no line that was written is missing at the end either. Raises JournalError."""
    noted = _noted(folder)  # before the journal: what another process writes in between is no line that is missing
    events = _Content.of(folder / JOURNAL).events
    _check_whole(folder, len(events), noted)
    return events


def set_back(folder: Path, line: int) -> Path:
    """Cuts the journal before a line (counted from 1), so that the campaign goes on from there; where the old one is now.

    Recordings stay: a trial that is decided on anew in the same way takes what was recorded of it. Raises JournalError
    where a line before that one is damaged too, or there is no such line.
    """
    with _locked(folder):
        return _set_back(folder, folder / JOURNAL, line)


def _set_back(folder: Path, path: Path, line: int) -> Path:
    lines = _bytes(path).split(b"\n")
    if not 2 <= line <= len(lines):
        raise JournalError(f"{path} has {len(lines) - 1} whole lines: --from-line takes 2 to {len(lines)}, not {line}")
    head = b"".join(one + b"\n" for one in lines[: line - 1])
    _Content.parsed(path, head, torn=False)
    aside = next(a for k in range(1, 1000) if not (a := folder / f"journal-{k}.jsonl").exists())
    os.link(path, aside)
    write_aside(head, path)
    times = read_times(folder)
    keep_text(folder / TIMES, "".join(_time_line(n, at) for n, at in sorted(times.items()) if n < line - 1))
    return aside


def read_times(folder: Path) -> dict[int, float]:
    """Event number -> when it was written, in s since the epoch; whatever can be read."""
    found: dict[int, float] = {}
    try:
        lines = files.text(folder / TIMES, JournalError).splitlines()
    except JournalError:
        return found
    for line in lines:
        try:
            one = json.loads(line)
            found[int(one["number"])] = float(one["at"])
        except (ValueError, KeyError, TypeError, OverflowError):
            continue
    return found


class Journal:
    """The journal open for writing, by one process at a time. Close it, or use it as a context.

    A campaign is replayed by running the same code again: each `once` gives the next event that is already there, and
    only where there is none is the event made, written, flushed and synced, in this order.
    """

    def __init__(self, folder: Path) -> None:
        """Opens or starts the journal in `folder`, and cuts off a torn last line.

        Raises JournalError where another process has it, or where it cannot be understood, OutputError without access.
        """
        self.folder = folder
        self._lock = _locked(folder)
        path = folder / JOURNAL
        try:
            content = _Content.of(path) if path.exists() else _Content((), 0, hashlib.sha256())
            _check_whole(folder, len(content.events), _noted(folder))
        except JournalError:
            self._lock.close()
            raise
        self._past, self._before = content.events, content.digest
        self._file = path.open("ab")
        self._file.truncate(content.size)
        self._times = (folder / TIMES).open("a", encoding="utf-8")
        sync_folder(folder)
        self._next = 0

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def past(self) -> tuple[Event, ...]:
        """What was there when it was opened."""
        return self._past

    @property
    def replaying(self) -> bool:
        """Whether the next event is there already."""
        return self._next < len(self._past)

    def coming(self) -> Event | None:
        """The next event if it is there already."""
        return self._past[self._next] if self.replaying else None

    def once(self, kind: type[E], make: Callable[[], E]) -> E:
        """The next event: as journaled before, or made now and safe on disk when this returns.

        Raises JournalError where the journal holds another kind of event here: it was written by other code.
        """
        if self.replaying:
            event = self._past[self._next]
            if not isinstance(event, kind):
                raise JournalError(
                    f"{self.folder / JOURNAL}, line {self._next + 1}: {type(event).__name__} where this version of trueup "
                    f"would write {kind.__name__}; go on with the version that wrote it"
                )
        else:
            event = make()
            self._append(event)
        self._next += 1
        return event

    def close(self) -> None:
        """Closes the files and lets another process have the journal."""
        self._file.close()
        self._times.close()
        self._lock.close()

    def _append(self, event: object) -> None:
        plain = json.dumps({"number": self._next, **to_plain(event)}, allow_nan=False, separators=(",", ":"))  # type: ignore[arg-type]
        body = plain[:-1].encode()
        line = body + f',"check":"{_check(self._before, body)}"}}\n'.encode()
        try:
            self._file.write(line)
            self._file.flush()
            os.fsync(self._file.fileno())
            self._before.update(line)
            self._times.write(_time_line(self._next, round(time.time(), 3)))
            self._times.flush()
        except OSError as error:
            raise OutputError(f"{self.folder / JOURNAL}: cannot be written ({error.strerror or error})") from None


def _locked(folder: Path) -> TextIO:
    """The folder, made if need be, for this process alone until what is returned is closed."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / _LOCK).open("a")
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        lock.close()
        raise JournalError(f"{folder}: another process is running this campaign; one at a time") from None
    return lock


def keep_text(path: Path, text: str) -> None:
    """Writes an artifact aside, syncs it, renames it, and syncs its folder. Raises OutputError."""
    write_aside(text, path)
    sync_folder(path.parent)


@dataclass(frozen=True)
class _Content:
    """What a journal's file holds."""

    events: tuple[Event, ...]
    size: int
    """Bytes that the events take; what follows is a torn line."""
    digest: hashlib._Hash
    """Over these bytes: what the next line's check sum begins with."""

    @classmethod
    def of(cls, path: Path) -> _Content:
        """Raises JournalError where it cannot be read, or a line is not what was written."""
        return cls.parsed(path, _bytes(path))

    @classmethod
    def parsed(cls, path: Path, content: bytes, *, torn: bool = True) -> _Content:
        """The events of a file's bytes; `torn`: its last line may be unfinished."""
        events: list[Event] = []
        digest, size, checked = hashlib.sha256(), 0, False
        for line in content.split(b"\n")[:-1]:  # what follows the last newline was never finished
            where, mend = f"{path}, line {len(events) + 1}", _MEND.format(path.parent, len(events) + 1)
            if torn and b"\0" in line and size + len(line) + 1 == len(content):
                break  # a power cut may leave the last line's length without its content
            match = _CHECKED.fullmatch(line)
            wanted = checked or b'"check"' in line
            if wanted if match is None else match[2].decode() != _check(digest, match[1]):
                raise JournalError(f"{where}: altered or damaged, its check sum does not fit. {mend}")
            try:
                plain = json.loads(line)
                if not isinstance(plain, dict) or plain.get("number") != len(events):
                    raise ValueError
            except ValueError:
                raise JournalError(f"{where}: damaged. {mend}") from None
            checked = match is not None
            events.append(from_plain({k: v for k, v in plain.items() if k != "check"}, where))
            digest.update(line + b"\n")
            size += len(line) + 1
        begun = f'{{"number":{len(events)},'.encode()
        tail = content[size:].rstrip(b"\0")
        if torn and b"\n" not in tail and tail[: len(begun)] != begun[: len(tail)]:
            raise JournalError(f"{path}: what follows line {len(events)} was not written by trueup. "
                               + _MEND.format(path.parent, len(events) + 1))  # fmt: skip
        return cls(tuple(events), size, digest)


def _check(before: hashlib._Hash, body: bytes) -> str:
    """The check sum of a line: SHA-256 over all lines before it and its own text, 16 digits of it."""
    digest = before.copy()
    digest.update(body)
    return digest.hexdigest()[:16]


def _noted(folder: Path) -> int:
    """How many lines were written, by the instants that stand beside the journal."""
    return 1 + max(read_times(folder), default=-1)


def _check_whole(folder: Path, events: int, noted: int) -> None:
    """Raises JournalError where lines are missing at the end: when each was written is noted after it was safe."""
    path = folder / JOURNAL
    outcome = next(iter(sorted(folder.glob(OUTCOMES))), None)
    if not events and outcome is not None:
        raise JournalError(
            f"{path}: empty, though {outcome} is the outcome of a trial. Restore the journal from a copy; a new campaign "
            "needs another folder (--out)"
        )
    if noted > events:
        raise JournalError(
            f"{path}: has {events} whole lines where {noted} were written ({TIMES}). Restore it from a copy, or go on from "
            f"what is there: trueup resume {folder} --from-line {events + 1}"
        )


def _time_line(number: int, at: float) -> str:
    return json.dumps({"number": number, "at": at}) + "\n"


def _bytes(path: Path) -> bytes:
    return files.content(path, JournalError)
