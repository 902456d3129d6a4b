# SPDX-License-Identifier: Apache-2.0
"""The recordings of a campaign: each trial's outcome is kept whole or not at all, and never twice."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from trueup.campaign.journal import keep_text, reference_file
from trueup.errors import JournalError, TrueupError
from trueup.formats import read, write
from trueup.formats.aside import sync_folder
from trueup.recording import Recording
from trueup.trial import Trial

FOLDER = "recordings"


@dataclass(frozen=True)
class Kept:
    """What became of a trial, as it lies on disk."""

    outcome: str
    """'done', 'fell', 'aborted' or 'unknown'."""
    files: tuple[str, ...]
    checksums: tuple[str, ...]
    note: str


class Store:
    """recordings/trial-001.parquet and, written last, trial-001.json, which says that all of it is there."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder / FOLDER
        self._folder.mkdir(parents=True, exist_ok=True)

    def keep(self, trial: Trial, of: str, outcome: str, recordings: Sequence[Recording], note: str = "") -> Kept:
        """Writes a trial's recordings, then its outcome; when this returns they are safe. Raises OutputError."""
        files, sums = [], []
        for k, recording in enumerate(recordings):
            name = trial.name if len(recordings) == 1 else f"{trial.name}-{k + 1}"
            told = {"trial": trial.name, "trial of": of, "settings": json.dumps(dict(trial.settings))}
            kept = recording.replace(name=name, provenance={**recording.provenance, **told})
            write(kept, self._folder / f"{name}.parquet")
            files.append(f"{name}.parquet")
            sums.append(checksum(kept))
        sync_folder(self._folder)
        result = Kept(outcome, tuple(files), tuple(sums), note)
        keep_text(self._outcome(trial.name), json.dumps(vars(result)))
        return result

    def keep_references(self, trial: Trial, of: str) -> None:
        """Writes what a trial follows, once for each of the task's trials, for whoever looks at it later."""
        for name, reference in trial.references.items():
            path = reference_file(self._folder.parent, of, name)
            if not path.exists():
                head = ",".join(reference.columns)
                rows = [",".join(f"{v:.9g}" for v in row) for row in reference.values]
                keep_text(path, "\n".join([head, *rows]) + "\n")

    def outcome(self, trial: str) -> Kept | None:
        """The outcome of a trial that has one. Raises JournalError where its file is damaged."""
        path = self._outcome(trial)
        if not path.exists():
            return None
        try:
            plain = json.loads(path.read_text(encoding="utf-8"))
            return Kept(plain["outcome"], tuple(plain["files"]), tuple(plain["checksums"]), plain["note"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise JournalError(f"{path}: damaged ({error}); restore it from a copy") from None

    def check_settings(self, trial: Trial, kept: Kept) -> None:
        """Raises JournalError where what lies there was performed with other settings than the trial asks for."""
        for file, expected in zip(kept.files, kept.checksums, strict=True):
            performed = json.loads(self.read(file, expected).provenance.get("settings", "{}"))
            if performed != dict(trial.settings):
                raise JournalError(
                    f"{self._folder / file}: performed with {performed}, where '{trial.name}' asks for "
                    f"{dict(trial.settings)}; move {trial.name}* out of {self._folder} to have it performed"
                )

    def read(self, file: str, expected: str) -> Recording:
        """A recording kept before. Raises JournalError where it is gone or no longer what was recorded."""
        path = self._folder / file
        try:
            (recording,) = read(path)
        except TrueupError as error:
            raise JournalError(f"{path}: the campaign's recording cannot be read: {error}") from None
        if checksum(recording) != expected:
            raise JournalError(f"{path}: changed since it was recorded; restore it from a copy")
        return recording

    def _outcome(self, trial: str) -> Path:
        return self._folder / f"{trial}.json"


def checksum(recording: Recording) -> str:
    """SHA-256 of what was measured."""
    return hashlib.sha256(b"".join(recording.content())).hexdigest()
