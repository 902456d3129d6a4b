# SPDX-License-Identifier: Apache-2.0
"""Commands of a trial's controller reach drives when their delay says so, whether they were asked for or known ahead."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from trueup.arrays import Array
from trueup.articulated.closed_loop import ClosedLoop
from trueup.controllers.controller import Observation

STEP, PERIOD, DELAY = 0.002, 0.01, 0.085


class Ramp:
    """Commands the time; it knows so much of it ahead, and then has to be asked."""

    period = PERIOD

    def __init__(self, known: float) -> None:
        self._known = known

    def reset(self, observation: Observation) -> None:
        """Nothing to remember."""

    def command(self, observation: Observation) -> Array:
        """(1, 1)."""
        return np.full((1, 1), observation.time)

    def ahead(self, times: Array) -> Array | None:
        """(1, n, 1), or None after what is known."""
        return times[None, :, None] if times[-1] <= self._known else None


def _driven(known: float) -> Array:
    """What drives take in a second, looked at each 20 ms."""
    signals = SimpleNamespace(delay=np.array([[DELAY]]), lead=np.zeros(1), arriving=lambda trial, at, out, step: out)
    loop, taken = ClosedLoop(cast(Any, Ramp(known)), cast(Any, signals), 0, STEP), []
    for at in range(0, 500, 10):
        for step in range(at, at + 10):
            if step == loop.due:
                loop.ask(cast(Any, SimpleNamespace(time=step * STEP)))
                loop.foretell(at + 10)
        taken.append(loop.commands(at, 10)[0, :, 0].copy())
    return np.concatenate(taken)


def test_commands_known_ahead_for_less_than_the_delay_and_then_asked_for_arrive_as_if_all_were_asked_for() -> None:
    asked = _driven(known=0.0)
    np.testing.assert_allclose(asked[50:], (np.arange(50, 500) * STEP - DELAY) // PERIOD * PERIOD, atol=PERIOD)
    for known in (0.015, 0.03, 0.3):
        np.testing.assert_allclose(_driven(known), asked, atol=1e-12)
