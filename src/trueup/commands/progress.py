# SPDX-License-Identifier: Apache-2.0
"""Shows how a calibration goes: stage, replay error, evaluations, time passed and about how much is left."""

from __future__ import annotations

import math

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from trueup.calibration import WINDOWS, TracePoint
from trueup.commands.console import tell
from trueup.report.numbers import duration_text, scale_for

# Where in the whole a stage begins and ends, from runs on arms of six joints. Refits come after the full step.
_STAGES = {
    WINDOWS: (0.0, 0.1),
    "first seconds": (0.0, 0.2),
    "all": (0.05, 0.75),
    "all, coarse step": (0.2, 0.55),
    "all, full step": (0.55, 0.8),
    "structures in turn": (0.7, 0.8),
    "around the optimum": (0.8, 0.85),
    "what the model lacks": (0.85, 0.9),
    "left-out recordings": (0.9, 1.0),
    "cma-es": (0.0, 0.5),
}


_EVERY = 30.0  # s between lines of one stage where not in a terminal: a log that stands still for minutes looks hung


def bar(console: Console, *, quiet: bool = False) -> Progress:
    """A bar that goes away when it is done, with the words of `said` behind it; nothing where not in a terminal."""
    columns = (
        SpinnerColumn(),
        TextColumn("[bold]{task.description}"),
        BarColumn(24),
        TextColumn("{task.fields[said]}"),
    )
    return Progress(
        *columns, TimeElapsedColumn(), console=console, transient=True, disable=quiet or not console.is_terminal
    )


class Watcher:
    """A progress display, called with each TracePoint; where not in a terminal a line for each stage, and
    one every half minute of it; silent with `quiet`.

    Searches that begin anew, with their own count of simulations, are numbered.
    """

    def __init__(self, console: Console, unit: str, *, quiet: bool) -> None:
        self._console, self._unit, self._quiet = console, unit, quiet
        self._first: float | None = None
        self._replayed = 0.0
        self._stage, self._count, self._done, self._told = "", 0, 0.0, 0.0
        self._searches, self._evaluations, self._loss = 1, 0, math.nan
        self._bar = bar(console, quiet=quiet)
        self._task = self._bar.add_task("simulating", total=1.0, said="first replay")

    def __enter__(self) -> Watcher:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, point: TracePoint) -> None:
        """One more point of the search."""
        if self._first is None or point.replayed != self._replayed or WINDOWS == self._stage != point.stage:
            self._first, self._replayed = point.rmse, point.replayed
        if (
            point.evaluations < self._evaluations
        ):  # cars are searched from several places, and shares of them by themselves
            self._searches, self._stage, self._done = self._searches + 1, "", 0.0
        self._evaluations = point.evaluations
        fresh = point.stage != self._stage
        self._count = 0 if fresh else self._count + (point.loss != self._loss)  # else it only goes on
        self._stage, self._loss = point.stage, point.loss
        begin, end = _STAGES.get(point.stage, (0.0, 1.0))
        self._done = max(self._done, begin + (end - begin) * (1.0 - math.exp(-self._count / 4.0)))
        scale = scale_for(self._unit, [self._first, point.rmse])
        said = f"replay error {scale.text(self._first)} -> {scale.text(point.rmse)} {scale.unit}".rstrip()
        said += f" over {duration_text(point.replayed)}" if point.replayed else ""
        said += f", {point.evaluations} simulations"
        stage = f"search {self._searches}, {point.stage}" if self._searches > 1 else point.stage
        if not self._bar.disable:
            self._bar.update(self._task, completed=self._done, description=stage, said=said + self._left(point))
        elif not self._quiet and (fresh or point.seconds - self._told >= _EVERY):
            self._told = point.seconds
            tell(self._console, f"  {stage}: {said}, {point.seconds:.0f} s")

    def _left(self, point: TracePoint) -> str:
        if self._done < 0.1:
            return ""
        return f", about {duration_text(math.ceil(point.seconds * (1.0 - self._done) / self._done))} left"
