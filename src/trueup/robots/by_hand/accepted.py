# SPDX-License-Identifier: Apache-2.0
"""What was accepted of each trial: the operator's own files, moved aside whole, and an outcome written last."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from trueup.errors import OutputError
from trueup.formats.aside import kept_state, sync_folder, write_aside, written_aside

_OUTCOME, _MAPPINGS, _ASIDE = "outcome.json", "mappings", "set-aside"


@dataclass(frozen=True)
class Run:
    """One accepted log."""

    path: str
    """In the trial's folder."""
    mapping: str
    """'' where none was used, 'named' for the names of log-header.csv, else a file in mappings/."""
    checksum: str
    note: str = ""


@dataclass(frozen=True)
class Outcome:
    """What became of a trial."""

    outcome: str
    """'done', 'aborted' or 'fell'."""
    runs: tuple[Run, ...] = ()
    note: str = ""


class Accepted:
    """accepted/trial-001/: logs as they were dropped, run-N.json beside each, and outcome.json when all are there."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def outcome(self, trial: str) -> Outcome | None:
        """The outcome of a trial, None while it has none."""
        plain = kept_state(self._folder / trial / _OUTCOME)
        if plain is None:
            return None
        runs = plain["runs"] if isinstance(plain["runs"], list) else []
        return Outcome(str(plain["outcome"]), tuple(_run(r) for r in runs), str(plain["note"]))

    def runs(self, trial: str) -> list[Run]:
        """Logs accepted so far, in order."""
        found = [kept_state(p) for p in sorted((self._folder / trial).glob("run-*.json"))]
        return [_run(plain) for plain in found if plain is not None]

    def path(self, trial: str, run: Run) -> Path:
        """Where a log lies."""
        return self._folder / trial / run.path

    def mapping(self, trial: str, run: Run) -> Path | None:
        """The mapping file that it was read with."""
        return self._folder / trial / _MAPPINGS / run.mapping if run.mapping not in ("", "named") else None

    def take(self, trial: str, item: Path, mapping: Path | None, named: bool, checksum: str, note: str) -> None:
        """Moves a log in: first a copy of its mapping, then a word about the log, then, in one step, the log itself.

        The word names the log; where an interruption left the word alone, the log is still in the inbox and will be
        taken again under the same word. Raises OutputError.
        """
        folder = self._folder / trial
        count = len(self.complete(trial)) + 1
        name = _free(folder, item.name)
        kept = ""
        try:
            if mapping is not None:
                kept = f"{count}-{mapping.name}"
                with written_aside(folder / _MAPPINGS / kept) as temporary:
                    shutil.copyfile(mapping, temporary)
            run = Run(name, "named" if named else kept, checksum, note)
            _write(folder / f"run-{count}.json", vars(run))
            os.rename(item, folder / name)
            sync_folder(folder)
        except OSError as error:
            raise OutputError(f"{item}: cannot be moved to {folder} ({error.strerror or error})") from None

    def finish(self, trial: str, outcome: str, note: str) -> None:
        """Writes the outcome; after this the trial is settled."""
        runs = [vars(r) for r in self.complete(trial)] if outcome == "done" else []
        _write(self._folder / trial / _OUTCOME, {"outcome": outcome, "runs": runs, "note": note})

    def set_aside(self, trial: str, items: Sequence[Path]) -> None:
        """Moves the operator's files that do not count out of the way; nothing is deleted. Raises OutputError."""
        folder = self._folder / trial / _ASIDE
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for record in sorted((self._folder / trial).glob("run-*.json")):
                plain = kept_state(record)
                log = self._folder / trial / _run(plain).path if plain else None
                if log is not None and log.exists():
                    os.rename(log, folder / _free(folder, log.name))
                os.rename(record, folder / _free(folder, record.name))
            for item in items:
                os.rename(item, folder / _free(folder, item.name))
            sync_folder(folder)
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written ({error.strerror or error})") from None

    def checksums(self) -> dict[str, str]:
        """Checksum of every log accepted so far -> its trial."""
        return {
            run.checksum: folder.name
            for folder in sorted(self._folder.glob("trial-*")) for run in self.complete(folder.name)
        }  # fmt: skip

    def complete(self, trial: str) -> list[Run]:
        """Accepted logs that have been moved in."""
        return [r for r in self.runs(trial) if self.path(trial, r).exists()]


def _free(folder: Path, name: str) -> str:
    """A name that is not taken."""
    taken, number = name, 1
    while (folder / taken).exists():
        number += 1
        taken = f"{number}-{name}"
    return taken


def _run(plain: Mapping[str, object]) -> Run:
    return Run(str(plain["path"]), str(plain["mapping"]), str(plain["checksum"]), str(plain.get("note", "")))


def _write(path: Path, plain: dict[str, object]) -> None:
    write_aside(json.dumps(plain), path)
    sync_folder(path.parent)
