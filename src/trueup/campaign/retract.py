# SPDX-License-Identifier: Apache-2.0
"""Takes back what became of a trial: a stop watch misread, the wrong log dropped, a robot that was set up otherwise."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from trueup.campaign.events import TrialDone, TrialPlanned, TrialStarted
from trueup.campaign.journal import read_journal, set_back
from trueup.errors import JournalError, OutputError, RecordingError
from trueup.formats.aside import sync_folder
from trueup.recording import Recording

_OUTCOMES = ("recordings/{}.*", "recordings/{}-*.parquet", "accepted/{}")
_SHEETS = ("outbox/{}*",)


@contextmanager
def retractable(folder: Path, recordings: Sequence[Recording]) -> Iterator[None]:
    """Adds to a RecordingError which of the campaign's trials can be taken back, where it is about their recordings."""
    try:
        yield
    except RecordingError as error:
        trials = dict.fromkeys(r.provenance["trial"] for r in recordings if "trial" in r.provenance)
        named = [t for t in trials if t in str(error)] or list(trials)
        if not named:
            raise
        more = f" ({', '.join(named[1:])}: likewise)" if named[1:] else ""
        raise RecordingError(
            f"{error}. `trueup resume {folder} --retract {named[0]}` takes that run back and asks for it again{more}"
        ) from error


def retract(folder: Path, trial: str) -> tuple[Path, tuple[str, ...]]:
    """The campaign in `folder` as before a trial was run; where all that goes is kept, and the later trials that go with it.

    Those are the ones that were decided on when its outcome was known; others keep their recordings. Nothing is deleted.
    Raises JournalError for a trial that has no outcome, OutputError.
    """
    events = read_journal(folder)
    settled = [e.trial for e in events if isinstance(e, TrialDone)]
    line = next((k for k, e in enumerate(events) if isinstance(e, TrialStarted) and e.trial == trial), None)
    if line is None or trial not in settled:
        raise JournalError(
            f"{folder}: '{trial}' has no outcome to take back; trials that have: {', '.join(settled) or 'none'}"
        )
    later = tuple(e.trial for e in events[line:] if isinstance(e, TrialPlanned))
    aside = next(a for k in range(1, 1000) if not (a := folder / f"retracted-{k}").exists())
    found = [p for name in (trial, *later) for pattern in _OUTCOMES for p in sorted(folder.glob(pattern.format(name)))]
    found += [p for name in later for pattern in _SHEETS for p in sorted(folder.glob(pattern.format(name)))]
    journal = set_back(folder, line + 1)
    try:
        aside.mkdir()
        os.rename(journal, aside / journal.name)
        for path in found:
            where = aside / path.relative_to(folder).parent
            where.mkdir(exist_ok=True)
            os.rename(path, where / path.name)
        sync_folder(aside)
    except OSError as error:
        raise OutputError(f"{aside}: cannot be written ({error.strerror or error})") from None
    return aside, later
