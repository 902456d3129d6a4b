# SPDX-License-Identifier: Apache-2.0
"""What a campaign's journal records, one typed event a line; numbers are plain, so that a line holds them exactly."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from typing import Any

from trueup.errors import JournalError
from trueup.formats.plain import finite

Row = tuple[float, ...]


@dataclass(frozen=True)
class Begun:
    """The first event: which plan, which seed. Every generator is derived from the seed and from what is journaled."""

    plan: str
    """SHA-256 of the plan's text."""
    seed: int
    version: str
    unit: str = ""
    """Of the task's score."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Of the task's parameters, by name."""
    grades: tuple[str, ...] = ()
    """Of settings that are found on the robot, by how all of its runs ended, and not in a simulator: how the numbers by
    which they differ are shown, as `Grades.names` has it."""
    first: Row = ()
    """These numbers of today's settings."""
    ways: tuple[str, ...] = ()
    """In which a run may end early, as a tally counts them."""
    counts: str = ""
    """What people count of the task's score, which is minus that; '' where it is an error or a cost as it stands."""
    samples: Row = ()
    """Scores of a few settings in a few simulators, by which edits of the model or the task show; () where there are none."""
    recordings: Mapping[str, str] = field(default_factory=dict)
    """Of the plan's recordings, by name: the check sums of their files. Empty in journals of earlier versions."""


@dataclass(frozen=True)
class RoundBegun:
    """A round starts around an incumbent (unit box of the task's parameters) with a trust region of this radius."""

    round: int
    incumbent: Row
    radius: float


@dataclass(frozen=True)
class TrialPlanned:
    """A trial is decided on and about to be handed out: written before anything moves."""

    trial: str
    """'trial-001', counted through the campaign."""
    round: int
    step: str
    """'experiment', 'transfer' or 'confirm'."""
    of: str
    """The task's trial that it performs."""
    candidate: int
    """Which of the round's candidates; 0 for experiments."""
    settings: Mapping[str, float]
    repeats: int


@dataclass(frozen=True)
class TrialStarted:
    """The robot is told to perform a trial, now. Without a TrialDone after it the outcome is unknown."""

    trial: str


@dataclass(frozen=True)
class TrialDone:
    """What became of a trial: written once, after its recordings are safe."""

    trial: str
    outcome: str
    """'done', 'fell', 'aborted' or 'unknown'."""
    recordings: tuple[str, ...]
    """File names in recordings/."""
    checksums: tuple[str, ...]
    """Of the recordings' content."""
    note: str = ""


@dataclass(frozen=True)
class Scored:
    """How a candidate did on the robot: the task's score of all its trials, by repeat; NaN where one was not done."""

    round: int
    step: str
    candidate: int
    unit: Row
    """The candidate in the unit box of the task's parameters."""
    scores: Row
    fell: bool
    done: float = math.nan
    """Share of its repeats in which the task was done; NaN for a task that has scores only."""
    tally: tuple[Row, ...] = ()
    """How its runs ended, as `Graded.tally` has it; () for other tasks."""


@dataclass(frozen=True)
class Calibrated:
    """The simulator's parameters fitted to all recordings so far, and how sure they are."""

    round: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Row
    fitted: tuple[bool, ...]
    low: Row
    high: Row
    """95 % interval; NaN where not fitted."""
    verdicts: tuple[str, ...]
    covariance: tuple[Row, ...]
    """Of the fitted ones, in their units."""
    error_before: float
    error_after: float
    """Replay error of the recordings by the shipped and by the calibrated simulator, in `unit`."""
    unit: str
    recordings: tuple[str, ...]
    lacked: Mapping[str, Row] = field(default_factory=dict)
    """With a structure that the model lacks: value, low and high of each parameter, those of the structure last."""
    lacked_evidence: Row = ()
    """Gain of that structure and its standard error."""
    unasked: Mapping[str, Row] = field(default_factory=dict)
    """Of each parameter that the plan did not ask for its covariances with all of these, in their units."""
    owed: Mapping[str, Row] = field(default_factory=dict)
    """By how much each fitted parameter changes for one unit more of it."""


@dataclass(frozen=True)
class Generation:
    """What a search asked for in a round and was told; replaying these is the search's state, generator included."""

    round: int
    candidates: tuple[Row, ...]
    """In the search's own unit box."""
    losses: Row
    means: Row
    spreads: Row


@dataclass(frozen=True)
class Chosen:
    """What goes to the robot: distinct candidates (unit box of the task's parameters), as the simulator ranks them."""

    round: int
    candidates: tuple[Row, ...]
    predicted: Row
    spreads: Row
    incumbent: int
    """Which of them is the incumbent; -1 where it is not run again."""
    unsafe: int
    """Candidates that were passed over because their simulated runs go beyond the limits."""
    ended: str
    """Why the search ended, or a trial is made."""
    numbers: tuple[Row, ...] = ()
    """What the candidates' grades are, where settings are found on the robot."""


@dataclass(frozen=True)
class Validated:
    """Did the simulator, before it saw these runs, say what the robot would do?"""

    round: int
    predicted: Row
    measured: Row
    """Scores by candidate, NaN where unknown."""
    tau: float
    low: float
    high: float
    """Kendall's rank correlation with its 95 % interval; NaN with fewer than two candidates."""
    spearman: float
    tau_all: float
    low_all: float
    high_all: float
    """The same over the candidates of all rounds so far, each as the simulator of its round expected it."""
    replay_shipped: float
    replay_calibrated: float
    """Replay error of the new recordings, which this calibration never saw, in `unit`."""
    unit: str


@dataclass(frozen=True)
class RoundEnded:
    """The best so far on the robot, and what the next round may search."""

    round: int
    best: Row
    """Unit box of the task's parameters."""
    score: float
    improved: bool
    radius: float
    early: Row = ()
    """Of settings that are found on the robot: the share of runs that is expected to end early with the best, and its 95 %
    interval, by all runs so far."""


@dataclass(frozen=True)
class Ended:
    """The last event, and why."""

    reason: str
    success: bool


Event = (
    Begun | RoundBegun | TrialPlanned | TrialStarted | TrialDone | Scored | Calibrated | Generation | Chosen | Validated
    | RoundEnded | Ended
)  # fmt: skip
_KINDS = {
    kind.__name__: kind
    for kind in (Begun, RoundBegun, TrialPlanned, TrialStarted, TrialDone, Scored, Calibrated, Generation, Chosen, Validated,
                 RoundEnded, Ended)
}  # fmt: skip


def to_plain(event: Event) -> dict[str, Any]:
    """The event for JSON: its name under 'event', NaN as null."""
    return {"event": type(event).__name__, **finite(asdict(event))}


def from_plain(plain: Mapping[str, Any], where: str) -> Event:
    """The event of a line. Raises JournalError where it is none that this version knows."""
    name = plain.get("event")
    kind = _KINDS.get(name) if isinstance(name, str) else None
    given = {k: v for k, v in plain.items() if k not in ("event", "number")}
    known = {f.name: f.default is MISSING and f.default_factory is MISSING for f in fields(kind)} if kind else {}
    if kind is None or not {n for n, needed in known.items() if needed} <= set(given) <= set(known):
        raise JournalError(f"{where}: '{name}' with {', '.join(given)} was written by another version of trueup")
    return kind(**{k: _with_nan(v) for k, v in given.items()})


def _with_nan(value: Any) -> Any:
    if value is None:
        return math.nan
    if isinstance(value, dict):
        return {k: _with_nan(v) for k, v in value.items()}
    return tuple(_with_nan(v) for v in value) if isinstance(value, list) else value
