# SPDX-License-Identifier: Apache-2.0
"""The folder of a campaign: found or made, never another's, with all that is needed to go on in it."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trueup import files
from trueup.campaign.events import Begun, Ended, Event
from trueup.campaign.journal import JOURNAL, keep_text, read_journal, read_whole
from trueup.campaign.output import numbered
from trueup.campaign.plan import PlanFile, plan_in
from trueup.errors import JournalError, PlanError, TrueupError

PLAN, _ORIGIN = "plan.toml", "origin.json"


@dataclass(frozen=True)
class Folder:
    """Where a campaign lives. The plan that it began with is kept in it: editing the original changes nothing here."""

    path: Path
    file: PlanFile
    checksum: str
    """Of plan and seed: what makes it this campaign."""
    note: str = ""
    """Why this folder, where it is not simply the one that was asked for."""

    @classmethod
    def begin(cls, file: PlanFile, out: Path | None, seed: int | None) -> Folder:
        """The folder to run a plan in: the one that holds it unfinished, else the one that holds it ended, else a fresh one.

        What a robot has done is not asked of it again unless somebody says so: by another seed, or another `out`.

        Without `out` that is the plan's own folder where one stands in it, and one of the plan's name here elsewhere.
        `seed` replaces the plan's. Raises OutputError.
        """
        used = file if seed is None else dataclasses.replace(file, plan=dataclasses.replace(file.plan, seed=seed))
        check = _checksum(used)
        here = file.path.parent.resolve() == Path.cwd().resolve()
        asked = out if out is not None else Path(".") if here else Path(file.plan.name)
        done: Path | None = None
        for at in numbered(asked):
            state = _state(at, check)
            done = at if state == "ended" else done
            if state == "unfinished":
                return cls(at, used, check, f"going on with the campaign in {at}")
            if state == "free" and done is not None:
                why = f"the campaign of this plan in {done} has ended, so nothing is run; one more: --seed N, or --out DIR"
                return cls(done, used, check, why)
            if state == "free":
                note = _elsewhere(asked, at, used) if at != asked else ""
                made = cls(at, used, check, note)
                made._keep()
                return made
        raise PlanError(f"{asked} and 998 folders like it hold campaigns; name another with --out")

    @classmethod
    def open(cls, path: Path) -> Folder:
        """A campaign begun before. Raises JournalError where there is none, PlanError where its plan cannot be used."""
        try:
            origin = json.loads(files.text(path / _ORIGIN, JournalError))
            check = _check_of(origin)
            strange = set(origin) - {"plan", "seed", "check"}
            text = files.text(path / PLAN, JournalError)
            where, seed = Path(os.path.normpath(path / origin["plan"])), int(origin["seed"])
        except (JournalError, ValueError, KeyError, TypeError, OverflowError):
            raise JournalError(f"{path}: this is not a campaign's folder; `trueup run PLAN` makes one") from None
        if strange or origin.get("check", check) != check:
            raise JournalError(f"{path / _ORIGIN}: altered or damaged; restore it from a copy")
        file = PlanFile(plan_in(text, where), where, text)
        used = dataclasses.replace(file, plan=dataclasses.replace(file.plan, seed=seed))
        return cls(path, used, _checksum(used))

    def events(self) -> tuple[Event, ...]:
        """What its journal holds, for reading. Raises JournalError, also where it is the journal of another plan."""
        events = read_whole(self.path)
        if events and not (isinstance(events[0], Begun) and events[0].plan == self.checksum):
            raise JournalError(
                f"{self.path / JOURNAL} is not of the plan in {self.path / PLAN} with the seed in {_ORIGIN}: one of them was "
                "altered; restore it from a copy"
            )
        return events

    @property
    def ended(self) -> bool:
        """Whether its campaign has come to its end."""
        return (self.path / JOURNAL).exists() and isinstance((None, *self.events())[-1], Ended)

    def _keep(self) -> None:
        origin = os.path.relpath(self.file.path.resolve(), self.path.resolve())
        keep_text(self.path / PLAN, self.file.text)
        known = {"plan": origin, "seed": self.file.plan.seed}
        keep_text(self.path / _ORIGIN, json.dumps({**known, "check": _check_of(known)}))


def _elsewhere(asked: Path, at: Path, file: PlanFile) -> str:
    """Why a campaign goes to another folder than the one that was asked for."""
    try:
        older = Folder.open(asked)
        unfinished = not isinstance(read_journal(asked)[-1], Ended)
    except (TrueupError, IndexError):
        return f"{asked} holds another campaign, so this one goes to {at}"
    same = older.file.path.resolve() == file.path.resolve() and older.file.text != file.text
    if same and unfinished:
        return (
            f"{file.path.name} was edited since the campaign in {asked} began, so a new one begins in {at}; to go on "
            f"with the plan as it was: `trueup resume {asked}`. Runs made there may be used here: [calibrate] recordings = "
            f'["{os.path.relpath(asked / "recordings", file.path.parent)}/*.parquet"]'
        )
    return f"{asked} holds another campaign, so this one goes to {at}"


def _state(path: Path, check: str) -> str:
    """'free', 'unfinished' or 'ended' (this very campaign), or 'other'."""
    if not (path / JOURNAL).exists():
        recorded = any((path / "recordings").glob("*"))  # a folder is a campaign's from its first event on
        return "other" if recorded and not _unclaimed(path, check) else "free"
    try:
        events = read_journal(path)
    except JournalError:
        if _unclaimed(path, check):  # this very campaign: beginning it anew elsewhere would forget what the robot did
            raise
        return "other"
    if not events:
        return "free"
    if not (isinstance(events[0], Begun) and events[0].plan == check):
        return "other"
    return "ended" if isinstance(events[-1], Ended) else "unfinished"


def _unclaimed(path: Path, check: str) -> bool:
    """Whether a folder without a journal is no other campaign's, which has not begun yet."""
    try:
        return not (path / _ORIGIN).exists() or Folder.open(path).checksum == check
    except TrueupError:
        return False


def _check_of(origin: Mapping[str, Any]) -> str:
    """A check sum of what stands in a campaign's origin.json."""
    return hashlib.sha256(json.dumps([origin["plan"], origin["seed"]]).encode()).hexdigest()[:16]


def _checksum(file: PlanFile) -> str:
    return hashlib.sha256(f"{file.text}\0{file.plan.seed}".encode()).hexdigest()
