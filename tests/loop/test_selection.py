# SPDX-License-Identifier: Apache-2.0
"""What may go back to where it started, by what the recordings would miss."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trueup.arrays import Array
from trueup.loop.descent import Fit
from trueup.loop.selection import not_missed
from trueup.parameters import Parameter, ParameterSpace

SPACE = ParameterSpace(
    tuple(Parameter(name, "", 0.9, 0.0, 1.0) for name in ("alone", "one", "other", "without effect"))
)
FOUND = np.array([0.2, 0.3, 0.4, 0.6])


@pytest.mark.parametrize("noise", [1.0, 100.0])
def test_what_the_recordings_miss_does_not_go_back_and_what_others_make_up_for_does(noise: float) -> None:
    rng = np.random.default_rng(3)
    slopes = rng.standard_normal((400, 4)) * [8.0 * noise, 8.0, 8.0, 0.0]
    slopes[:, 2] = -slopes[:, 1]
    errors = noise * rng.standard_normal(400)
    errors -= slopes @ np.linalg.lstsq(slopes, errors, rcond=None)[0]

    def residuals(values: Array) -> Array:
        return (values - FOUND) @ slopes.T + errors

    problem: Any = SimpleNamespace(residuals=residuals, chance=lambda r: 0.5 * float(np.mean(r**2)))
    fit = Fit(SPACE, FOUND, errors, slopes, np.ones(400), "", loss=0.5 * float(errors @ errors))
    assert [p.name for p in not_missed(problem, fit, SPACE.parameters)] == ["one", "other", "without effect"]
