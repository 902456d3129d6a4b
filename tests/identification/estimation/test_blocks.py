# SPDX-License-Identifier: Apache-2.0
"""What is left out together: stretches that repeat a motion, in one log or several, and what that is worth."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.evidence import FEWEST_PARTS
from trueup.identification.estimation.blocks import blocks_of, numbered
from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.result import relative_error
from trueup.identification.rows import Rows
from trueup.recording import Channel, Recording

RATE = 50.0


def _rows(time: NDArray[np.float64]) -> Rows:
    column = np.arange(len(time), dtype=float)[None]
    return Rows((np.array([0]),), (column,), np.zeros((len(time), 1)), time, 1)


def _wandering(rng: np.random.Generator, seconds: float) -> NDArray[np.float64]:
    """(S, 3) positions of which no part is like another."""
    time = np.arange(round(seconds * RATE)) / RATE
    at = 2.0 * np.pi * rng.uniform(0.05, 0.6, (6, 3)) * time[:, None, None] + rng.uniform(0.0, 6.3, (6, 3))
    return np.sum(np.sin(at), axis=1)


def test_without_repeats_blocks_are_stretches_of_equal_time() -> None:
    rng, rows = np.random.default_rng(0), _rows(np.arange(2000) / RATE)
    with_motion, without = (numbered([rows], 16, q)[0] for q in ([_wandering(rng, 40.0)], []))
    np.testing.assert_array_equal(with_motion, without)
    assert np.bincount(without).tolist() == [125] * 16
    assert np.all(np.diff(without) >= 0)


@pytest.mark.parametrize("in_one_log", [True, False])
def test_a_motion_and_its_repeats_are_left_out_together(in_one_log: bool) -> None:
    rng = np.random.default_rng(1)
    once = _wandering(rng, 20.0)
    runs = [once + 1e-3 * rng.normal(size=once.shape) for _ in range(3)]
    runs = [np.concatenate(runs)] if in_one_log else runs
    numbers = numbered([_rows(np.arange(len(q)) / RATE) for q in runs], 16, runs)
    first, *others = np.split(np.concatenate(numbers), 3)
    assert FEWEST_PARTS <= len(np.unique(first)) <= 16 / 2, "blocks became shorter"
    for again in others:
        assert np.mean(again == first) > 0.9


def test_a_motion_that_only_repeats_itself_is_still_left_out_in_turn() -> None:
    time = np.arange(2000) / RATE
    q = np.sin(2.0 * np.pi * time / 0.5)[:, None]
    assert len(np.unique(numbered([_rows(time)], 16, [q])[0])) == 16


def test_a_margin_is_kept_wherever_another_block_begins_and_no_sample_is_in_two() -> None:
    rng = np.random.default_rng(2)
    once = _wandering(rng, 20.0)
    rows = _rows(np.arange(2 * len(once)) / RATE)
    numbers = numbered([rows], 8, [np.concatenate([once, once])])
    blocks = blocks_of([rows], numbers, 0.2)
    kept = np.concatenate([b.values[0][0] for b in blocks]).astype(int)
    assert len(kept) == len(np.unique(kept))
    borders = rows.time[np.flatnonzero(np.diff(numbers[0]))] + 0.5 / RATE
    assert np.abs(rows.time[kept][:, None] - borders).min() >= 0.2 - 1e-9


def test_ripple_that_comes_again_with_a_repeated_motion_is_not_taken_for_friction(arms: SimpleNamespace) -> None:
    tree, rng = arms.arm(), np.random.default_rng(5)

    def run(name: str, size: float, repeats: int) -> Recording:
        time = np.arange(round(12.0 * 200.0)) / 200.0
        q, v, a = (
            np.tile(x, (repeats, 1)) for x in arms.sines(np.random.default_rng(rng.integers(99)), time, 4, size=size)
        )
        torque = arms.torque(tree, q, v, a) + 0.3 * arms.coulomb * np.sin(100.0 * q)
        clock = np.arange(len(q)) / 200.0
        parts = {"position": ("rad", q), "torque": ("N m", torque + 0.1 * rng.normal(size=q.shape))}
        return Recording(name, {k: Channel(k, tree.joints, u, clock, x) for k, (u, x) in parts.items()})

    narrow, others = run("narrow", 0.12, 2), [run("wide", 0.8, 1)]
    ours, plain = (
        identify(
            arms.without_file(tree),
            [narrow],
            others,
            options=Options(structure=s, consistent=s == "select", cutoff=8.0),
        )
        for s in ("select", "common")
    )
    assert relative_error(ours.held_out()) < relative_error(plain.held_out())
