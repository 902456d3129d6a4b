# SPDX-License-Identifier: Apache-2.0
"""Intervals of what is predicted in stretches, each of which is wrong by something of its own."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trueup.calibration import NORMAL_95
from trueup.loop.stretches import between_stretches


@pytest.mark.parametrize("parameters", [3, 8])
def test_intervals_hold_where_stretches_are_wrong_by_something_each_of_fewer_than_parameters_too(
    parameters: int,
) -> None:
    """Least squares by 6 stretches of 40 samples; all samples of a stretch share most of their error."""
    rng, stretches, samples = np.random.default_rng(0), 6, 40
    number = np.repeat(np.arange(stretches), samples)

    class Predicting:
        def stretches(self, trial: object) -> object:
            return lambda time: (np.zeros(len(time)), number)

    slopes = rng.normal(size=(len(number), parameters)) + rng.normal(size=(stretches, parameters))[number]
    trial = SimpleNamespace(observed={"position": SimpleNamespace(time=0.1 * np.arange(len(number)))})
    mask = np.ones((len(number), 1), dtype=bool)
    segment = SimpleNamespace(trial=0, channel="position", mask=mask, columns=slice(0, len(number)))
    problem: Any = SimpleNamespace(simulator=Predicting(), trials=[trial], segments=[segment])
    held, foretold, seen = list[bool](), list[float](), list[float]()
    for _ in range(200):
        noise = rng.normal(size=stretches)[number] + 0.3 * rng.normal(size=len(number))
        off = np.linalg.lstsq(slopes, noise, rcond=None)[0]
        fit: Any = SimpleNamespace(jacobian=slopes, weights=np.ones(len(number)), residual=slopes @ off - noise)
        variances = between_stretches(problem, fit, 1e-9)
        assert variances is not None
        spread = np.sqrt(variances)
        held += (np.abs(off) <= NORMAL_95 * spread).tolist()
        foretold.append(float(np.mean(spread)))
        seen.append(float(np.mean(off**2)))
    assert np.mean(held) > 0.85
    assert np.mean(foretold) < 3.0 * np.sqrt(np.mean(seen))
