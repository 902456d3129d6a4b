# SPDX-License-Identifier: Apache-2.0
"""Bounded quasi-Newton search by ask and tell: one batch holds all finite-difference columns, the next all step lengths.

L-BFGS with projection onto the box (D. Liu and J. Nocedal, Math. Programming 45, 1989; R. Byrd et al., SIAM J. Sci.
Comput. 16(5), 1995, for the bounds).
"""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.search.search import SearchState, saved_point

_LENGTHS = (2.0, 1.0, 0.5, 0.2, 0.05, 0.01, 1e-3)
"""Steps tried side by side, in lengths of the quasi-Newton step."""


class QuasiNewton:
    """Minimises a loss that is smooth almost everywhere over the unit box, from one start."""

    def __init__(
        self, start: Array, *, difference: float = 1e-5, memory: int = 20, most: int = 300, tolerance: float = 1e-7,
        longest: float = 0.3,
    ) -> None:  # fmt: skip
        """`difference`: finite-difference step in the box; `most` iterations; `longest` change of a coordinate in one.

        It ends when three iterations in a row gain less than `tolerance` times 1 + |loss|.
        """
        self._point = np.clip(np.asarray(start, dtype=np.float64), 0.0, 1.0)
        self._difference, self._memory, self._most = difference, memory, most
        self._tolerance, self._longest = tolerance, longest
        self._loss, self._slope = np.inf, np.zeros(0)
        self._asked_slope, self._steps = True, np.zeros(0)
        self._pairs: list[tuple[Array, Array]] = []
        self._iteration, self._small, self._done = 0, 0, ""
        self._before: tuple[Array, Array] | None = None

    def ask(self) -> Array:
        """(1 + n, n) the point and its finite-difference columns, or (7, n) steps of several lengths."""
        if self._asked_slope:
            self._steps = np.where(self._point > 0.5, -1.0, 1.0) * self._difference
            return np.concatenate([self._point[None], self._point + np.diag(self._steps)])
        direction = self._direction()
        return np.clip(self._point + np.array(_LENGTHS)[:, None] * direction, 0.0, 1.0)

    def tell(self, candidates: Array, losses: Array) -> None:
        """Losses of the candidates; NaN where an evaluation failed."""
        told = np.where(np.isfinite(losses), losses, np.inf)
        if self._asked_slope:
            self._take_slope(told)
        else:
            self._take_step(candidates, told)

    @property
    def done(self) -> str:
        """Why the search has ended, or ''."""
        return self._done

    @property
    def best(self) -> tuple[Array, float]:
        """The point and its loss."""
        return self._point, self._loss

    def state(self) -> SearchState:
        """The point, its loss and what is known of the curvature."""
        return {
            "point": self._point.tolist(), "loss": self._loss if np.isfinite(self._loss) else None,
            "slope": self._slope.tolist(), "asked slope": self._asked_slope, "steps": self._steps.tolist(),
            "pairs": [[s.tolist(), y.tolist()] for s, y in self._pairs], "iteration": self._iteration,
            "small": self._small, "done": self._done,
            "before": None if self._before is None else [x.tolist() for x in self._before],
        }  # fmt: skip

    def resume(self, state: SearchState) -> None:
        """Goes on from `state`. Raises CalibrationError where it belongs to another number of parameters."""
        self._point, self._loss = (
            saved_point(state, self._point),
            np.inf if state["loss"] is None else float(state["loss"]),
        )
        self._slope, self._steps = np.asarray(state["slope"], dtype=float), np.asarray(state["steps"], dtype=float)
        self._asked_slope, self._pairs = (
            bool(state["asked slope"]),
            [(np.array(s), np.array(y)) for s, y in state["pairs"]],
        )
        self._iteration, self._small, self._done = int(state["iteration"]), int(state["small"]), str(state["done"])
        before = state["before"]
        self._before = None if before is None else (np.array(before[0]), np.array(before[1]))

    def _take_slope(self, told: Array) -> None:
        if not np.isfinite(told[0]):
            self._done = "the start cannot be evaluated"
            return
        columns = np.where(np.isfinite(told[1:]), (told[1:] - told[0]) / self._steps, 0.0)
        self._loss = float(told[0])
        if self._before is not None:
            s, y = self._point - self._before[0], columns - self._before[1]
            if s @ y > 1e-10 * np.linalg.norm(s) * np.linalg.norm(y):
                self._pairs = [*self._pairs, (s, y)][-self._memory :]
        self._slope, self._asked_slope = columns, False

    def _take_step(self, candidates: Array, told: Array) -> None:
        k = int(np.argmin(told))
        self._iteration += 1
        if told[k] < self._loss:
            gain = self._loss - float(told[k])
            self._small = self._small + 1 if gain < self._tolerance * (1.0 + abs(self._loss)) else 0
            self._before = (self._point, self._slope)
            self._point, self._loss, self._asked_slope = np.array(candidates[k]), float(told[k]), True
        elif self._pairs:
            self._pairs = []  # the curvature has misled: steepest descent from here
        else:
            self._done = "converged: no step of any length goes further down"
        if self._small >= 3:
            self._done = "converged: the last steps changed almost nothing"
        elif self._iteration >= self._most and not self._done:
            self._done = f"stopped after {self._most} iterations; more may help"

    def _direction(self) -> Array:
        """The quasi-Newton step among the coordinates that are not held by a bound."""
        held = ((self._point <= 0.0) & (self._slope > 0)) | ((self._point >= 1.0) & (self._slope < 0))
        free = ~held
        step = np.where(free, self._slope, 0.0)
        kept = [(np.where(free, s, 0.0), np.where(free, y, 0.0)) for s, y in self._pairs]
        kept = [(s, y, 1.0 / (s @ y)) for s, y in kept if s @ y > 1e-14]
        shares = []
        for s, y, r in reversed(kept):  # the two loops of Liu and Nocedal, algorithm 2.1
            shares.append(r * (s @ step))
            step = step - shares[-1] * y
        if kept:
            s, y, r = kept[-1]
            step = step / (r * (y @ y))
        for (s, y, r), share in zip(kept, reversed(shares), strict=True):
            step = step + (share - r * (y @ step)) * s
        step = -np.where(free, step, 0.0)
        if step @ self._slope >= 0:
            step = -np.where(free, self._slope, 0.0)
        size = float(np.abs(step).max())
        longest = self._longest / _LENGTHS[0]
        if not kept and size > 0:
            return step * (0.2 * longest / size)
        return step * min(1.0, longest / size) if size > 0 else step
