# SPDX-License-Identifier: Apache-2.0
"""A study in a terminal: how its searches go, and what the robot gained."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING

from rich.box import SIMPLE
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table

if TYPE_CHECKING:
    from trueup.studies.stanley.study import Study


class SearchWatcher:
    """Called with (stage, trials done, all trials, best loss); a bar for each stage, nothing where not a terminal."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar: Progress | None = None
        self._task: TaskID | None = None
        self._stage, self._shown = "", 0.0

    def __enter__(self) -> SearchWatcher:
        if self._console.is_terminal:
            self._bar = Progress(
                SpinnerColumn(), TextColumn("[bold]{task.description}"), BarColumn(24), MofNCompleteColumn(),
                TextColumn("{task.fields[said]}"), TimeRemainingColumn(), console=self._console, transient=True,
            )  # fmt: skip
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, stage: str, done: int, total: int, best: float) -> None:
        """One more trial."""
        if self._bar is None:
            return
        if self._task is None or stage != self._stage or done == 1:
            if self._task is not None:
                self._bar.remove_task(self._task)
            self._stage, self._task = stage, self._bar.add_task(stage, total=total, said="")
        if done < total and time.monotonic() - self._shown < 0.1:
            return
        self._shown = time.monotonic()
        self._bar.update(self._task, completed=done, said=f"best {1e3 * best**0.5:.1f} mm rms")


def study_table(study: Study) -> Table:
    """One row for each way: the robot's true distance from its path, and what it took."""
    table = Table(box=SIMPLE, caption="the robot's true distance from its path, rms", caption_justify="left")
    table.add_column("")
    for name in ("distance", "less by", "runs on the robot", "simulated runs"):
        table.add_column(name, justify="right")
    initial, paper, rounds = study.errors
    searched = len(study.paper.calibration.losses) + len(study.paper.tuning.losses)
    rows = (("initial gains", initial, 1, ""), ("calibrated once, three gains (the paper)", paper, 2, str(searched)),
            ("in rounds, under doubt, with lead", rounds, len(study.rounds.trials), ""))  # fmt: skip
    for name, error, runs, simulated in rows:
        less = "" if error is initial else f"{100.0 * (1.0 - error / initial):.1f} %"
        table.add_row(name, f"{1e3 * error:.1f} mm", less, str(runs), simulated)
    return table
