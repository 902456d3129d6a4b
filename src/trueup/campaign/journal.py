# SPDX-License-Identifier: Apache-2.0
"""The journal of a campaign: append-only JSON lines, each safe on disk before anything follows from it.

What is journaled holds no instants, so that an interrupted campaign's journal equals an uninterrupted one's byte for
byte; when things happened stands in times.jsonl beside it, which nothing depends on.
"""

from __future__ import annotations

import fcntl
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TypeVar

from trueup.campaign.events import Event, from_plain, to_plain
from trueup.errors import JournalError, OutputError
from trueup.formats.aside import written_aside

E = TypeVar("E")

JOURNAL, TIMES, _LOCK = "journal.jsonl", "times.jsonl", "lock"


def read_journal(folder: Path) -> tuple[Event, ...]:
    """All events of the campaign in `folder`, for reading only; a torn last line is left out.

    Raises JournalError where there is no journal, or a line before the last cannot be understood.
    """
    return _events(folder / JOURNAL)[0]


def read_times(folder: Path) -> dict[int, float]:
    """Event number -> when it was written, in s since the epoch; whatever can be read."""
    found: dict[int, float] = {}
    try:
        lines = (folder / TIMES).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return found
    for line in lines:
        try:
            one = json.loads(line)
            found[int(one["number"])] = float(one["at"])
        except (ValueError, KeyError, TypeError):
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
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._lock = (folder / _LOCK).open("a")
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from None
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._lock.close()
            raise JournalError(f"{folder}: another process is running this campaign; one at a time") from None
        path = folder / JOURNAL
        try:
            self._past, whole = _events(path) if path.exists() else ((), 0)
        except JournalError:
            self._lock.close()
            raise
        self._file = path.open("ab")
        self._file.truncate(whole)
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
        line = json.dumps({"number": self._next, **to_plain(event)}, allow_nan=False, separators=(",", ":"))  # type: ignore[arg-type]
        try:
            self._file.write(line.encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
            self._times.write(json.dumps({"number": self._next, "at": round(time.time(), 3)}) + "\n")
            self._times.flush()
        except OSError as error:
            raise OutputError(f"{self.folder / JOURNAL}: cannot be written ({error.strerror or error})") from None


def sync_folder(folder: Path) -> None:
    """Makes the names in a folder safe on disk: a rename is, only after this."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def keep_text(path: Path, text: str) -> None:
    """Writes an artifact aside, syncs it, renames it, and syncs its folder. Raises OutputError."""
    with written_aside(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    sync_folder(path.parent)


def _events(path: Path) -> tuple[tuple[Event, ...], int]:
    """The events of a journal and the number of bytes that they take; what follows is a torn line."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise JournalError(
            f"{path}: cannot be read ({error.strerror or error}); is this a campaign's folder?"
        ) from None
    events: list[Event] = []
    whole = 0
    lines = content.split(b"\n")
    for k, line in enumerate(lines[:-1]):  # what follows the last newline was never finished
        where = f"{path}, line {k + 1}"
        try:
            plain = json.loads(line)
            if not isinstance(plain, dict) or plain.get("number") != k:
                raise ValueError
        except ValueError:
            if k == len(lines) - 2 and not lines[-1]:
                break  # the last line: a power cut may leave its length without its content
            raise JournalError(f"{where}: damaged; restore this file from a copy") from None
        events.append(from_plain(plain, where))
        whole += len(line) + 1
    return tuple(events), whole
