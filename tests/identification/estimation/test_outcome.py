# SPDX-License-Identifier: Apache-2.0
"""Where a model predicts held-out motion far worse, the result says how that motion differs from the fitted one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.identification.estimation.diagnosis import grouped
from trueup.identification.estimation.outcome import unlike
from trueup.identification.estimation.result import Prediction

Array = NDArray[np.float64]


def prediction(held_out: bool, q: Array, v: Array, error: Array) -> Prediction:
    torque = np.asarray(10.0 * np.sin(3.0 * q), dtype=np.float64)
    time = np.linspace(0.0, 40.0, len(q))
    return Prediction("run", held_out, time, torque + error, torque, None, None, q, v, np.zeros((len(q), 3)))


@pytest.mark.parametrize(
    ("speed", "away", "said"),
    [
        (0.02, 0.0, "hardly turn"),
        (3.0, 0.0, "faster than any fitted"),
        (1.0, 2.0, "beyond those fitted"),
        (1.0, 0.0, ""),
    ],
)
def test_what_the_held_out_motion_has_that_the_fitted_one_lacks_is_named(speed: float, away: float, said: str) -> None:
    rng = np.random.default_rng(0)
    q, v = rng.uniform(-1.0, 1.0, (4000, 3)), rng.uniform(0.2, 1.0, (4000, 3)) * rng.choice([-1.0, 1.0], (4000, 3))
    fitted = prediction(False, q, v, 0.01 * rng.normal(size=q.shape))
    other = rng.random((4000, 1)) < 0.3
    held = prediction(True, q + away * other, v * np.where(other, speed, 1.0), np.where(other, 1.0, 0.01) * v)
    found = unlike([fitted], [held])
    assert said in found
    assert bool(found) == bool(said)


def test_what_is_said_alike_of_several_recordings_is_said_once() -> None:
    one, two = "recording 'a': 3 samples of torque stand far off", "recording 'b': 12 samples of torque stand far off"
    (said,) = grouped([one, two, one])
    assert said == f"{one}; likewise in b"
    assert grouped([one, "something else", "and 2 more", "and 3 more"]) == [
        one,
        "something else",
        "and 2 more",
        "and 3 more",
    ]
