# SPDX-License-Identifier: Apache-2.0
"""Risks that compete are told apart, with doubts that hold."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.loop.risks import Prior, Risks

WIDE = Prior(np.zeros((2, 3)), np.full((2, 3), 5.0))


def test_competing_risks_are_told_apart_and_their_doubt_holds_the_truth() -> None:
    rng = np.random.default_rng(3)
    truth = np.array([[-1.0, 1.5, -0.8], [-1.5, 0.5, 0.9]])
    inside, x, risks = [], np.zeros((0, 3)), None
    for _ in range(40):
        x = np.column_stack([np.ones(60), rng.uniform(-1.0, 1.0, (60, 2))])
        odds = np.exp(x @ truth.T)
        shares = odds / (1.0 + odds.sum(axis=1, keepdims=True))
        ended = np.array([rng.multinomial(4, [*p, 1.0 - p.sum()])[:2] for p in shares], dtype=np.float64)
        risks = Risks.of(x, ended, np.full(60, 4.0), WIDE)
        deviation = np.sqrt(np.diag(risks.covariance)).reshape(2, 3)
        inside.append(np.abs(risks.coefficients - truth) < 1.96 * deviation)
    assert 0.9 < np.mean(inside) < 0.99
    assert risks is not None
    drawn = risks.sample_shares(x, 500, rng).mean(axis=0)
    assert drawn == pytest.approx(risks.shares(x), abs=0.02)


def test_what_a_run_would_tell_is_most_where_it_is_not_known() -> None:
    x = np.column_stack([np.ones(40), np.zeros(40), np.zeros(40)])
    risks = Risks.of(x, np.full((40, 2), 1.0), np.full(40, 4.0), WIDE)
    known, other = np.array([[1.0, 0.0, 0.0]]), np.array([[1.0, 1.0, 0.0]])
    about, once = np.vstack([known, other]), np.ones(2)
    at_known, at_other = risks.learned(about, about, once)
    assert at_other > 10.0 * at_known > 0.0
    narrow = Risks.of(x, np.full((40, 2), 1.0), np.full(40, 4.0), Prior(np.zeros((2, 3)), np.full((2, 3), 0.2)))
    doubt = narrow.sample_shares(other, 20000, np.random.default_rng(0)).sum(axis=2).var()
    assert narrow.learned(other, other, np.ones(1), runs=1e6)[0] == pytest.approx(doubt, rel=0.1)  # all there is


def test_more_ends_than_runs_are_refused() -> None:
    with pytest.raises(ValueError, match="more runs ended than were made"):
        Risks.of(np.ones((1, 3)), np.array([[2.0, 2.0]]), np.array([3.0]), WIDE)
