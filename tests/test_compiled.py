# SPDX-License-Identifier: Apache-2.0
"""What compiling takes is no part of a search's time, and is said once."""

from __future__ import annotations

import time

import pytest

from trueup import compiled


def test_the_clock_stands_while_a_loop_is_compiled() -> None:
    def inner(x: float) -> float:
        return x + 1.0

    def outer(x: float) -> float:
        return inner(x) * 2.0

    inner = compiled.njit(inner)
    began, clock = time.perf_counter(), compiled.clock()
    assert compiled.njit(outer)(1.0) == 4.0
    assert compiled.clock() - clock < 0.5 * (time.perf_counter() - began)


def test_a_user_is_told_once_why_nothing_happens(recwarn: pytest.WarningsRecorder) -> None:
    listener = compiled._Compiling()
    listener.seconds = 10.0
    for _ in range(2):
        listener.on_start(None)
        listener.on_end(None)
    assert [str(w.message) for w in recwarn] == [
        "inner loops are compiled for this machine, once: that takes up to a minute"
    ]
