# SPDX-License-Identifier: Apache-2.0
"""A Robot that people run: each trial goes out as a folder of files, its log is waited for, checked and taken."""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from trueup.errors import RobotFellError, TrialAbortedError, TrueupError
from trueup.formats import read
from trueup.formats.aside import write_aside
from trueup.inspection.requested import as_observed, completed
from trueup.recording import Recording
from trueup.robots.by_hand.accepted import Accepted, Run
from trueup.robots.by_hand.check import fits, mismatches, one_of
from trueup.robots.by_hand.eyes import hint, told_in
from trueup.robots.by_hand.inbox import PROBLEMS, Inbox, Item
from trueup.robots.by_hand.sheet import canonical_map, write_sheet
from trueup.trial import Trial
from trueup.watched_run import is_watched


def _silent(line: str) -> None:
    """Says nothing."""


class ByHand:
    """outbox/trial-001/ holds what to run; what is dropped into inbox/ is checked and moved to accepted/trial-001/.

    The state is in these folders, so waiting may be interrupted at any time and go on the next day: `perform` of the same
    trial goes on where it was. What does not fit stays in the inbox; why is said, and written to inbox/problems.txt.
    Nothing dropped is ever deleted.

    `mapping`: how the logs' columns become channels (a mapping.toml in the inbox, or in a dropped folder, comes first).
    A file counts once it has not changed for `rest` seconds and can be read; the inbox is looked at every `poll` seconds.
    """

    def __init__(
        self, folder: Path, *, mapping: Path | None = None, say: Callable[[str], None] = _silent, poll: float = 1.0,
        rest: float = 2.0,
    ) -> None:  # fmt: skip
        self._outbox, self._inbox = folder / "outbox", folder / "inbox"
        self._mapping, self._say, self._poll = mapping, say, poll
        self._watch = Inbox(self._inbox, rest)
        self._accepted = Accepted(folder / "accepted")
        self._trials: dict[str, Trial] = {}
        self._told: set[str] = set()
        self._judged: dict[str, tuple[object, tuple[Trial, Recording, bool] | str]] = {}

    @property
    def repeatable(self) -> bool:
        """True: performing a trial again goes on waiting for it."""
        return True

    def hand_out(self, trials: Sequence[Trial]) -> None:
        """Writes the sheets of trials that have none yet, and says where they are. Raises OutputError."""
        for folder in (self._inbox, self._outbox):
            folder.mkdir(parents=True, exist_ok=True)
        waiting = []
        for trial in trials:
            self._trials[trial.name] = trial
            if self._accepted.outcome(trial.name) is None:
                waiting.append(write_sheet(trial, self._outbox, self._inbox).name)
        if waiting:
            logs = "the log" if len(waiting) == 1 else "the logs"
            seen = [name for name in waiting if self._trials[name].watched]
            if seen:
                logs = (
                    f"what you saw ({f'{seen[0]}.toml' if len(seen) == 1 else 'the .toml files'}, filled in) or {logs}"
                )
            self._say(f"run {self._outbox / _listed(waiting)} on the robot, then put {logs} into {self._inbox}/")
            self._say("waiting ... (Ctrl-C is fine: `trueup resume` goes on from here, next week if need be)")

    def perform(self, trial: Trial) -> list[Recording]:
        """Waits until the operator has dropped what the trial asks for, and returns it. See Robot for what it raises."""
        if trial.name not in self._trials:
            self.hand_out([trial])
        while True:
            self.look()
            outcome = self._accepted.outcome(trial.name)
            if outcome is None:
                time.sleep(self._poll)
                continue
            if outcome.outcome == "aborted":
                raise TrialAbortedError(outcome.note or "aborted by the operator")
            if outcome.outcome == "fell":
                raise RobotFellError(outcome.note or "the robot fell")
            return [self._read_again(trial, run) for run in outcome.runs]

    def look(self) -> None:
        """Looks once at the inbox: takes what fits, says what does not."""
        before = len(self._waiting())
        self._finish_interrupted()
        items = self._watch.rested()
        problems: dict[str, str] = {}
        logs: list[Item] = []
        for item in items:
            try:
                if item.answer:
                    self._answered(item, items)
                else:
                    logs.append(item)
            except (
                ValueError,
                FileNotFoundError,
            ) as error:  # an answer moves what belongs to it, a person moves anything
                if item.path.exists():
                    problems[item.path.name] = str(error)
        logs = [i for i in logs if i.path.exists()]
        fitting: dict[str, list[tuple[Item, Recording, bool]]] = {}
        for item in logs:
            found = self._fitting(item)
            if isinstance(found, str):
                problems[item.path.name] = found
            else:
                fitting.setdefault(found[0].name, []).append((item, found[1], found[2]))
        for name, found in fitting.items():
            problems |= self._take(self._trials[name], found)
        self._tell(problems, {i.path.name for i in items})
        left = [t.name for t in self._waiting()]
        if left and len(left) < before:
            self._say(f"still to run: {_listed(left)}")

    def _finish_interrupted(self) -> None:
        """Settles trials whose last log was moved in right before an interruption."""
        for trial in self._waiting():
            if len(self._accepted.complete(trial.name)) == trial.repeats:
                self._finish(trial)

    def _finish(self, trial: Trial) -> None:
        notes = [r.note for r in self._accepted.complete(trial.name) if r.note]
        self._accepted.finish(trial.name, "done", " ".join(notes))

    def _waiting(self) -> list[Trial]:
        return [t for t in self._trials.values() if self._accepted.outcome(t.name) is None]

    def _answered(self, item: Item, items: Sequence[Item]) -> None:
        """Takes an operator's word. Raises ValueError where it is not clear for which trial."""
        trial = self._meant(item)
        note, answer = item.note, item.answer  # read before its file is moved
        logs = [i.path for i in items if i is not item and i.trial == trial.name and i.path.exists()]
        self._accepted.set_aside(trial.name, [item.path, *logs])
        if answer != "repeat":
            self._accepted.finish(trial.name, answer, note)
        become = "to be run again" if answer == "repeat" else answer
        self._say(f"{trial.name}: {become}" + (f" ({note})" if note else ""))

    def _meant(self, item: Item) -> Trial:
        """The waiting trial that an item names, or the only one that waits. Raises ValueError."""
        waiting = {t.name: t for t in self._waiting()}
        if item.trial in waiting:
            return waiting[item.trial]
        if item.trial:
            settled = self._accepted.outcome(item.trial)
            said = f"has an outcome already ({settled.outcome})" if settled else "was not asked for"
            raise ValueError(f"{item.trial} {said}; waiting for: {', '.join(waiting) or 'nothing'}")
        if len(waiting) == 1:
            return next(iter(waiting.values()))
        raise ValueError(
            f"which trial is it? Put one of these into its name: {', '.join(waiting) or 'none is waited for'}"
        )

    def _fitting(self, item: Item) -> tuple[Trial, Recording, bool] | str:
        """The trial that a log is of, the recording, and whether it was read by the names of log-header.csv; or why not."""
        mapping = item.mapping(self._inbox) or self._mapping
        state = (item.state, mapping and mapping.stat().st_mtime_ns, tuple(t.name for t in self._waiting()))
        judged = self._judged.get(item.path.name)
        if judged is not None and judged[0] == state:
            return judged[1]  # nothing has changed since
        try:
            found = self._judge(item, mapping)
        except (TrueupError, ValueError, OSError) as error:
            found = f"{error}{hint(item.path.name, self._waiting())}"
        self._judged[item.path.name] = (state, found)
        return found

    def _judge(self, item: Item, mapping: Path | None) -> tuple[Trial, Recording, bool] | str:
        if item.empty:
            return "it is empty: still being written, or nothing was logged? It is looked at again when it has grown"
        waiting = self._waiting()
        if not waiting:
            return "no trial is waited for"
        if item.manual_result is not None:
            trial = self._meant(item)
            return trial, told_in(item.manual_result, trial).recording(trial), False
        likely = self._meant(item) if item.trial else waiting[0]
        recordings, named = self._read(item, mapping, likely)
        if len(recordings) != 1:
            return f"it holds {len(recordings)} recordings ({', '.join(r.name for r in recordings)}); drop one run at a time"
        recording = as_observed(likely, recordings[0])
        twin = self._accepted.checksums().get(_checksum(recording))
        if twin:
            return f"this log was accepted for {twin} already; is it a wrong file?"
        if item.trial or len(waiting) == 1:
            trial = self._meant(item)
            wrong = mismatches(trial, recording)
            return f"not what {trial.name} asks for: {'; '.join(wrong)}" if wrong else (trial, recording, named)
        fits = one_of(waiting, recording)
        if len(fits) == 1:
            return fits[0], recording, named
        if fits:
            return f"could be {' or '.join(t.name for t in fits)}: put the right one into its name"
        return f"not what {waiting[0].name} asks for: {'; '.join(mismatches(waiting[0], recording))}"

    def _take(self, trial: Trial, found: Sequence[tuple[Item, Recording, bool]]) -> dict[str, str]:
        """Accepts logs that fit a trial, unless there are more than runs were asked for; then says so."""
        have = len(self._accepted.complete(trial.name))
        if have + len(found) > trial.repeats:
            names = ", ".join(i.path.name for i, _, _ in found)
            asked = "one run was" if trial.repeats == 1 else f"{trial.repeats} runs were"
            return {
                i.path.name: f"{names} all fit {trial.name}, of which {asked} asked: leave only what counts here"
                for i, _, _ in found
            }  # fmt: skip
        for item, recording, named in found:
            mapping = None if named or is_watched(recording) else item.mapping(self._inbox) or self._mapping
            self._accepted.take(trial.name, item.path, mapping, named, _checksum(recording), item.note)
            self._say(
                f"{trial.name}: {item.path.name} accepted{'' if is_watched(recording) else fits(trial, recording)}"
            )
            self._tell_guesses(recording)
            have += 1
        if have == trial.repeats:
            self._finish(trial)
        return {}

    def _tell_guesses(self, recording: Recording) -> None:
        """How a log without a mapping was understood, once: an operator sees at a glance what is not so."""
        guesses = recording.provenance.get("guesses", "")
        kind = re.sub(r"[\d.]+", "", guesses)  # the next log's largest value is another, its columns are the same
        if guesses and kind not in self._told:
            self._told.add(kind)
            lines = "; ".join(guesses.splitlines())
            self._say(
                f"  as no mapping says, it was read so: {lines}. A wrong guess? Stop, and name a mapping in the plan"
            )

    def _read(self, item: Item, mapping: Path | None, trial: Trial) -> tuple[list[Recording], bool]:
        """The recordings in a log, and whether by the names of log-header.csv: where it has these and no mapping fits.

        A mapping for all logs need not fit each of them; one that was dropped with a log does, or the log is refused.
        """
        log, own = item.log(), mapping is not None and mapping.parent == item.path
        why: TrueupError | None = None
        if mapping is not None:
            try:
                return read(log, mapping), False
            except TrueupError as error:
                why = error
        if not own:
            try:
                return read(log, canonical_map(trial)), True
            except TrueupError:
                pass
        if why is not None:
            raise why
        return read(log), False

    def _read_again(self, trial: Trial, run: Run) -> Recording:
        """An accepted log as a recording of the trial."""
        item = Item(self._accepted.path(trial.name, run), ())
        mapping = self._accepted.mapping(trial.name, run)
        note = run.note
        if item.manual_result is not None:
            told = told_in(item.manual_result, trial)
            recording, note = told.recording(trial), "; ".join(filter(None, (told.words(trial), note)))
        else:
            (recording,) = read(item.log(), canonical_map(trial) if run.mapping == "named" else mapping)
        said = {"note": note} if note else {}
        return completed(trial, recording.replace(provenance={**recording.provenance, "log": run.path, **said}))

    def _tell(self, problems: dict[str, str], there: set[str]) -> None:
        """Says what is new, and keeps the list for whoever looks into the folder."""
        path = self._inbox / PROBLEMS
        text = "".join(f"{name}: {why}\n\n" for name, why in sorted(problems.items()))
        known = path.read_text(encoding="utf-8") if path.exists() else ""
        for name, why in problems.items():
            if f"{name}: {why}\n" not in known:
                self._say(f"{name} not taken: {why}")
        self._judged = {name: j for name, j in self._judged.items() if name in there}
        if text != known:
            write_aside(text, path)


def _listed(names: Sequence[str]) -> str:
    """'trial-002 ... 005' for a series, all names elsewhere."""
    first = names[0].rpartition("-")[2]
    series = [f"trial-{int(first) + k:03d}" for k in range(len(names))] if first.isdecimal() else []
    if len(names) > 2 and list(names) == series:
        return f"{names[0]} ... {names[-1].rpartition('-')[2]}"
    return ", ".join(names)


def _checksum(recording: Recording) -> str:
    return hashlib.sha256(b"".join(recording.content(units=False))).hexdigest()
