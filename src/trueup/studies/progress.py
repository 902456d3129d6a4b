# SPDX-License-Identifier: Apache-2.0
"""Shows how far a study is: a bar in a terminal, one line a step elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn


@contextmanager
def telling(told: Console, first: str) -> Iterator[Callable[[str, float], None]]:
    """What is called with a step's words and the share of the whole that is done; `first` is said until then."""
    columns = (
        BarColumn(30),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=told, transient=True, disable=not told.is_terminal) as bar:
        task = bar.add_task(first, total=1.0)

        def tell(text: str, share: float) -> None:
            if bar.disable:
                told.print(f"{100 * share:3.0f} %  {text}", markup=False, highlight=False)
            bar.update(task, completed=share, description=text)

        yield tell
