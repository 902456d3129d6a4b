# SPDX-License-Identifier: Apache-2.0
"""Tuning under doubt: a search that may not exploit what the simulator has wrong, and never forgets the incumbent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.controllers.controller import Controller, ControllerFactory
from trueup.engines.simulator import Rollout
from trueup.errors import CalibrationError, TrialError
from trueup.loop.belief import Belief
from trueup.loop.experiment import most_telling, spread_settings
from trueup.loop.optimize import Tried, TrustRegion, judge, optimize
from trueup.loop.safety import exceeded, require_safe
from trueup.loop.transfer import best_known, shortlist
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.search.search import SearchState
from trueup.trial import Limits, Observed, Reference, Trial

Array = NDArray[np.float64]

NOW = np.linspace(0.0, 1.0, 11)


class Cliff:
    """A 'simulator' whose one parameter is where a cliff lies: going closer to it is better, going beyond is very bad."""

    name, step = "cliff", 0.1
    parameters = ParameterSpace((Parameter("edge", "m", 0.7, 0.0, 1.0),))

    def at_step(self, step: float) -> Cliff:
        return self

    def shipped(self) -> Cliff:
        return self

    def observable(self, recording: Recording) -> tuple[str, ...]:
        return ("position",)

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        over = values[:, 1] > values[:, 0]
        height = np.where(over, 5.0, 1.0 - values[:, 1])
        path = np.where(np.isfinite(height), height, np.nan)[:, None, None] * np.ones((1, len(NOW), 1))
        failures = {int(k): "nowhere" for k in np.flatnonzero(values[:, 1] > 0.99)}
        path[list(failures)] = np.nan
        return [Rollout(t, {"position": path}, failures) for t in trials]


class Approach:
    """The task: get close to the edge."""

    name = "approach"
    parameters = ParameterSpace((Parameter("place", "m", 0.2, 0.0, 1.0),))
    trials = (Trial("walk", 0.0, 1.0, None, {"position": Observed(("x",), "m", NOW)}),)

    def controllers(self, values: Array) -> Controller:
        raise NotImplementedError

    def score(self, rollouts: Sequence[Rollout]) -> Array:
        return rollouts[0].channels["position"][:, -1, 0]


class Grid:
    """A search that tries everything on a grid, once, a few at a time."""

    def __init__(self, count: int = 101, batch: int = 20) -> None:
        self._all, self._batch, self._at = np.linspace(0.0, 1.0, count)[:, None], batch, 0

    def ask(self) -> Array:
        return self._all[self._at : self._at + self._batch]

    def tell(self, candidates: Array, losses: Array) -> None:
        self._at += len(candidates)

    @property
    def done(self) -> str:
        return "all tried" if self._at >= len(self._all) else ""

    @property
    def best(self) -> tuple[Array, float]:
        return self._all[0], 0.0

    def state(self) -> SearchState:
        return {}


BELIEF = Belief.estimated(Cliff.parameters, np.array([0.7]), np.array([True]), np.array([[0.05**2]]), ("identified",))


def test_a_candidate_that_only_the_best_estimate_likes_is_not_chosen() -> None:
    certain = optimize(Approach(), Cliff(), np.array([[0.7]]), Grid())
    doubting = optimize(Approach(), Cliff(), BELIEF.sample(32, np.random.default_rng(0)), Grid())
    assert certain.unit[certain.best, 0] >= 0.69
    assert 0.5 < doubting.unit[doubting.best, 0] < 0.65  # two to three standard deviations before the edge


def test_more_doubt_keeps_further_away() -> None:
    places = []
    for widen in (0.5, 1.0, 2.0):
        found = optimize(Approach(), Cliff(), BELIEF.sample(32, np.random.default_rng(0), widen=widen), Grid())
        places.append(found.unit[found.best, 0])
    assert places == sorted(places, reverse=True)
    assert places[0] > places[-1] + 0.05


def test_the_search_stays_in_the_trust_region() -> None:
    region = TrustRegion(np.array([0.2]), 0.1)
    found = optimize(Approach(), Cliff(), np.array([[0.7]]), Grid(), region)
    assert found.unit.min() == pytest.approx(0.1)
    assert found.unit.max() == pytest.approx(0.3)
    assert found.unit[found.best, 0] == pytest.approx(0.3)


def test_a_trust_region_widens_on_success_and_narrows_on_failure_within_the_box() -> None:
    region = TrustRegion(np.array([0.9]), 0.3)
    assert region.moved(np.array([0.8]), success=True).radius == pytest.approx(0.6)
    assert region.moved(np.array([0.8]), success=False).radius == pytest.approx(0.15)
    assert region.high[0] == 1.0
    np.testing.assert_allclose(region.outside(region.inside(np.array([0.77]))), [0.77])


def test_candidates_come_out_distinct_and_in_order() -> None:
    found = optimize(Approach(), Cliff(), np.array([[0.7]]), Grid())
    rows = found.distinct(4, 0.1)
    places = found.unit[list(rows), 0]
    assert rows[0] == found.best
    assert np.abs(np.subtract.outer(places, places))[~np.eye(4, dtype=bool)].min() >= 0.1 - 1e-9
    assert (np.diff(found.losses[list(rows)]) >= 0).all()


def test_the_shortlist_begins_with_the_incumbent() -> None:
    region, models = TrustRegion(np.array([0.2]), 0.5), np.array([[0.7]])
    found = optimize(Approach(), Cliff(), models, Grid(), region)
    picked = shortlist(found, region, 2, task=Approach(), simulator=Cliff(), models=models)
    assert picked.incumbent == 0
    assert picked.unit[0, 0] == 0.2
    assert picked.predicted[0] == pytest.approx(0.8)
    assert len(picked.unit) == 3


def test_a_search_interrupted_and_told_its_past_tries_the_rest() -> None:
    seen: list[Tried] = []

    def watch(tried: Tried) -> Tried:
        seen.append(tried)
        return tried

    whole = optimize(Approach(), Cliff(), np.array([[0.7]]), Grid(), watch=watch)
    rest: list[Tried] = []
    resumed = optimize(
        Approach(), Cliff(), np.array([[0.7]]), Grid(), past=seen[:3], watch=lambda t: rest.append(t) or t
    )
    np.testing.assert_array_equal(resumed.losses, whole.losses)
    assert len(rest) == len(seen) - 3
    other = Tried(seen[0].candidates + 1e-16 + 0.1, seen[0].losses, seen[0].means, seen[0].spreads)
    with pytest.raises(CalibrationError, match="other candidates than before"):
        optimize(Approach(), Cliff(), np.array([[0.7]]), Grid(), past=[other])


def test_one_failing_sample_of_many_is_counted_as_the_worst_and_many_failing_ones_are_a_failure() -> None:
    fine = judge(Approach(), Cliff(), np.full((10, 1), 0.999), np.array([[0.95]]))
    assert np.isfinite(fine.losses[0])
    assert np.isnan(judge(Approach(), Cliff(), np.full((10, 1), 0.999), np.array([[0.995]])).losses[0])


def test_where_everything_fails_the_search_says_so() -> None:
    class Top(Grid):
        def ask(self) -> Array:
            return np.full((20, 1), 1.0)

    with pytest.raises(CalibrationError, match="none of"):
        optimize(Approach(), Cliff(), np.array([[0.7]]), Top())


def test_samples_have_the_belief_s_spread_and_stay_within_the_bounds() -> None:
    space = ParameterSpace((Parameter("a", "1", 0.5, 0.0, 1.0), Parameter("b", "1", 1.0, 0.1, 10.0, scale="log"),
                            Parameter("c", "1", 0.2, 0.0, 1.0), Parameter("d", "1", 3.0, 0.0, 4.0, frozen=True)))  # fmt: skip
    covariance = np.array([[0.04**2, 0.6 * 0.04 * 0.1], [0.6 * 0.04 * 0.1, 0.1**2]])
    belief = Belief.estimated(space, np.array([0.5, 2.0, 0.2, 3.0]), np.array([True, True, False, False]), covariance,
                              ("identified", "identified", "not identified", "frozen"))  # fmt: skip
    rows = belief.sample(4001, np.random.default_rng(1))
    np.testing.assert_array_equal(rows[0], [0.5, 2.0, 0.2, 3.0])
    assert rows[:, 0].std() == pytest.approx(0.04, rel=0.05)
    assert np.log(rows[:, 1]).std() == pytest.approx(0.05, rel=0.05)  # 0.1 of 2.0
    assert np.corrcoef(rows[:, 0], np.log(rows[:, 1]))[0, 1] == pytest.approx(0.6, abs=0.05)
    assert rows[:, 2].std() == pytest.approx(0.1, rel=0.2)  # what the recordings could not tell is doubted all the same
    assert (rows[:, 3] == 3.0).all()
    assert rows[:, 2].min() >= 0.0
    assert rows[1:, 0].mean() == pytest.approx(0.5, abs=1e-9)  # in pairs


def test_the_best_is_judged_by_all_its_runs() -> None:
    a, b = np.array([0.1]), np.array([0.9])
    lucky = [np.array([1.0]), np.array([3.0]), np.array([1.8, 1.8])]
    best, score = best_known([a, a, b], lucky)
    assert best[0] == 0.9
    assert score == pytest.approx(1.8)


def test_the_most_telling_run_is_the_one_that_moves_what_is_unsure() -> None:
    class Two(Cliff):
        """x = a * p + b * (1 - p): a run with p = 1 tells a alone."""

        parameters = ParameterSpace((Parameter("a", "1", 0.5, 0.0, 1.0), Parameter("b", "1", 0.5, 0.0, 1.0)))

        def rollout(
            self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
        ) -> list[Rollout]:
            level = values[:, 0] * values[:, 2] + values[:, 1] * (1.0 - values[:, 2])
            return [Rollout(t, {"position": level[:, None, None] * (1.0 + NOW)[None, :, None]}, {}) for t in trials]

    knows_a = Belief.estimated(Two.parameters, np.array([0.5, 0.5]), np.array([True, True]),
                               np.diag([1e-8, 1e-2]), ("identified", "identified"))  # fmt: skip
    settings = np.array([[1.0], [0.5], [0.0]])
    assert most_telling(Approach(), Two(), knows_a, settings, 1).rows == (2,)
    both = most_telling(Approach(), Two(), Belief.prior(Two.parameters), settings, 2)
    assert set(both.rows) == {0, 2}  # two ends together, never the middle
    assert both.gains[0] > 0.0
    points = spread_settings(TrustRegion(np.array([0.3, 0.3]), 0.2), 12, np.random.default_rng(0))
    np.testing.assert_array_equal(points[0], [0.3, 0.3])
    assert ((points >= 0.1) & (points <= 0.5)).all()


def test_a_trial_beyond_a_limit_is_not_handed_out_and_says_which() -> None:
    limits = Limits(
        ("elbow",), np.array([-1.0]), np.array([1.0]), np.array([2.0]), np.array([np.nan]), {"y": (0.0, 1.0)}
    )
    observed = {"position": Observed(("elbow",), "rad", NOW)}

    def planned(values: Array, path: Array | None = None) -> Trial:
        references = {} if path is None else {"path": Reference(("x", "y"), ("m", "m"), path)}
        command = Channel("command", ("elbow",), "rad", NOW, values)
        return Trial("reach", 0.0, 1.0, command, observed, limits=limits, references=references)

    require_safe(planned(0.9 * NOW[:, None]))
    assert "'elbow' is commanded to 1.2 rad (allowed: -1 to 1)" in exceeded(planned(1.2 * NOW[:, None]))[0]
    fast = planned(np.where(NOW > 0.5, 0.5, 0.0)[:, None])
    assert "move at 5 rad/s (allowed: -2 to 2)" in exceeded(fast)[0]
    with pytest.raises(TrialError, match=r"'reach' is not handed out: 'y' of reference 'path' reaches 1.5 m"):
        require_safe(planned(np.zeros((len(NOW), 1)), np.array([[0.0, 0.5], [9.0, 1.5]])))
