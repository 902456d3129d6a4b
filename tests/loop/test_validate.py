# SPDX-License-Identifier: Apache-2.0
"""Leaving out what was not fitted leaves out all of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from trueup.discrepancies.weighted import Weighted
from trueup.engines.simulator import Simulator
from trueup.loop.fit import fit
from trueup.loop.problem import Problem
from trueup.loop.validate import (
    block_errors,
    by_recording,
    by_stretch,
    cautious_errors,
    left_out_errors,
    left_out_points,
)
from trueup.loop.watch import Watch
from trueup.loop.windows import in_windows
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording, part_of

Array = NDArray[np.float64]
SPACE = ParameterSpace((Parameter("level", "rad", 0.5, -2.0, 2.0),))


def level(time: Array, values: Array, step: float) -> Array:
    return np.full(len(time), values[0])


def measured(name: str, level: float, seed: int) -> Recording:
    values = level + 0.01 * np.random.default_rng(seed).standard_normal((200, 1))
    return Recording(name, {"position": Channel("position", ("joint",), "rad", np.arange(200) / 100.0, values)})


def test_windows_of_one_recording_are_left_out_together(formula: Callable[..., Simulator]) -> None:
    high, low = measured("high", 1.0, 0), measured("low", 0.0, 1)
    windows = [high.slice(t, t + 0.45).replace(name=f"high {t}", provenance=part_of(high)) for t in (0.0, 0.5, 1.0)]
    recordings = [*windows, low]
    problem = Problem(formula(level, SPACE), recordings, Weighted.estimated(recordings, ["position"]), ("position",))
    found = fit(problem, SPACE, SPACE.nominal, Watch(), robust=np.inf)
    points = found.space.from_unit(left_out_points(found, by_recording(problem)))[:, 0]
    np.testing.assert_allclose(points, [0.0, 1.0], atol=0.02)


def test_windows_of_the_only_recording_are_left_out_in_stretches(formula: Callable[..., Simulator]) -> None:
    high = measured("high", 1.0, 0)
    whole = Problem(formula(level, SPACE), [high], Weighted.estimated([high], ["position"]), ("position",))
    blocks = by_recording(in_windows(whole, 0.1))
    assert [len(b.trials) for b in blocks] == [2] * 10
    np.testing.assert_array_equal(np.concatenate([b.rows for b in blocks]), np.arange(200))


def test_what_only_the_part_left_out_has_seen_stays_about_where_it_is(formula: Callable[..., Simulator]) -> None:
    """A model error in what is left must not pass for a parameter that shows there by a hair."""

    def late_rise(time: Array, values: Array, step: float) -> Array:
        return values[0] + values[1] * np.maximum(time - 1.9, 0.0)

    space = ParameterSpace((*SPACE.parameters, Parameter("rise", "rad/s", 0.1, -5.0, 5.0)))
    short, longer = measured("short", 0.5, 0), measured("longer", 0.5, 1)
    time = np.arange(400) / 100.0
    rising = late_rise(time, np.array([0.5, 0.3]), 0.0)[:, None]
    noisy = rising + 0.01 * np.random.default_rng(2).standard_normal(rising.shape)
    longer = Recording("longer", {"position": Channel("position", ("joint",), "rad", time, noisy)})
    channel = short.channel("position")
    wavy = channel.values + 0.1 * np.sin(3.0 * channel.time)[:, None]  # what no level explains
    short = short.with_channel(channel.replace(values=wavy))
    recordings = [short, longer]
    problem = Problem(
        formula(late_rise, space), recordings, Weighted.estimated(recordings, ["position"]), ("position",)
    )
    found = fit(problem, space, space.nominal, Watch(), robust=np.inf)
    without_longer = found.space.from_unit(left_out_points(found, by_recording(problem)))[1, 1]
    assert abs(without_longer - found.values[1]) < 0.05


def test_hundreds_of_recordings_are_left_out_in_tenths(formula: Callable[..., Simulator]) -> None:
    """Each by a fit that never saw it, without a fit and a simulation of all for each of them."""
    recordings = [measured(f"run {k}", 5.0 if k == 7 else 1.0, k) for k in range(40)]
    space = ParameterSpace((Parameter("level", "rad", 0.5, -2.0, 9.0),))
    problem = Problem(formula(level, space), recordings, Weighted.estimated(recordings, ["position"]), ("position",))
    found = fit(problem, space, space.nominal, Watch(), robust=np.inf)
    blocks, before = by_stretch(problem), problem.evaluations
    assert len(blocks) == 40
    for errors_of, most in ((left_out_errors, 10), (cautious_errors, 10 + 1 + 3 * 10)):
        errors = errors_of(problem, found, blocks)
        assert problem.evaluations - before <= most
        np.testing.assert_allclose(errors[7], 4.0, atol=0.05)  # as by all others
        np.testing.assert_allclose(np.delete(errors, 7)[:3], 4.0 / 36.0, atol=0.02)  # of 36 runs one is the odd one
        before = problem.evaluations


def test_a_recording_that_cannot_be_replayed_says_nothing_of_those_simulated_beside_it(
    formula: Callable[..., Simulator],
) -> None:
    def failing(time: Array, values: Array, step: float) -> Array:
        return np.full(len(time), values[0] if time[-1] < 2.0 else np.nan)

    one, other = measured("one", 1.0, 0), measured("other", 1.0, 1)
    late = one.with_channel(one.channel("position").replace(time=one.channel("position").time + 1.0))
    recordings = [late.replace(name="late"), other]
    problem = Problem(formula(failing, SPACE), recordings, Weighted.estimated(recordings, ["position"]), ("position",))
    errors = block_errors(problem, by_recording(problem), np.array([[1.0], [1.0]]))
    assert np.isinf(errors[0])
    assert errors[1] < 0.02
