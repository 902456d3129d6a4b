# SPDX-License-Identifier: Apache-2.0
"""What is believed of parameters: what recordings tell of them, within their ranges."""

from __future__ import annotations

import numpy as np
import pytest

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
