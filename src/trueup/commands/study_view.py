# SPDX-License-Identifier: Apache-2.0
"""A study in a terminal: how its searches go, and what the robot gained."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import TaskID
from rich.table import Table

from trueup.commands.console import table_of
from trueup.commands.progress import bar

if TYPE_CHECKING:
    from trueup.studies.stanley.study import Study


@contextmanager
def searching(console: Console) -> Iterator[Callable[[str, int, int, float], None]]:
    """What is called with (stage, trials done, all trials, best loss); a bar for each stage, nothing where not a terminal."""
    with bar(console) as shown:
        tasks: dict[str, TaskID] = {}

        def watch(stage: str, done: int, total: int, best: float) -> None:
            if stage not in tasks or done == 1:
                for gone in tasks.values():
                    shown.remove_task(gone)
                tasks.clear()
                tasks[stage] = shown.add_task(stage, total=total, said="")
            shown.update(tasks[stage], completed=done, said=f"{done}/{total}, best {1e3 * best**0.5:.1f} mm rms")

        yield watch


def study_table(study: Study) -> Table:
    """One row for each way: the robot's true distance from its path, and what it took."""
    table = table_of("", "distance", "less by", "runs on the robot", "simulated runs",
                     caption="the robot's true distance from its path, rms")  # fmt: skip
    initial, paper, rounds = study.errors
    searched = len(study.paper.calibration.losses) + len(study.paper.tuning.losses)
    rows = (("initial gains", initial, 1, ""), ("calibrated once, three gains (the paper)", paper, 2, str(searched)),
            ("in rounds, under doubt, with lead", rounds, len(study.rounds.trials), ""))  # fmt: skip
    for name, error, runs, simulated in rows:
        less = "" if error is initial else f"{100.0 * (1.0 - error / initial):.1f} %"
        table.add_row(name, f"{1e3 * error:.1f} mm", less, str(runs), simulated)
    return table
