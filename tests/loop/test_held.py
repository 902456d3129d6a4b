# SPDX-License-Identifier: Apache-2.0
"""What is held is followed for all parameters side by side, with slopes that each step corrects."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.discrepancies.weighted import Weighted
from trueup.engines.simulator import Simulator
from trueup.loop.estimates import estimated, with_ties
from trueup.loop.fit import fit
from trueup.loop.held import _Slopes, held_open
from trueup.loop.problem import Problem
from trueup.loop.ties import considered
from trueup.loop.uncertainty import unit_covariance
from trueup.loop.watch import Watch
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.search.bounded_step import corrected

Array = NDArray[np.float64]
TIME = np.arange(300) / 100.0
SPACE = ParameterSpace(
    (
        Parameter("level", "rad", 0.5, -2.0, 2.0),
        Parameter("rise", "rad/s", 0.1, -3.0, 3.0),
        Parameter("beside level", "rad", 0.0, -1.0, 1.0),
        Parameter("beside rise", "rad/s", 0.0, -1.0, 1.0),
    )
)


def line(time: Array, values: Array, step: float) -> Array:
    """Of each pair of numbers only the sum is seen."""
    return values[0] + values[2] + (values[1] + values[3]) * time


@pytest.fixture
def problem(formula: Callable[..., Simulator]) -> Problem:
    positions = 1.0 + 0.3 * TIME + 0.01 * np.random.default_rng(3).standard_normal(300)
    recording = Recording("one", {"position": Channel("position", ("j",), "rad", TIME, positions[:, None])})
    return Problem(formula(line, SPACE), [recording], Weighted.estimated([recording], ["position"]), ("position",))


def test_what_makes_up_for_what_is_held_is_open_as_far_as_that_may_be(problem: Problem) -> None:
    left = SPACE.freeze(["beside level", "beside rise"])
    found = fit(problem, left, left.nominal, Watch(), robust=np.inf)
    level, rise = held_open(problem, found, SPACE.parameters[2:], unit_covariance(problem, found))
    assert level.held
    assert (level.name, rise.name) == ("beside level", "beside rise")
    np.testing.assert_allclose([level.down[0], level.up[0], rise.down[1], rise.up[1]], 1.0, atol=0.03)
    np.testing.assert_allclose([level.down[1], rise.up[0]], 0.0, atol=0.03)


def test_of_what_stands_for_what_no_recording_told_only_the_sum_is_said_to_be_seen(problem: Problem) -> None:
    left = SPACE.freeze(["beside level", "beside rise"])
    found = fit(problem, left, left.nominal, Watch(), robust=np.inf)
    covariance = unit_covariance(problem, found)
    assert not [o for o in considered(problem, found, covariance) if o.parameter.name.startswith("beside")]
    level, rise = [o for o in considered(problem, found, covariance, SPACE.names[2:]) if "beside" in o.parameter.name]
    np.testing.assert_allclose([*level.trade, *rise.trade], [-1.0, 0.0, 0.0, -1.0], atol=0.02)
    np.testing.assert_allclose([level.low, level.high, rise.low, rise.high], [-1.0, 1.0, -1.0, 1.0])
    estimates = estimated(found, covariance, (), SPACE, {}, ())
    words = {e.name: e for e in with_ties(estimates, (level, rise), {}, SPACE)}
    assert words["level"].verdict == words["rise"].verdict == "tied"
    assert "only level + beside level is seen: 0.9995" in words["level"].note


def test_slopes_are_corrected_as_if_each_were_kept_by_itself(problem: Problem) -> None:
    rng = np.random.default_rng(1)
    found = fit(problem, SPACE, SPACE.nominal, Watch(), robust=np.inf)
    found.jacobian, found.weights = rng.standard_normal((300, 4)), rng.uniform(0.1, 1.0, 300)
    some = np.array([True, False, True, True])
    slopes = _Slopes(found, found.jacobian.T @ (found.jacobian * found.weights[:, None]), some)
    plain = np.where(some, found.jacobian, 0.0)
    for _ in range(3):
        moved, before, after = some * rng.standard_normal(4), rng.standard_normal(300), rng.standard_normal(300)
        slopes.correct(before, moved, after)
        plain = corrected(plain, before, moved, after)
        weighted = plain * found.weights[:, None]
        np.testing.assert_allclose(slopes.pull(after), weighted.T @ after, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(slopes.curvature, plain.T @ weighted, rtol=1e-9, atol=1e-9)
