# SPDX-License-Identifier: Apache-2.0
"""Trials on the robot, each journaled before it is handed out and once it is safe: none is lost, none silently repeated."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from trueup.arrays import Array
from trueup.campaign.events import Scored, TrialDone, TrialPlanned, TrialStarted
from trueup.campaign.journal import Journal
from trueup.campaign.parts import Listener, Parts
from trueup.campaign.rehearsal import blamed
from trueup.campaign.returned import as_asked, outcome_of, recordings_of
from trueup.campaign.store import Kept, Store
from trueup.errors import RecordingError, RobotFellError, TrialAbortedError, TrialError
from trueup.inspection.standing import standing
from trueup.inspection.unmeasured import unmeasured
from trueup.loop.safety import require_safe
from trueup.loop.transfer import prepared
from trueup.recording import Recording
from trueup.robots.robot import HandsOut
from trueup.tasks.task import robot_done, robot_doubts, robot_scores, robot_tally, robot_trials
from trueup.trial import Trial
from trueup.watched_run import is_watched

E = TypeVar("E")


class Take(Protocol):
    """The next event of a kind: from the journal, or made now and journaled."""

    def __call__(self, kind: type[E], make: Callable[[], E]) -> E:
        """The event."""
        ...


class Hardware:
    """The robot as a campaign sees it: candidates in, scores out, recordings kept."""

    def __init__(self, parts: Parts, journal: Journal, folder: Path, listener: Listener, take: Take) -> None:
        self._parts, self._journal, self._listener, self._take = parts, journal, listener, take
        self._store = Store(folder)
        self._settled = {e.trial for e in journal.past if isinstance(e, TrialDone)}
        self._files: list[tuple[str, str]] = []
        self._read: dict[str, Recording] = {}
        self.planned = 0
        """Trials decided on so far."""
        self.runs = 0
        """Runs asked of the robot so far, repeats counted."""

    def recordings(self) -> list[Recording]:
        """Those of all trials that were done and logged, in the order of the trials."""
        return [r for file, expected in self._files if not is_watched(r := self._recording(file, expected))]

    def test(
        self, round_: int, step: str, units: Array, repeats: int, again: int = 0, first: int = 0
    ) -> list[Scored]:  # fmt: skip
        """Performs the task's trials with each candidate (c, m) of the unit box, and scores them; the first has this number.

        What an operator aborted is handed out again as a new trial, `again` times at most; a fall is an answer, and what
        became unknown is left so. Raises TrialError where a trial goes beyond a limit, before any is handed out.
        """
        task = self._parts.task
        rows = [robot_trials(task, row) for row in task.parameters.from_unit(units)]
        wanted = [(k, j) for k, trials in enumerate(rows) for j in range(len(trials))]
        done: dict[tuple[int, int], TrialDone] = {}
        for _ in range(1 + again):
            batch = [
                (key, *self._planned(round_, step, first + key[0], rows[key[0]][key[1]], repeats)) for key in wanted
            ]
            self._announce([trial for _, _, trial in batch if trial.name not in self._settled])
            done |= {key: self._perform(planned, trial) for key, planned, trial in batch}
            wanted = [key for key in wanted if done[key].outcome == "aborted"]
        each = len(task.trials)
        return [
            self._scored(round_, step, first + k, unit, [done[k, j] for j in range(each)], repeats)
            for k, unit in enumerate(units)
        ]

    def _planned(
        self, round_: int, step: str, candidate: int, trial: Trial, repeats: int
    ) -> tuple[TrialPlanned, Trial]:
        self.planned += 1
        self.runs += repeats
        name = f"trial-{self.planned:03d}"
        ready = dataclasses.replace(prepared(trial, self._parts.limits, repeats), name=name, performs=trial.name)
        if name not in self._settled:
            require_safe(ready)
        event = self._take(
            TrialPlanned,
            lambda: TrialPlanned(name, round_, step, trial.name, candidate, dict(trial.settings), repeats),
        )
        return event, ready

    def _announce(self, waiting: Sequence[Trial]) -> None:
        if not waiting:
            return
        if not self._parts.robot.repeatable:
            self._listener.confirm(waiting, [_words(t) for t in waiting])
        if isinstance(self._parts.robot, HandsOut):
            self._parts.robot.hand_out(waiting)

    def _perform(self, planned: TrialPlanned, trial: Trial) -> TrialDone:
        before = self._journal.replaying
        self._take(TrialStarted, lambda: TrialStarted(trial.name))
        done = self._take(TrialDone, lambda: self._outcome_of(planned, trial, interrupted=before))
        if done.outcome == "done":
            self._files += zip(done.recordings, done.checksums, strict=True)
        return done

    def _outcome_of(self, planned: TrialPlanned, trial: Trial, *, interrupted: bool) -> TrialDone:
        kept = self._store.outcome(trial.name)  # there already if the end came between keeping and journaling
        if kept is not None:
            self._store.check_settings(trial, kept)
        if kept is None and interrupted and not self._parts.robot.repeatable and self._left_unknown(trial):
            kept = self._store.keep(trial, planned.of, "unknown", (), "interrupted; nobody could say what became of it")
        if kept is None:
            kept = self._performed(planned, trial)
        return TrialDone(trial.name, kept.outcome, kept.files, kept.checksums, kept.note)

    def _left_unknown(self, trial: Trial) -> bool:
        return self._listener.unknown(trial) == "unknown"

    def _performed(self, planned: TrialPlanned, trial: Trial) -> Kept:
        self._store.keep_references(trial, planned.of)
        outcome, note, recordings = "done", "", []
        try:
            with blamed(f"{trial.name}: the robot failed, and `trueup resume` goes on from here", TrialError):
                returned = self._parts.robot.perform(trial)
            recordings = recordings_of(self._parts.robot, trial, returned)
            outcome = outcome_of(recordings)
            note = "\n".join(dict.fromkeys(r.provenance["note"] for r in recordings if "note" in r.provenance))
        except RecordingError as error:
            raise TrialError(
                f"{trial.name}: what the robot's driver made of the run is no recording: {error}. Mend the driver; "
                "`trueup resume` goes on from here"
            ) from error
        except RobotFellError as error:
            outcome, note = "fell", str(error)
        except TrialAbortedError as error:
            outcome, note = "aborted", str(error)
        if outcome == "done":
            recordings = as_asked(trial, recordings)
            _check_moved(trial, recordings)
            for words in dict.fromkeys(w for r in recordings if not is_watched(r) for w in unmeasured(trial, r)):
                self._listener.doubt(f"{trial.name}: in its recording {words}; its score may not be the robot's")
        return self._store.keep(trial, planned.of, outcome, recordings, note)

    def _scored(
        self, round_: int, step: str, candidate: int, unit: Array, done: Sequence[TrialDone], repeats: int
    ) -> Scored:
        def make() -> Scored:
            scores, share, tally = np.full(repeats, np.nan), math.nan, np.zeros(0)
            if all(d.outcome == "done" for d in done):
                runs = [[self._recording(f, c) for f, c in zip(d.recordings, d.checksums, strict=True)] for d in done]
                task, values = self._parts.task, self._parts.task.parameters.from_unit(unit)
                scores, share = robot_scores(task, runs, values), robot_done(task, runs, values)
                tally = robot_tally(task, runs)
                for d, said in zip(done, robot_doubts(task, runs, values), strict=False):
                    for words in said:
                        self._listener.doubt(f"{d.trial}: {words}")
            fell = any(d.outcome == "fell" for d in done)
            return Scored(
                round_, step, candidate, tuple(unit.tolist()), tuple(np.asarray(scores).tolist()), fell, share,
                tuple([tuple([float(x) for x in row]) for row in np.atleast_2d(tally) if len(row)]),
            )  # fmt: skip

        return self._take(Scored, make)

    def _recording(self, file: str, expected: str) -> Recording:
        if file not in self._read:
            self._read[file] = self._store.read(file, expected)
        return self._read[file]


def _check_moved(trial: Trial, recordings: Sequence[Recording]) -> None:
    """Raises TrialError where the robot stood: such a run has a score, but no calibration could go on from it."""
    for words in (w for r in recordings if not is_watched(r) and (w := standing(trial, r))):
        raise TrialError(
            f"{trial.name}: {words}, so that the run is not taken. Were its motors off, or the wrong log handed in? "
            "`trueup resume` goes on from here"
        )


def _words(trial: Trial) -> str:
    """What a trial will do, for whoever is to allow it."""
    parts = [f"{trial.name}: {trial.duration:.4g} s" + (f", {trial.repeats} times" if trial.repeats > 1 else "")]
    units = {p.name: "" if p.unit == "1" else p.unit for p in trial.tuned}
    parts += [f"{k} = {v:.5g} {units.get(k, '')}".rstrip() for k, v in trial.settings.items()]
    if trial.command is not None:
        c = trial.command
        alike: dict[str, list[str]] = {}
        for label, low, high in zip(c.labels, c.values.min(axis=0), c.values.max(axis=0), strict=True):
            alike.setdefault(f"from {low:.4g} to {high:.4g} {c.unit_of(label)}".rstrip(), []).append(label)
        parts += [f"{' and '.join(labels)} {reach}" for reach, labels in alike.items()]
    for name, r in trial.references.items():
        parts.append(f"{name} of {len(r.values)} rows")
    return ", ".join(parts)
