# SPDX-License-Identifier: Apache-2.0
"""Shows how far a study is: a bar in a terminal, one line a step elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console

from trueup.commands.progress import bar


@contextmanager
def telling(told: Console, first: str) -> Iterator[Callable[[str, float], None]]:
    """What is called with a step's words and the share of the whole that is done; `first` is said until then."""
    with bar(told) as shown:
        task = shown.add_task("", total=1.0, said=first)

        def tell(text: str, share: float) -> None:
            if shown.disable:
                told.print(f"{100 * share:3.0f} %  {text}", markup=False, highlight=False)
            shown.update(task, completed=share, said=text)

        yield tell
