# SPDX-License-Identifier: Apache-2.0
"""What doubtful simulators' failures mean on the robot is what its runs say, no more and no less surely."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.studies.walk.odds import Odds


def drawn(rng: np.random.Generator, slope: float, own: float, count: int, runs: int) -> tuple[np.ndarray, ...]:
    signal = rng.uniform(-2.0, 2.0, count)
    true = 1.0 / (1.0 + np.exp(1.5 - slope * signal - own * rng.standard_normal(count)))
    return signal, true, rng.binomial(runs, true).astype(float)


def test_expected_shares_are_those_in_which_candidates_fail() -> None:
    rng = np.random.default_rng(0)
    gaps, alone, slopes = [], [], []
    for _ in range(40):
        signal, true, failed = drawn(rng, 1.5, 0.5, 25, 4)
        odds = Odds.of(signal[:20], failed[:20], np.full(20, 4.0))
        gaps.append(np.concatenate([odds.told, odds(signal[20:])]) - true)
        alone.append((failed + 0.5) / 5.0 - true)
        slopes.append(odds.slope)
    assert abs(np.mean(gaps)) < 0.01
    assert np.mean(np.square(gaps)) < 0.4 * np.mean(np.square(alone))  # than by the candidate's own runs
    assert 1.2 < np.mean(slopes) < 2.2  # a mean of what few runs leave open, to one side of the true 1.5


def test_where_simulators_say_nothing_a_candidates_own_runs_count() -> None:
    rng = np.random.default_rng(1)
    signal, true, failed = drawn(rng, 0.0, 2.5, 30, 20)
    odds = Odds.of(signal, failed, np.full(30, 20.0))
    assert odds.slope < 0.8
    assert np.abs(odds.told - true).mean() < 0.08
    assert np.ptp(odds(np.array([-1.0, 1.0]))) < 0.3


def test_little_is_known_far_from_what_was_run() -> None:
    odds = Odds.of(np.zeros(1), np.zeros(1), np.full(1, 8.0))
    near, far = odds(np.array([0.0, 3.0]))
    assert odds.told[0] < near < 0.05 < 0.3 < far  # one that stood eight times is surer than another like it
    assert (np.diff(odds(np.linspace(-3.0, 3.0, 9))) > 0.0).all()
    for signal, runs in ((np.zeros(0), np.zeros(0)), (np.zeros(1), np.zeros(1)), (np.full(1, np.nan), np.ones(1))):
        with pytest.raises(ValueError, match="finite signal"):
            Odds.of(signal, np.zeros(len(signal)), runs)
