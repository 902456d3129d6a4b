# SPDX-License-Identifier: Apache-2.0
"""What a task must offer: the controller's parameters, the trials that show how good they are, and a score."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from trueup.arrays import Array, Mask
from trueup.controllers.controller import Controller
from trueup.ends import Ended, end_of
from trueup.engines.simulator import Rollout, Simulator
from trueup.errors import ParameterError, RecordingError
from trueup.evaluation.evaluator import Evaluator, Here, Outcome, Work
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.trial import Observed, Trial
from trueup.watched_run import is_watched, watched_run


class Task(Protocol):
    """What is wanted of a robot. The same score judges simulations and recordings of the robot."""

    @property
    def name(self) -> str:
        """For reports."""
        ...

    @property
    def parameters(self) -> ParameterSpace:
        """What may be tuned: (m,) values of the controller; the nominal ones are what the robot runs with today."""
        ...

    @property
    def trials(self) -> tuple[Trial, ...]:
        """The runs that show how good a candidate is; one or several paths, loads, starts."""
        ...

    def controllers(self, values: Array) -> Controller:
        """The controller of b copies with parameters (b, m); it learns at its reset which trial it is in."""
        ...

    def score(self, rollouts: Sequence[Rollout]) -> Array:
        """(b,) lower is better, from one Rollout of b rows for each of `trials`, in their order; NaN where one failed.

        A run that ended before its time (`Rollout.ends`) has a score: its samples after the end are NaN, and what it means
        that the robot fell or arrived is for the task to say.
        """
        ...


@runtime_checkable
class ScoredIn(Protocol):
    """A task whose score has a unit, for reports."""

    @property
    def unit(self) -> str:
        """Of the score: 'm', 'rad', 's', ..."""
        ...


@runtime_checkable
class Counts(Protocol):
    """A task whose score is minus something that people count: a speed, a way made good. Reports and plans speak of that."""

    @property
    def counts(self) -> str:
        """What that is, for reports: 'speed', 'way made good'."""
        ...


@runtime_checkable
class Plans(Protocol):
    """A task whose candidates are motions: it says which commands a candidate means, for robots that play commands."""

    def planned(self, candidate: Array) -> tuple[Trial, ...]:
        """The task's trials, in their order, with the command channel of one candidate (m,)."""
        ...


@runtime_checkable
class DoneOrNot(Task, Protocol):
    """A task that is done or not, whatever its score: what seems to do it can be confirmed."""

    def succeeded(self, rollouts: Sequence[Rollout]) -> Mask:
        """(b,) from one Rollout of b rows for each of the task's trials, by simulations and recordings alike."""
        ...


@runtime_checkable
class Doubts(Protocol):
    """A task that says what of a robot's runs is not as its score takes it."""

    def doubts(self, rollouts: Sequence[Rollout]) -> tuple[tuple[str, ...], ...]:
        """For each of the task's trials one sentence for each of its runs that is to be doubted."""
        ...


@dataclass(frozen=True, eq=False)
class Grades:
    """Settings that differ by few numbers, as how bold and how inclined, and what is believed of them before a robot has run.

    A run is worth something, or it ends early in one of w ways. Log odds of these and the logarithm of that worth are linear
    in c features; a priori their coefficients are normal, each by itself. The first grade is what the robot runs with today.
    """

    names: tuple[str, ...]
    """Of the k numbers, as `str.format` shows one: '{:.3g} times as long'."""
    numbers: Array
    """(g, k), gentle ones first."""
    settings: Array
    """(g, m) of the task's parameters."""
    features: Array
    """(2, g, c) of runs that begin at rest, and of those that go on from one before."""
    places: Array
    """(g, k): a trial is no farther than 1 in any of these from one that was made."""
    ways: tuple[str, ...]
    risks: tuple[Array, Array]
    """(w, c) means and deviations of the coefficients of log odds."""
    worth: tuple[Array, Array]
    """(c,) the same of the logarithm of what a run is worth that does not end early."""
    scatter: float
    """Deviation of that logarithm from run to run."""
    cost: float
    """What an early end costs, in the unit of the worth."""


@runtime_checkable
class Graded(Protocol):
    """A task whose settings can be found on the robot itself, by how its runs end: bolder ones are worth more and riskier."""

    def grades(self) -> Grades:
        """Raises ParameterError where the task's parameters are others than it knows grades of."""
        ...

    def tally(self, rollouts: Sequence[Rollout]) -> Array:
        """(2, 2 + w) of all rows: runs that begin at rest, and that went on: how many were worth something, the sum of
        the logarithms of that, and how many ended in each way (half of one where two are as likely).
        """
        ...


def unit_of(task: Task) -> str:
    """The unit of a task's score; '' where it has none."""
    return task.unit if isinstance(task, ScoredIn) else ""


def counted_by(task: Task) -> str:
    """What people count of a task's score, which is minus that; '' where it is an error or a cost as it stands."""
    return task.counts if isinstance(task, Counts) else ""


def simulated_scores(
    task: Task, simulator: Simulator, model: Array, candidates: Array, evaluator: Evaluator | None = None
) -> Array:
    """(p, b) scores of candidates (b, m) under each model: values (p, n) or (n,) of the simulator's parameters.

    All models x candidates are rows of one evaluation, here where no `evaluator` says where.
    """
    return simulated(task, simulator, model, candidates, evaluator)[0]


def simulated(
    task: Task, simulator: Simulator, model: Array, candidates: Array, evaluator: Evaluator | None = None
) -> tuple[Array, Mask]:
    """`simulated_scores`, and (p, b) which of the runs did what the task wants (never where it cannot say)."""
    models, tried = np.atleast_2d(model), np.atleast_2d(candidates)
    if tried.shape[1] != len(task.parameters):
        raise ParameterError(f"task '{task.name}' has {len(task.parameters)} parameters, got {tried.shape[1]}")
    rows = np.concatenate([np.repeat(models, len(tried), axis=0), np.tile(tried, (len(models), 1))], axis=1)
    found = (evaluator or Here()).evaluate(judgement(task, simulator), rows).values.reshape(len(models), len(tried), 2)
    return found[:, :, 0], (found[:, :, 1] == 1.0) & np.isfinite(found[:, :, 0])


def judgement(task: Task, simulator: Simulator, trials: Sequence[Trial] | None = None) -> Work:
    """The work of scoring rows of models' and candidates' values in the task's trials, or in others of their kind.

    It gives (b, 2): scores, NaN where a simulation failed, and whether the task was done (1, or 0), NaN where it cannot say.
    """
    runs = tuple(task.trials if trials is None else trials)
    kind = f"{task.name} in {simulator.name}, {sum(t.duration for t in runs):g} s in steps of {simulator.step:g} s"
    return Work(judged, (task, simulator, runs), 2, kind)


def judged(task: Task, simulator: Simulator, trials: Sequence[Trial], rows: Array, first: int) -> Outcome:
    """See `judgement`; rows (b, n + m) from number `first` of all on."""
    rollouts = simulator.rollout([t.from_row(first) for t in trials], rows, task.controllers)
    scores = np.array(task.score(rollouts), dtype=np.float64)
    if scores.shape != (len(rows),):
        raise ParameterError(f"task '{task.name}' gave scores of shape {scores.shape} for {len(rows)} candidates")
    failures = {row: why for r in reversed(rollouts) for row, why in r.failures.items()}
    scores[sorted(failures)] = np.nan  # what is left of a failed run is no run
    done = np.full(len(rows), np.nan)
    if isinstance(task, DoneOrNot):
        done[:] = task.succeeded(rollouts)
    failures |= {r: "the task's score is NaN" for r in np.flatnonzero(np.isnan(scores)).tolist() if r not in failures}
    return Outcome(np.stack([scores, done], axis=1), failures)


def robot_trials(task: Task, candidate: Array, label: str = "") -> tuple[Trial, ...]:
    """The task's trials with the controller set to one candidate (m,), ready for `Robot.perform`.

    `label` is put after each trial's name, so that recordings of several candidates can be told apart.
    """
    settings = dict(zip(task.parameters.names, (float(v) for v in candidate), strict=True))
    trials = task.planned(candidate) if isinstance(task, Plans) else task.trials
    tuned = task.parameters.parameters
    return tuple(dataclasses.replace(t, name=t.name + label, settings=settings, tuned=tuned) for t in trials)


def robot_scores(task: Task, recordings: Sequence[Sequence[Recording]], candidate: Array | None = None) -> Array:
    """(b,) scores of what the robot did: for each of the task's trials its b repeats, by the task's own score.

    `candidate` (m,) is what was tried, for scores that depend on it.
    """
    return task.score(_rollouts(task, recordings, candidate))


def robot_done(task: Task, recordings: Sequence[Sequence[Recording]], candidate: Array | None = None) -> float:
    """Share of the repeats in which the robot did the task; NaN for a task that has scores only. See `robot_scores`."""
    if not isinstance(task, DoneOrNot):
        return float("nan")
    return float(np.mean(task.succeeded(_rollouts(task, recordings, candidate))))


def robot_tally(task: Task, recordings: Sequence[Sequence[Recording]]) -> Array:
    """What `Graded.tally` says of what the robot did, () of another task. See `robot_scores`."""
    if not isinstance(task, Graded):
        return np.zeros(0)
    return task.tally(_rollouts(task, recordings, None))


def robot_doubts(
    task: Task, recordings: Sequence[Sequence[Recording]], candidate: Array | None = None
) -> tuple[tuple[str, ...], ...]:
    """What is to be doubted in what the robot did, for each of the task's trials; see `robot_scores`."""
    return task.doubts(_rollouts(task, recordings, candidate)) if isinstance(task, Doubts) else ()


def _rollouts(task: Task, recordings: Sequence[Sequence[Recording]], candidate: Array | None) -> list[Rollout]:
    return [as_rollout(t, r, candidate) for t, r in zip(task.trials, recordings, strict=True)]


def as_rollout(trial: Trial, recordings: Sequence[Recording], candidate: Array | None = None) -> Rollout:
    """Recordings of one trial in the shape of a rollout: one row a recording, read off at the trial's instants.

    Each recording's clock is moved so that it begins at the trial's start. Instants after its end are NaN; where that is an
    end before its time (as the robot's driver says, or by the trial's own conditions), the rollout says so. Of a run that
    people watched all are NaN, and the rollout has what they told. `candidate`
    (m,) are the controller's parameters with which they were made, where these are known.
    Raises RecordingError where there is none, UnknownNameError where a recording lacks an observed channel.
    """
    if not recordings:
        raise RecordingError(f"trial '{trial.name}' has no recording")
    channels = {name: np.stack([_read(r, trial, name, o) for r in recordings]) for name, o in trial.observed.items()}
    known = ((row, r, end_of(r, trial.ends)) for row, r in enumerate(recordings))
    ends = {row: Ended(e.at - r.start + trial.start, e.name) for row, r, e in known if e is not None}
    settings = None if candidate is None else np.tile(candidate, (len(recordings), 1))
    seen = {row: watched_run(r, trial.watched) for row, r in enumerate(recordings) if trial.watched and is_watched(r)}
    rollout = Rollout(trial, channels, {}, ends, settings, seen)
    for name, values in channels.items():
        values[~rollout.lasted(name)] = np.nan
    return rollout


def _read(recording: Recording, trial: Trial, name: str, o: Observed) -> Array:
    """(T, k) one observed channel; NaN where people told what they saw in place of a log."""
    if trial.watched is not None and is_watched(recording):
        return np.full((len(o.time), len(o.labels)), np.nan)
    instants = o.time - trial.start + recording.start
    return recording.channel(name).select(o.labels).at(instants, hold=name.startswith("command"))
