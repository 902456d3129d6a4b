# SPDX-License-Identifier: Apache-2.0
"""What a campaign is made of once its plan's names are resolved, and who is told how it goes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol

from trueup.arrays import Array
from trueup.calibration import Calibration, TracePoint
from trueup.campaign.events import Event
from trueup.discrepancies.discrepancy import Discrepancy
from trueup.engines.simulator import Simulator
from trueup.evaluation.evaluator import Evaluator, Here
from trueup.loop.earlier import Earlier
from trueup.recording import Recording
from trueup.robots.robot import Robot
from trueup.search.search import Search
from trueup.tasks.task import Task
from trueup.trial import Limits, Trial

Calibrator = Callable[
    [Sequence[Recording], Sequence[Recording], Callable[[TracePoint], None], Earlier | None], Calibration
]
"""(recordings to fit, recordings held out, progress, what the last round's left) -> Calibration; the same input gives the
same numbers."""


@dataclass(frozen=True)
class Parts:
    """The concrete things of one campaign."""

    robot: Robot
    simulator: Simulator
    task: Task
    search: Callable[[Array, int], Search]
    """(start (m,) in the search's box, seed) -> a new search."""
    calibrator: Calibrator | None
    """None: the simulator stays as it is, as unsure as its parameters' ranges."""
    recordings: tuple[Recording, ...] = ()
    """From before the campaign, to fit."""
    held_out: tuple[Recording, ...] = ()
    discrepancy: Discrepancy | None = None
    channels: tuple[str, ...] | None = None
    limits: Limits | None = None
    suited: Callable[[Sequence[Recording]], Sequence[Recording]] = tuple
    """Makes the robot's recordings what the simulator can replay: names, units, pieces."""
    later: Callable[[Sequence[Recording]], Parts] | None = None
    """The same with what the first experiment's recordings propose to calibrate; None where that is known."""
    write: Callable[[int, Calibration, Sequence[Recording]], None] | None = None
    """Writes what a round's calibration came to, fitted to these recordings; None where the simulator has no file."""
    evaluator: Evaluator = field(default_factory=Here)
    """Where candidates are simulated while the controller is tuned."""
    beside: Path | None = None
    """The plan's folder, in which what it names mostly lies; None where there is no plan's file."""


class Listener(Protocol):
    """Is told how a campaign goes, and asked what only an operator knows."""

    def saw(self, event: Event, *, fresh: bool) -> None:
        """An event, in order; `fresh` is False for those of earlier runs, which are replayed."""
        ...

    def doubt(self, words: str) -> None:
        """What looks wrong before anything moves, or in what the robot recorded; '' where nothing does."""
        ...

    def fitting(self, point: TracePoint) -> None:
        """One more step of a calibration's search."""
        ...

    def calibrated(self, round: int, calibration: Calibration) -> None:
        """A calibration is complete; its files may be written now. May be called again after an interruption."""
        ...

    def confirm(self, trials: Sequence[Trial], expected: Sequence[str]) -> None:
        """Hardware is about to move: raises TrialError unless that is allowed. `expected`: what is simulated of each."""
        ...

    def unknown(self, trial: Trial) -> Literal["repeat", "unknown"]:
        """What an interruption left of a trial on hardware is not known: perform it again, or leave it unknown?"""
        ...


class Silent:
    """A Listener for notebooks and tests: hears nothing, allows hardware to move, never repeats a trial by itself."""

    def saw(self, event: Event, *, fresh: bool) -> None:
        """Nothing."""

    def doubt(self, words: str) -> None:
        """Nothing."""

    def fitting(self, point: TracePoint) -> None:
        """Nothing."""

    def calibrated(self, round: int, calibration: Calibration) -> None:
        """Nothing."""

    def confirm(self, trials: Sequence[Trial], expected: Sequence[str]) -> None:
        """Allows it: whoever writes code has decided."""

    def unknown(self, trial: Trial) -> Literal["repeat", "unknown"]:
        """Leaves it unknown."""
        return "unknown"
