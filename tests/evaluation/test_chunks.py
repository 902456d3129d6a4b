# SPDX-License-Identifier: Apache-2.0
"""Rows that are shared out: all come back once, whatever is lost, and who does harm is found at little cost."""

from __future__ import annotations

import math

import numpy as np
import pytest

from trueup.evaluation.chunks import Chunk, Chunks, Hazard, Pace


def shared(rows: int, workers: int = 4) -> Chunks:
    return Chunks(rows, Pace(), Hazard())


@pytest.mark.parametrize("seed", range(5))
def test_every_row_is_settled_whatever_is_lost_on_the_way(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, chunks, seen = int(rng.integers(1, 200)), None, []
    chunks = shared(rows)
    while (chunk := chunks.take(int(rng.integers(1, 5)), 12)) is not None:
        if len(chunk) > 1 and rng.random() < 0.4:
            chunks.lost(chunk, "by chance")
        else:
            seen += range(chunk.start, chunk.stop)
            chunks.settle(chunk)
    assert sorted(seen) == list(range(rows))
    assert chunks.settled
    assert chunks.scored == rows


@pytest.mark.parametrize("rows", [2, 3, 75, 1050])
def test_a_row_that_kills_its_workers_is_given_up_after_five_of_them_and_the_others_are_scored(rows: int) -> None:
    chunks, killed = shared(rows), 0
    while (chunk := chunks.take(1, 2)) is not None:
        if chunk.start <= rows // 2 < chunk.stop:
            killed += 1
            chunks.lost(chunk, "it died")
        else:
            chunks.settle(chunk)
    assert killed <= 5
    assert chunks.given_up == {rows // 2: "it died"}
    assert chunks.scored == rows - 1


def test_what_was_lost_waits_until_all_else_is_handed_out() -> None:
    chunks = shared(40)
    first = chunks.take(1, 4)
    assert first is not None
    chunks.lost(first, "")
    assert [c for _ in range(3) if (c := chunks.take(1, 4))] == [Chunk(10, 20), Chunk(20, 30), Chunk(30, 40)]
    again = chunks.take(1, 4)
    assert again is not None
    assert again.stop <= first.stop


def test_a_single_row_that_was_lost_alone_is_not_given_to_the_last_worker() -> None:
    chunks = shared(1)
    (row,) = [chunks.take(1, 1)]
    assert row is not None
    chunks.lost(row, "")
    assert chunks.take(1, 1, risky=False) is None
    chunks.abandon("nobody is left to try it on")
    assert chunks.settled
    assert chunks.given_up == {0: "nobody is left to try it on"}


def test_chunks_are_as_long_as_loses_the_least_where_workers_are_lost() -> None:
    """The best interval by brute force: the mean time for W s of work in pieces of tau s, each begun with h s, where losses
    are exponential and a loss costs all of its piece.
    """
    fixed, each, between, rows = 0.5, 0.1, 40.0, 5000
    pace = Pace()
    for n in (5, 10, 40, 80):
        pace.took(n, 1, fixed + each * n)
    tried = np.arange(1, 800)
    mean = rows / tried * between * np.expm1((fixed + each * tried) / between)
    chosen = pace.most(1, between)
    assert mean[chosen - 1] < 1.02 * mean.min()
    assert pace.most(1, math.inf) > rows


def test_more_rows_and_fewer_threads_may_take_longer_before_they_count_as_hung() -> None:
    pace = Pace(grace=1.0)
    assert math.isinf(pace.limit(Chunk(0, 10), 1))
    pace.took(10, 2, 4.0)
    assert pace.limit(Chunk(0, 10), 2) == pytest.approx(13.0)
    assert pace.limit(Chunk(0, 1), 2) == pytest.approx(13.0)
    assert pace.limit(Chunk(0, 10), 1) == pytest.approx(25.0)
    assert pace.limit(Chunk(0, 10, losses=2), 2) == pytest.approx(52.0)
