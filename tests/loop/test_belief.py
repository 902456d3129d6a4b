# SPDX-License-Identifier: Apache-2.0
"""What is believed of parameters: what recordings tell of them, within their ranges."""

from __future__ import annotations

import numpy as np
import pytest

from trueup.calibration import Nuisance
from trueup.loop.belief import Belief
from trueup.parameters import Parameter, ParameterSpace

SPACE = ParameterSpace(tuple(Parameter(name, "", 0.5, 0.0, 1.0) for name in ("a", "b")))
ALONG, ACROSS = np.array([1.0, 1.0]) / np.sqrt(2.0), np.array([1.0, -1.0]) / np.sqrt(2.0)


def believed(along: float, across: float) -> Belief:
    covariance = along**2 * np.outer(ALONG, ALONG) + across**2 * np.outer(ACROSS, ACROSS)
    return Belief.estimated(
        SPACE, np.array([0.35, 0.55]), np.ones(2, dtype=bool), covariance, ("identified", "identified")
    )


def test_samples_keep_what_was_told_where_a_combination_was_left_open() -> None:
    """Of a drive that was moved once stiffness over friction may be known, and neither of the two."""
    samples = believed(5.0, 0.005).sample(200, np.random.default_rng(0))
    assert np.ptp(samples[:, 0]) > 0.5, "what was left open is anywhere"
    kept = np.abs(samples[:, 0] - samples[:, 1] + 0.2) < 0.03
    assert kept.mean() > 0.8


def test_what_was_told_well_is_believed_as_told() -> None:
    belief = believed(0.01, 0.02)
    told = 0.01**2 * np.outer(ALONG, ALONG) + 0.02**2 * np.outer(ACROSS, ACROSS)
    assert belief.covariance == pytest.approx(told, rel=0.01)


def test_what_nobody_asked_for_moves_with_what_replays_as_well_and_one_at_its_bound_holds_no_other() -> None:
    space = ParameterSpace((
        Parameter("own", "", 2.0, 0.0, 10.0),
        *(Parameter(f"aside{k}", "", 0.0, 0.0, 5.0, frozen=True) for k in range(4)),
        Parameter("between", "", 1.0, 0.0, 5.0, frozen=True),
    ))  # fmt: skip
    asides = Nuisance((*(f"aside{k}" for k in range(4)), "between"), np.eye(5), -np.ones((1, 5)))
    fitted = np.array([True, *[False] * 5])
    verdicts = ("identified", *["frozen"] * 5)
    belief = Belief.estimated(space, space.nominal, fitted, np.array([[1e-6]]), verdicts, asides)
    drawn = belief.sample(401, np.random.default_rng(0))
    np.testing.assert_array_equal(drawn[0], space.nominal)
    assert (drawn >= 0.0).all()
    assert drawn.sum(axis=1) == pytest.approx(3.0, abs=0.01)
    assert np.median(np.abs(drawn[1:, -1] - 1.0)) > 0.2
