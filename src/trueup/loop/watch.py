# SPDX-License-Identifier: Apache-2.0
"""Who watches a search: counts, times and reports what it does, and keeps it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from trueup.calibration import TracePoint
from trueup.loop.problem import Problem
from trueup.parameters import ParameterSpace

Progress = Callable[[TracePoint], None]  # told each step, and the last again while more is simulated
Checkpoint = Callable[[dict[str, Any]], None]


@dataclass
class Watch:
    """Counts, times and reports what a search does, and saves it."""

    progress: Progress | None = None
    checkpoint: Checkpoint | None = None
    waiting: tuple[str, ...] = ()  # structures that have not been asked about yet
    entered: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Structures that entered at a coarser step, with the names of their parameters."""
    bare: Sequence[float] = ()  # (n,) values of the fit before these entered
    began: float = field(default_factory=time.perf_counter)
    trace: list[TracePoint] = field(default_factory=list)
    last: TracePoint | None = None

    def saw(self, stage: str, problem: Problem, loss: float, rmse: float) -> None:
        """One more point of the search trace."""
        self.trace.append(self.begins(stage, problem, loss, rmse))

    def begins(self, stage: str, problem: Problem, loss: float, rmse: float) -> TracePoint:
        """Reports where a search stands that is none of the trace, as one for how long its windows may be."""
        passed = time.perf_counter() - self.began
        self.last = TracePoint(stage, problem.evaluations, float(loss), float(rmse), passed, problem.duration)
        if self.progress is not None:
            self.progress(self.last)
        return self.last

    def goes_on(self, evaluations: int) -> None:
        """Reports that more is simulated, while nothing better is known: no point of the trace."""
        if self.progress is not None and self.last is not None:
            passed = time.perf_counter() - self.began
            self.progress(replace(self.last, evaluations=evaluations, seconds=passed))

    def aside(self) -> Watch:
        """The same for a trial, from which no interrupted search may go on."""
        return replace(self, checkpoint=None)

    def save(self, stage: str, space: ParameterSpace, state: dict[str, Any]) -> None:
        """Hands the state of the search to the checkpoint, what is held and where included."""
        if self.checkpoint is not None:
            frozen = {p.name: p.nominal for p in space.parameters if p.frozen}
            entered = {structure: list(names) for structure, names in self.entered.items()}
            kept = {"stage": stage, "frozen": frozen, "waiting": self.waiting, "entered": entered}
            self.checkpoint({**kept, "bare": list(self.bare), "search": state})
