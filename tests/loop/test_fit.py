# SPDX-License-Identifier: Apache-2.0
"""Least squares alone ends in the wrong valley or at a crack in the loss; the fit goes on from there."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.discrepancies.weighted import Weighted
from trueup.engines.simulator import Simulator
from trueup.evidence import explained
from trueup.loop.descent import Descent, Look, last_look
from trueup.loop.fit import DESCENT, SEARCHES, coarsest, fit
from trueup.loop.interior import nudge
from trueup.loop.problem import Problem
from trueup.loop.profiles import _held
from trueup.loop.selection import choose
from trueup.loop.uncertainty import unit_covariance
from trueup.loop.watch import Watch
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.search.least_squares import LeastSquares
from trueup.trial import STEP, Observed, Trial

Array = NDArray[np.float64]
TIME = np.linspace(0.0, 4.0, 401)
SPACE = ParameterSpace((
    Parameter("mass", "kg", 3.67, 0.5, 5.0, scale="log"), Parameter("lever", "m", 0.12, 0.1, 0.3)
))  # fmt: skip
TRUTH = np.array([2.0, 0.22])


Make = Callable[[Callable[[Array, Array, float], Array], ParameterSpace], Simulator]


def problem_of(simulator: Simulator, truth: Array = TRUTH) -> Problem:
    there = {"position": Observed(("joint",), "rad", TIME)}
    (clean,) = simulator.rollout([Trial("made", 0.0, TIME[-1], None, there)], truth[None])
    noise = 1e-3 * np.random.default_rng(0).standard_normal((len(TIME), 1))
    channel = Channel("position", ("joint",), "rad", TIME, clean.channels["position"][0] + noise)
    recording = Recording("made", {"position": channel})
    return Problem(simulator, [recording], Weighted.estimated([recording], ["position"]), ("position",))


def ridge(time: Array, values: Array, step: float) -> Array:
    """Only the product of mass and lever arm is well seen; the rest has a ridge between the bound and the truth."""
    mass, lever = values
    u = (lever - 0.1) / 0.2
    return mass * lever * np.sin(2.0 * time) + 0.02 * (0.6 - u) * (u + 0.2) * np.cos(9.0 * time)


def test_a_valley_that_ends_at_a_bound_is_left_for_the_one_behind_the_ridge(formula: Make) -> None:
    problem = problem_of(formula(ridge, SPACE))
    stuck = fit(problem, SPACE, SPACE.nominal, Watch(), stages=DESCENT)
    assert stuck.values[1] == pytest.approx(0.1, abs=1e-3)
    found = fit(problem, SPACE, SPACE.nominal, Watch())
    np.testing.assert_allclose(found.values, TRUTH, rtol=0.02)


def test_slopes_taken_for_the_next_look_are_no_slopes_of_a_search_with_one_parameter_held(formula: Make) -> None:
    problem = problem_of(formula(ridge, SPACE))
    run = Descent(SPACE, np.clip(SPACE.to_unit(TRUTH), 0, 1), Watch(), 3.0)
    look = last_look(problem, problem)
    run.descend(look)
    assert not run.choose(look, lambda problem, found: SPACE)  # nothing is frozen; slopes wait for the next look
    held = _held(run, look, 1, 0.5)
    assert held.point[1] == 0.5
    assert held.loss > run.descend(look).loss


def cracked(time: Array, values: Array, step: float) -> Array:
    """Smooth at the full step; at the coarse one the whole motion jumps shortly before the true lever arm."""
    mass, lever = values
    jump = 0.05 * (lever > 0.2195) if step > 0.015 else 0.0
    return mass * np.sin(2.0 * time) + lever * np.cos(9.0 * time) + jump


def test_a_crack_that_only_the_coarse_step_has_does_not_end_the_search(formula: Make) -> None:
    problem = problem_of(formula(cracked, SPACE))
    look = Look("all", problem, problem.at_step(0.025), 0.05, 20)
    run = Descent(SPACE, np.clip(SPACE.to_unit([2.0, 0.2193]), 0, 1), Watch(), 3.0)
    run.polish(look)
    np.testing.assert_allclose(run.finished(look).values, TRUTH, rtol=1e-3)


@pytest.mark.parametrize("search", ["cma-es", "hybrid"])
def test_an_interrupted_evolution_goes_on_without_simulating_anew_what_it_had(search: str, formula: Make) -> None:
    states: list[dict[str, Any]] = []
    whole = problem_of(formula(ridge, SPACE))
    found = fit(whole, SPACE, SPACE.nominal, Watch(checkpoint=states.append), stages=SEARCHES[search])
    evolving = [s for s in states if s["stage"] == "cma-es"]
    half = json.loads(json.dumps(evolving[len(evolving) // 2]))
    rest = problem_of(formula(ridge, SPACE))
    again = fit(rest, SPACE, SPACE.nominal, Watch(), stages=SEARCHES[search], resume=half)
    np.testing.assert_array_equal(again.values, found.values)
    assert rest.evaluations == whole.evaluations - sum(len(told) for told in half["search"]["told"])


def test_a_trial_is_not_kept_as_where_an_interrupted_search_goes_on(formula: Make) -> None:
    states: list[dict[str, Any]] = []
    problem = problem_of(formula(ridge, SPACE))
    anew = partial(LeastSquares, reuse=0)  # slopes anew after each step, which is kept
    run = Descent(SPACE, SPACE.to_unit([0.7, 0.15]), Watch(checkpoint=states.append), 3.0, solver=anew)
    look = last_look(problem, problem)
    _held(run, look, 1, 0.5)
    assert not states
    run.descend(look)
    assert states


def rubbed(time: Array, values: Array, step: float) -> Array:
    """A signal of which next to nothing is left where the second value is its true ten-thousandth."""
    mass, loss = values
    return mass * np.sin(2.0 * time) - loss * np.cos(9.0 * time)


def test_what_is_found_to_be_nothing_is_not_put_back_to_where_it_started(formula: Make) -> None:
    space = ParameterSpace((SPACE["mass"], Parameter("loss", "rad", 0.5, 1e-6, 1.0, scale="log")))
    problem = problem_of(formula(rubbed, space), np.array([2.0, 1e-6]))
    found = fit(problem, space, space.nominal, Watch())
    unseen, _ = choose(problem, found, unit_covariance(problem, found))
    assert "loss" not in unseen.freeze


def test_a_narrow_valley_in_a_plateau_is_found_where_parameters_are_few(formula: Make) -> None:
    def sticks(time: Array, values: Array, step: float) -> Array:
        """Friction matters near its truth only, as that of a foot that slides: above it sticks, below it slips away."""
        stiffness, friction = values
        above = np.log(friction / 0.52)
        slides = 0.2 * (max(-above, 0.0) + 0.01 * max(above, 0.0))
        return stiffness * np.sin(2.0 * time) + slides * np.clip(time - 1.0, 0.0, None) ** 2

    space = ParameterSpace((
        Parameter("stiffness", "", 2.0, 0.5, 5.0, scale="log"), Parameter("friction", "", 2.0, 0.1, 5.0, scale="log")
    ))  # fmt: skip
    truth = np.array([1.3, 0.478])
    problem = problem_of(formula(sticks, space), truth)
    assert fit(problem, space, space.nominal, Watch(), stages=DESCENT).values[1] > 1.0
    np.testing.assert_allclose(fit(problem, space, space.nominal, Watch()).values, truth, rtol=0.02)


def test_an_optimum_of_the_coarse_step_that_blows_up_at_the_real_one_is_left(formula: Make) -> None:
    def unstable(time: Array, values: Array, step: float) -> Array:
        """A coarse step is half off, towards values with which the real one fails."""
        (gain,) = values
        seen = (gain if step < 0.015 else gain / 1.5) * np.sin(2.0 * time)
        return seen if step > 0.015 or gain < 2.6 else np.full_like(time, np.nan)

    space = ParameterSpace((Parameter("gain", "", 0.6, 0.5, 5.0, scale="log"),))
    problem = problem_of(formula(unstable, space), np.array([2.0]))
    found = fit(problem, space, space.nominal, Watch())
    assert found.values[0] == pytest.approx(2.0, rel=0.01)


def test_slopes_do_not_lead_on_from_where_the_real_step_fails(formula: Make) -> None:
    def unstable(time: Array, values: Array, step: float) -> Array:
        return np.full_like(time, np.nan) if step < 0.015 and values[0] > 2.6 else values[0] * np.sin(2.0 * time)

    space = ParameterSpace((Parameter("gain", "", 0.6, 0.5, 5.0, scale="log"),))
    problem = problem_of(formula(unstable, space), np.array([2.0]))
    coarse = problem.at_step(0.025)
    run = Descent(space, np.clip(space.to_unit([3.0]), 0, 1), Watch(), 3.0)
    assert run.led(Look("all", coarse, coarse, 0.05, 20, real=problem)) is None
    run = Descent(space, np.clip(space.to_unit([2.2]), 0, 1), Watch(), 3.0)
    led = run.led(Look("all", coarse, coarse, 0.05, 20, real=problem))
    assert led is not None
    assert explained(led.residual)


def test_a_search_stopped_while_it_evolved_after_slopes_begins_again(formula: Make) -> None:
    states: list[dict[str, Any]] = []
    watch = Watch(checkpoint=states.append)
    fit(problem_of(formula(ridge, SPACE)), SPACE, SPACE.nominal, watch, stages=SEARCHES["hybrid"])
    saved = json.loads(json.dumps(next(s for s in states if s["stage"] == "cma-es")))
    whole = fit(problem_of(formula(ridge, SPACE)), SPACE, SPACE.nominal, Watch())
    again = fit(problem_of(formula(ridge, SPACE)), SPACE, SPACE.nominal, Watch(), resume=saved)
    np.testing.assert_array_equal(again.values, whole.values)


def test_a_saved_stage_that_is_no_more_goes_on_at_the_full_step(formula: Make) -> None:
    states: list[dict[str, Any]] = []
    whole = fit(problem_of(formula(ridge, SPACE)), SPACE, SPACE.nominal, Watch(checkpoint=states.append))
    saved = {**states[-1], "stage": "of an earlier version"}
    seen: list[str] = []
    watch = Watch(progress=lambda point: seen.append(point.stage))
    again = fit(problem_of(formula(ridge, SPACE)), SPACE, SPACE.nominal, watch, resume=saved)
    assert seen[0] == "all, full step"
    assert "all, coarse step" not in seen
    np.testing.assert_allclose(again.values, whole.values, rtol=1e-3)


def test_a_coarser_step_is_faithful_where_the_search_begins(formula: Make) -> None:
    """Beside a start on a bound, from which a nudge leads far astray, the same error of a coarser step would not show."""
    truth = np.array([2.0, 0.1])

    def lagging(time: Array, values: Array, step: float) -> Array:
        return values[0] * np.sin(2.0 * (time + step - 0.01)) + 10.0 * values[1] * np.cos(9.0 * time)

    problem = problem_of(formula(lagging, SPACE), truth)
    assert coarsest(problem, SPACE, SPACE.to_unit(np.array([4.0, 0.1]))).simulator.step > 0.01
    assert coarsest(problem, SPACE, SPACE.to_unit(truth)).simulator.step == 0.01


def test_a_model_of_short_steps_is_searched_at_the_usual_step_at_least(formula: Make) -> None:
    """Which is far off at the start here, and leads near enough for the model's own step to end."""

    def lagging(time: Array, values: Array, step: float) -> Array:
        return values[0] * np.sin(2.0 * (time + 200.0 * step)) + 10.0 * values[1] * np.cos(9.0 * time)

    problem = problem_of(formula(lagging, SPACE), np.array([2.0, 0.1])).at_step(0.0005)
    assert coarsest(problem, SPACE, SPACE.to_unit(np.array([4.0, 0.1]))).simulator.step == STEP


def test_a_search_begins_off_bounds_where_that_is_not_all_that_is_wrong(formula: Make) -> None:
    def waving(time: Array, values: Array, step: float) -> Array:
        return values[0] * np.sin(2.0 * time) + 10.0 * values[1] * np.cos(9.0 * time)

    on_bound = SPACE.parameters[1].lower
    for truth, off in ((2.0, 0.0), (4.0, LeastSquares.nudge)):
        problem = problem_of(formula(waving, SPACE), np.array([truth, on_bound]))
        assert nudge(problem, SPACE, SPACE.to_unit(np.array([2.02, on_bound]))) == off


def test_a_start_that_cannot_be_simulated_says_nothing_of_coarser_steps(formula: Make) -> None:
    """Without damping a model may be thrown about, from which a search is nudged away."""
    lower = SPACE.parameters[0].lower

    def thrown(time: Array, values: Array, step: float) -> Array:
        return np.full(len(time), np.nan) if values[0] <= lower else values[0] * np.sin(2.0 * time)

    start = SPACE.to_unit(np.array([lower, 0.1]))
    assert coarsest(problem_of(formula(thrown, SPACE)), SPACE, start).simulator.step > 0.01
