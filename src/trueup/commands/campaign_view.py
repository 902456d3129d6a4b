# SPDX-License-Identifier: Apache-2.0
"""Shows how a campaign goes: a line for each step, the best so far and the time left while something is computed."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Literal

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.prompt import Confirm, Prompt

from trueup.calibration import Calibration, TracePoint
from trueup.campaign.events import (
    Calibrated,
    Chosen,
    Ended,
    Event,
    Generation,
    RoundEnded,
    Scored,
    TrialDone,
    TrialStarted,
    Validated,
)
from trueup.campaign.history import History, astray, mean_known
from trueup.campaign.plan import Plan
from trueup.commands.console import notes, tell
from trueup.commands.progress import Watcher
from trueup.errors import TrialError, counted, listed
from trueup.report.numbers import duration_text
from trueup.report.report import write_report
from trueup.verdicts import ROUGH

Unknown = Literal["ask", "repeat", "leave"]


class CampaignView:
    """A Listener for terminals: lines to `console`, asks before hardware moves, writes each calibration's report."""

    def __init__(
        self,
        console: Console,
        plan: Plan,
        folder: Path,
        *,
        quiet: bool = False,
        yes: bool = False,
        unknown: Unknown = "ask",
    ) -> None:
        self.history = History()
        self._console, self._plan, self._folder = console, plan, folder
        self._quiet, self._yes, self._unknown = quiet, yes, unknown
        self._bar: Progress | None = None
        self._fit: Watcher | None = None
        self._began = self._first = time.perf_counter()
        self._rounds = 0

    def __enter__(self) -> CampaignView:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._rest()

    def saw(self, event: Event, *, fresh: bool) -> None:
        """See Listener."""
        self.history.add(event)
        if not fresh or self._quiet:
            return
        if isinstance(event, Generation):
            self._searching()
            return
        self._rest()
        for line in self._lines(event):
            tell(self._console, line)

    def doubt(self, words: str) -> None:
        """See Listener."""
        notes(self._console, [words] if words else [], quiet=self._quiet)

    def fitting(self, point: TracePoint) -> None:
        """See Listener."""
        if self._quiet:
            return
        if self._fit is None:
            self._fit = Watcher(self._console, "", quiet=not self._console.is_terminal)
            self._fit.__enter__()
        self._fit(point)

    def calibrated(self, round: int, calibration: Calibration) -> None:
        """See Listener: round-1/calibration.html."""
        self._rest()
        at = self._folder / f"round-{round}"
        write_report(calibration, at / "calibration.html", title=f"{self._plan.name}, calibration of round {round}")

    def confirm(self, trials: Sequence[object], expected: Sequence[str]) -> None:
        """See Listener: shows what is about to move, and asks."""
        self._rest()
        count = "one trial" if len(trials) == 1 else f"{len(trials)} trials"
        limited = "within the limits of the plan" if self._plan.limits.limits() else "and the plan sets no limits"
        tell(self._console, f"[bold]the robot is about to perform {count}[/], {limited}:")
        for line in expected:
            tell(self._console, f"  {escape(line)}")
        if self._yes:
            return
        if not self._console.is_terminal:
            raise TrialError("nobody can be asked whether the robot may move; say so with --yes")
        if not Confirm.ask("go?", console=self._console, default=False):
            raise TrialError("not allowed to move the robot; `trueup resume` asks again")

    def unknown(self, trial: object) -> Literal["repeat", "unknown"]:
        """See Listener: asks what became of a trial, unless the command line has said it."""
        name = getattr(trial, "name", "a trial")
        said = self._unknown
        if said == "ask":
            if not self._console.is_terminal:
                raise TrialError(
                    f"{name} was interrupted, and the robot cannot say what became of it: look, then resume with "
                    "--unknown repeat (perform it again) or --unknown leave (go on without it)"
                )
            asked = f"{name} was interrupted on the robot. Perform it again, or leave it unknown?"
            said = Prompt.ask(asked, console=self._console, choices=["repeat", "leave"])
        return "repeat" if said == "repeat" else "unknown"

    def simulated(self, scored: int, rows: int, workers: int) -> None:
        """How far a cluster is with a generation."""
        if (bar := self._opened()) is not None:
            bar.update(self._task, where=f", {scored} of {rows} simulations on {counted(workers, 'worker')}")

    def _opened(self) -> Progress | None:
        """The bar of a search; None where nobody looks."""
        if self._bar is None and self._console.is_terminal and not self._quiet:
            self._began = time.perf_counter()
            self._bar = Progress(
                SpinnerColumn(), TextColumn("[bold]{task.description}"), BarColumn(24),
                TextColumn("{task.fields[said]}{task.fields[where]}"), TimeElapsedColumn(), console=self._console,
                transient=True,
            )  # fmt: skip
            title, whole = f"round {len(self.history.rounds)}  optimize", self._plan.optimize.evaluations
            self._task = self._bar.add_task(title, total=whole, said="", where="")
            self._bar.start()
        return self._bar

    def _searching(self) -> None:
        now, whole = self.history.rounds[-1], self._plan.optimize.evaluations
        if (bar := self._opened()) is None:
            return
        done, spent = min(now.tried, whole), time.perf_counter() - self._began
        left = f", about {duration_text(math.ceil(spent * (whole - done) / done))} left" if spent > 2.0 else ""
        bar.update(self._task, completed=done, said=f"best so far {now.best_simulated:.4g}{left}")

    def _rest(self) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
        if self._fit is not None:
            self._fit.__exit__(None, None, None)
            self._fit = None

    def _lines(self, event: Event) -> list[str]:
        head = f"round {len(self.history.rounds)} of {self._plan.stop.rounds}"
        match event:
            case TrialStarted():
                return []
            case TrialDone():
                note = "; ".join(event.note.splitlines())  # one of each repeat
                return [_line(head, "robot", ": ".join(filter(None, (f"{event.trial} {event.outcome}", note))))]
            case Scored(step="experiment"):
                return [
                    _line(head, "experiment", f"settings {event.candidate + 1}: {self._scores(event)} on the robot")
                ]
            case Scored(step="confirm"):
                return [_line(head, "confirm", f"the best, once more: {self._scores(event)} on the robot")]
            case Calibrated():
                return [_line(head, "calibrate", line) for line in calibration_words(event)]
            case Chosen():
                return [_line(head, "optimize", self._chosen_words(event))]
            case Scored():
                return [_line(head, "transfer", self._transfer_words(event))]
            case Validated():
                return [_line(head, "validate", line) for line in validation_words(event)]
            case RoundEnded():
                first, change = self.history.shown(self.history.first_score), self.history.change(event.score)
                share = f" ({100 * change:+.0f} %)" if math.isfinite(change) else ""
                before = f"{first:.4g} at first -> " if math.isfinite(first) else ""
                now = (
                    f"{self.history.score(event.score)} on the robot"
                    if math.isfinite(event.score)
                    else "no run has a score"
                )
                words = f"{before}{now}{share}{self._left()}"
                return [_line(head, "best so far", words)]
            case Ended():
                return [f"[bold]{'[green]' if event.success else ''}{escape(event.reason)}[/]"]
        return []

    def _scores(self, event: Scored) -> str:
        known = [x for x in event.scores if math.isfinite(x)]
        if not known:
            return "fell" if event.fell else "no score"
        early = [way for way, n in self.history.early([event]).items() if n]
        mean = self.history.score(mean_known(known)) + (f" (mean of {len(known)})" if len(known) > 1 else "")
        if early:
            return f"{' or '.join(early)}, {mean}"
        if math.isnan(event.done):
            return mean
        return (
            f"{mean}, {'done' if event.done == 1.0 else 'not done' if not event.done else f'done in {event.done:.0%}'},"
        )

    def _left(self) -> str:
        """About how long the rounds that are left will take, from those that this process has seen."""
        self._rounds += 1
        left = self._plan.stop.rounds - len(self.history.rounds)
        each = (time.perf_counter() - self._first) / self._rounds
        return f"; at most about {duration_text(math.ceil(each * left))} left" if left and each > 1.0 else ""

    def _chosen_words(self, event: Chosen) -> str:
        if event.numbers:
            return f"{self.history.grade(event.numbers[0])}: {event.ended}"
        tried = self.history.rounds[-1].tried
        new = [p for k, p in enumerate(event.predicted) if k != event.incumbent]
        now = f", now {self.history.shown(event.predicted[event.incumbent]):.4g}" if event.incumbent >= 0 else ""
        unsafe = f"; {event.unsafe} were beyond the limits" if event.unsafe else ""
        best = f"best {self.history.score(min(new))}{now}; " if new else ""
        return f"{tried} candidates simulated: {best}{len(new)} distinct ones go to the robot{unsafe}"

    def _transfer_words(self, event: Scored) -> str:
        picked = self.history.rounds[-1].chosen
        said = f"{self.history.shown(picked.predicted[event.candidate]):.4g} expected, " if picked else ""
        which = "as before" if picked and event.candidate == picked.incumbent else f"candidate {event.candidate}"
        return f"{which}: {said}{self._scores(event)} on the robot"


def calibration_words(event: Calibrated) -> list[str]:
    """What a calibration found, a line each: the replay error, the parameters with their intervals, and what is not known."""
    rows = zip(event.names, event.values, event.low, event.high, event.units, event.fitted, event.verdicts, strict=True)
    fitted = [(row, word not in ROUGH) for *row, asked, word in rows if asked]
    found = [
        f"{n} {v:.4g} [{lo:.4g}, {h:.4g}] {u if u != '1' else ''}".rstrip() for (n, v, lo, h, u), sure in fitted if sure
    ]
    rough = [name for (name, *_), sure in fitted if not sure]
    return [
        f"replay error {event.error_before:.4g} -> {event.error_after:.4g} {event.unit} "
        f"on {counted(len(event.recordings), 'recording')}",
        *([listed(found)] if found else []),
        *([f"known roughly or not at all: {listed(rough)}"] if rough else []),
    ]


def validation_words(event: Validated) -> list[str]:
    """How well the simulator foretold what it had not seen."""
    lines = []
    if math.isfinite(event.tau):
        pooled = (
            f"; all so far {event.tau_all:.2f} [{event.low_all:.2f}, {event.high_all:.2f}]" if event.round > 1 else ""
        )
        lines.append(
            f"robot ranks the candidates as expected: tau {event.tau:.2f} [{event.low:.2f}, {event.high:.2f}]{pooled}"
        )
    if math.isfinite(event.replay_calibrated):
        lines.append(
            f"new recordings replayed to {event.replay_calibrated:.4g} {event.unit} (as shipped {event.replay_shipped:.4g})"
        )
    return [*lines, *filter(None, [astray(event)])]


def _line(head: str, step: str, words: str) -> str:
    return f"[dim]{head}[/]  [bold]{step:11}[/] {escape(words)}"
