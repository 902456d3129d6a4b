# SPDX-License-Identifier: Apache-2.0
"""The folder that an operator drops logs and notes into: what is new, has come to rest, and belongs to which trial."""

from __future__ import annotations

import re
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from trueup.robots.by_hand.eyes import GENERAL

MAPPING, PROBLEMS, RESULT = "mapping.toml", "problems.txt", "result.toml"
ANSWERS = ("aborted", "fell", "repeat")
_TRIAL = re.compile(r"trial[-_ ]?(\d+)", re.IGNORECASE)
_ANSWER = re.compile(r"(?<![a-z])(aborted|abort|fell|fall|repeat)(?![a-z])", re.IGNORECASE)
_NOTES = (".txt", ".md", ".note", "")
_MEANS = {"abort": "aborted", "fall": "fell"}


@dataclass(frozen=True)
class Item:
    """One entry of the inbox that has come to rest."""

    path: Path
    state: tuple[tuple[str, int, int], ...]
    """Name, size and time of change of every file in it."""

    @property
    def trial(self) -> str:
        """'trial-007' where its name, or its result.toml, says so; '' elsewhere."""
        try:
            said = _TRIAL.search(self.path.name) or _TRIAL.search(str(self._result().get("trial", "")))
        except ValueError:  # unreadable: that is said where its answer is asked for
            return ""
        return f"trial-{int(said.group(1)):03d}" if said else ""

    @property
    def answer(self) -> str:
        """'aborted', 'fell' or 'repeat' where its name or its result.toml says so; '' for a log, and for what was seen.

        Raises ValueError for a result.toml that says something else or cannot be read.
        """
        result = self._result()
        outcome = str(result.get("outcome", ""))
        if result.get("aborted") is True:
            return "aborted"
        if outcome and outcome not in (*ANSWERS, "done"):
            raise ValueError(f"outcome = '{outcome}' is not one of: {', '.join((*ANSWERS, 'done'))}")
        if outcome:
            return "" if outcome == "done" else outcome
        if self.manual_result is not None and set(result) - set(GENERAL):
            return ""  # whatever its name says, as 'trial-004-fell.toml': it says more itself
        for file in [self.path] if self.path.is_file() else sorted(self.path.iterdir()):
            word = _ANSWER.search(file.name)
            said = _MEANS.get(word.group(1).lower(), word.group(1).lower()) if word else ""
            # 'trial-002-fell.csv' is a log of a fall, 'trial-002-repeat.csv' is the log of the repetition.
            if said and (_is_note(file) or said != "repeat"):
                return said
        return ""

    @property
    def manual_result(self) -> Mapping[str, object] | None:
        """What a TOML file that was dropped in place of a log says of the run; None of a log. Raises ValueError."""
        return self._result() if _is_toml(self.path) and self.path.is_file() else None

    @property
    def empty(self) -> bool:
        """Whether nothing stands in it, in none of its files: once something does, it is looked at anew."""
        return not any(size for _, size, _ in self.state)

    @property
    def note(self) -> str:
        """What the operator wrote beside it."""
        said = str(self._result().get("note", ""))
        files = [self.path] if self.path.is_file() else [f for f in sorted(self.path.iterdir()) if f.is_file()]
        texts = [_text(f) for f in files if _is_note(f)]
        return " ".join(" ".join([said, *texts]).split())

    def mapping(self, inbox: Path) -> Path | None:
        """The mapping to read it with: its own, else the inbox's."""
        own = self.path / MAPPING
        for file in (own, inbox / MAPPING):
            if file.is_file():
                return file
        return None

    def log(self) -> Path | list[Path]:
        """What is to be read: the file, or a folder's files without the notes."""
        if self.path.is_file():
            return self.path
        everything = sorted(self.path.iterdir())
        others = [f for f in everything if f.name not in (MAPPING, RESULT)]
        data = [f for f in others if not _is_note(f)] or others
        return self.path if data == everything else data

    def _result(self) -> dict[str, object]:
        file = self.path if _is_toml(self.path) else self.path / RESULT
        if not file.is_file():
            return {}
        try:
            return tomllib.loads(file.read_text(encoding="utf-8-sig"))  # some editors begin with a mark
        except (OSError, ValueError) as error:
            hint = 'as in: seconds = 14.2, with a decimal point; fell = "forward", in quotes'
            raise ValueError(f"{file.name} cannot be read as TOML ({error}); write {hint}") from None


class Inbox:
    """Watches a folder. An entry counts once none of its files has changed for `rest` seconds."""

    def __init__(self, folder: Path, rest: float) -> None:
        self._folder, self._rest = folder, rest
        self._seen: dict[str, tuple[tuple[tuple[str, int, int], ...], float]] = {}

    def rested(self) -> list[Item]:
        """What lies there and has come to rest, by name."""
        now = time.monotonic()
        found: list[Item] = []
        there: set[str] = set()
        for path in self._entries():
            state = _state(path)
            there.add(path.name)
            known = self._seen.get(path.name)
            if known is None or known[0] != state:
                self._seen[path.name] = (state, now)
                # Files copied long ago are at rest at once: after a night nobody is still writing.
                changed = max((t for _, _, t in state), default=0) * 1e-9
                known = (state, now if abs(time.time() - changed) < self._rest + 60.0 else now - self._rest)
                self._seen[path.name] = known
            if now - known[1] >= self._rest:
                found.append(Item(path, state))
        self._seen = {name: s for name, s in self._seen.items() if name in there}
        return found

    def _entries(self) -> Sequence[Path]:
        skipped = (MAPPING, PROBLEMS)
        ending = (".part", ".tmp", ".crdownload", ".partial", ".swp")
        try:
            entries = sorted(self._folder.iterdir())
        except OSError:
            return ()
        return [
            p for p in entries if p.name not in skipped and not p.name.startswith((".", "~")) and p.suffix not in ending
        ]


def _state(path: Path) -> tuple[tuple[str, int, int], ...]:
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    found = []
    for file in files:
        try:
            s = file.stat()
        except OSError:  # renamed in this moment: the next look will see it
            continue
        found.append((str(file.relative_to(path.parent)), s.st_size, s.st_mtime_ns))
    return tuple(found)


def _is_toml(file: Path) -> bool:
    """Some editors add .txt to every name."""
    return file.name.lower().endswith((".toml", ".toml.txt"))


def _is_note(file: Path) -> bool:
    ending = file.suffix.lower()
    return file.is_file() and not _is_toml(file) and (ending in _NOTES or ending.lstrip(".") in (*ANSWERS, *_MEANS))


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace")[:2000] if file.stat().st_size < 100_000 else ""
    except OSError:
        return ""
