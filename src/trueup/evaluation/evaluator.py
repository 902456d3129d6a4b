# SPDX-License-Identifier: Apache-2.0
"""What an evaluator must offer: work done for many rows, each by itself, wherever that is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from trueup.arrays import Array
from trueup.errors import EvaluationError


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of b rows."""

    values: Array
    """(b, width); NaN where a row has none."""
    failures: Mapping[int, str] = field(default_factory=dict)
    """Row to the reason why it has none."""


@dataclass(frozen=True, eq=False)
class Work:
    """One computation for many rows, each by itself: what a row gives does not depend on which others are computed beside it.

    `function(*parts, rows (b, n), first)` gives an Outcome of b rows, of which the first is number `first` of all; it is
    sent to other processes with `parts`, what it needs (a task, a simulator), each once.
    """

    function: Callable[..., Outcome]
    parts: tuple[Any, ...]
    width: int = 1
    kind: str = ""
    """Rows of work of one kind take about as long as each other."""

    def __call__(self, rows: Array, first: int = 0) -> Outcome:
        """Done for rows (b, n). Raises EvaluationError for an outcome of another shape."""
        done = self.function(*self.parts, rows, first)
        shape = np.shape(done.values)
        if shape != (len(rows), self.width):
            raise EvaluationError(
                f"'{self.function.__name__}' gave numbers of shape {shape} for {len(rows)} candidates, not "
                f"{(len(rows), self.width)}: one row a candidate is wanted"
            )
        return done


class Evaluator(Protocol):
    """Does work for many rows; `trueup.testing.check_evaluator` holds the contract as tests."""

    def evaluate(self, work: Work, rows: Array) -> Outcome:
        """(b, width) for rows (b, n): the same numbers wherever and however they are shared out.

        Raises what the work raises, and EvaluationError where it cannot be done.
        """
        ...

    def close(self) -> None:
        """Lets go of what it holds, until the next evaluation."""
        ...


class Here:
    """An Evaluator that does all rows at once in this process, with as many threads as the work takes."""

    def evaluate(self, work: Work, rows: Array) -> Outcome:
        """See Evaluator."""
        return work(rows)

    def close(self) -> None:
        """Holds nothing."""
