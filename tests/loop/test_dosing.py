# SPDX-License-Identifier: Apache-2.0
"""Graded settings are found by how runs end: no trial is far from another, starting is told from going on, limits hold."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.loop.dosing import Ledger
from trueup.tasks.paces import Paces
from trueup.tasks.task import Grades

GRADES = Paces().grades(PARAMETERS, 0.7)


def runs(arrived: int, forward: float, backward: float, speed: float = 0.12) -> np.ndarray:
    return np.array([arrived, arrived * np.log(speed), forward, backward])


def both(first: np.ndarray, later: np.ndarray | None = None) -> np.ndarray:
    return np.stack([first, np.zeros(4) if later is None else later])


def place(steps: float, lean: float = 0.0, grades: Grades = GRADES) -> int:
    return int(np.flatnonzero(np.isclose(grades.numbers, (steps, lean)).all(axis=1))[0])


def test_no_trial_is_far_from_one_that_was_made() -> None:
    ledger = Ledger(GRADES)
    assert np.flatnonzero(ledger.near()).tolist() == [0]
    assert ledger.next(np.random.default_rng(0)) == 0  # also where the first trials were aborted
    assert GRADES.numbers[0].tolist() == [1.0, 0.0]
    ledger.add(0, both(runs(2, 0, 0)))
    near = GRADES.numbers[ledger.near()]
    assert near[:, 0].max() == pytest.approx(1.2)
    assert np.abs(near[:, 1]).max() == pytest.approx(0.006)


def test_falls_to_either_side_are_told_apart_and_a_half_counts_for_both() -> None:
    ledger = Ledger(GRADES)
    ledger.add(0, both(runs(0, 10.0, 10.0)))
    forward, backward = ledger.risks().shares(GRADES.features[0, :1])[0]
    assert forward == pytest.approx(backward, abs=1e-6)
    assert forward + backward > 0.5


def test_a_fall_at_the_start_is_told_from_one_further_on() -> None:
    starting, walking = Ledger(GRADES), Ledger(GRADES)
    for _ in range(10):
        starting.add(0, both(runs(0, 1, 0)))
        walking.add(0, both(runs(1, 0, 0), runs(0, 1, 0)))
    first, on = (ledger.risks().shares(GRADES.features[0, :1])[0, 0] for ledger in (starting, walking))
    assert first > 0.7 > 0.3 > on


def test_what_is_worth_the_most_is_neither_the_boldest_nor_the_gentlest() -> None:
    ledger, rng = Ledger(GRADES), np.random.default_rng(0)
    ledger.add(0, both(runs(10, 0, 0, 0.12)))
    ledger.add(place(1.4), both(runs(30, 0, 0, 0.19)))
    ledger.add(place(2.0), both(runs(4, 3, 3, 0.3)))
    best, worths = ledger.best(rng)
    assert best == place(1.4)
    assert worths[1] == pytest.approx(0.19, abs=0.04)
    settled = ledger.next(rng, settled=True)
    assert settled is not None
    assert 1.2 < GRADES.numbers[settled, 0] < 1.8
    barred = frozenset(np.flatnonzero(ledger.near()).tolist()) - {0}
    assert ledger.next(rng, barred=barred) == 0
    assert ledger.next(rng, barred=barred | {0}) is None
