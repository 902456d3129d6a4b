# SPDX-License-Identifier: Apache-2.0
"""Winners that hold: what succeeds by luck or at one step only is told from what succeeds again, the sturdiest first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.chance import StartScatter
from trueup.controllers.controller import Controller, ControllerFactory
from trueup.engines.simulator import Rollout
from trueup.errors import CalibrationError
from trueup.loop.confirm import holds, hunt, margin
from trueup.loop.optimize import TrustRegion, optimize
from trueup.loop.transfer import shortlist
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Recording
from trueup.search.cma_es import CmaEs
from trueup.trial import Observed, Trial

Array = NDArray[np.float64]

LEDGES = {"narrow": (3.5, 0.012), "coarse": (0.5, 0.08), "wide": (1.5, 0.06), "broad": (2.5, 0.1)}
NOISE = (StartScatter("position", 0.02),)


@dataclass(frozen=True)
class Jump:
    """A jump lands where it was aimed at, but for what the start was off."""

    step: float = 0.004
    broken: bool = False
    name: str = "jump"
    parameters: ParameterSpace = field(default_factory=lambda: ParameterSpace(()))

    def at_step(self, step: float) -> Jump:
        return replace(self, step=step)

    def shipped(self) -> Jump:
        return self

    def observable(self, recording: Recording) -> tuple[str, ...]:
        return ("position",)

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        (trial,) = trials
        landed = values[:, 0].copy()
        for scatter in trial.disturbances:
            if not isinstance(scatter, StartScatter):
                continue
            landed += scatter.deviation * trial.settled().streams("start", len(values)).normal()
        seen = np.stack([landed, np.full(len(landed), self.step)], axis=1)[:, None]
        failures = dict.fromkeys(range(len(values)), "it became unstable after 0.2 s") if self.broken else {}
        return [Rollout(trial, {"position": seen}, failures)]


class Landing:
    """The task: land on a ledge; the narrow one looks best, and 'coarse' is there at coarse steps only."""

    name = "landing"
    parameters = ParameterSpace((Parameter("aim", "m", 2.0, 0.0, 4.0),))
    trials = (Trial("jump", 0.0, 1.0, None, {"position": Observed(("x", "step"), "m", np.zeros(1))}),)

    def controllers(self, values: Array) -> Controller:
        raise NotImplementedError

    def score(self, rollouts: Sequence[Rollout]) -> Array:
        x = rollouts[0].channels["position"][:, 0, 0]
        best = {"narrow": 0.0, "coarse": 0.5, "wide": 1.0, "broad": 1.5}
        return np.min([best[n] + 10.0 * np.abs(x - at) for n, (at, _) in LEDGES.items()], axis=0)

    def succeeded(self, rollouts: Sequence[Rollout]) -> NDArray[np.bool_]:
        x, step = rollouts[0].channels["position"][:, 0].T
        on = {n: np.abs(x - at) < half for n, (at, half) in LEDGES.items()}
        return on["narrow"] | on["wide"] | on["broad"] | (on["coarse"] & (step > 0.003))


class Everywhere(CmaEs):
    """A search that goes on looking everywhere, and tells nothing from losses."""

    def ask(self) -> Array:
        return self._rng.uniform(size=(20, 1))

    def tell(self, candidates: Array, losses: Array) -> None:
        return


def test_what_succeeds_by_luck_or_at_one_step_only_does_not_hold() -> None:
    rng = np.random.default_rng(0)
    shares = {n: holds(Landing(), Jump(), np.array([at]), rng, noise=NOISE)[0] for n, (at, _) in LEDGES.items()}
    assert len(shares["wide"]) == len(shares["broad"]) == 3
    assert len(shares["narrow"]) == 0  # noise of 0.02 m leaves a ledge of 0.012 m
    assert len(shares["coarse"]) == 1
    assert all(share >= 5 / 6 for share in shares["wide"])


def test_a_hunt_brings_home_distinct_winners_the_sturdiest_first() -> None:
    seen: list[tuple[int, float, int]] = []
    found = hunt(
        Landing(), Jump(), np.random.default_rng(1), Everywhere(np.array([0.5]), seed=1), wanted=2, apart=0.15,
        noise=NOISE, simulations=4000, watch=lambda *now: seen.append(now),
    )  # fmt: skip
    places = [float(w.values[0]) for w in found.winners]
    assert places == pytest.approx([2.5, 1.5], abs=0.1)
    assert found.winners[0].margin > found.winners[1].margin
    assert found.doubted > 0
    assert found.ended == "2 found"
    assert seen[-1][0] < found.simulations  # the last replays, which rank them, were counted too


def test_margins_tell_how_much_more_than_its_noise_a_candidate_stands() -> None:
    margins, spent = margin(
        Landing(), Jump(), [np.array([1.5]), np.array([2.5])], np.random.default_rng(0), noise=NOISE, replays=200
    )
    # Of normal noise with a deviation of 0.04, 0.08 and 0.16 m, so much keeps within 0.06 (or 0.1) m.
    np.testing.assert_allclose(margins, [0.560, 0.735], atol=0.05)
    assert spent == 2 * 3 * 200


def test_what_goes_to_the_robot_is_what_succeeds_again_not_what_scores_best() -> None:
    models, region = np.zeros((2, 0)), TrustRegion(np.array([0.5]), 0.5)
    search = Everywhere(np.array([0.5]), seed=3)
    optimum = optimize(Landing(), Jump(), models, search, evaluations=600)
    best = float(Landing.parameters.from_unit(optimum.unit[optimum.best])[0])
    assert abs(best - LEDGES["narrow"][0]) < LEDGES["narrow"][1]
    picked = shortlist(
        optimum, region, 1, incumbent=False, apart=0.05, task=Landing(), simulator=Jump(), models=models
    )  # fmt: skip
    place = float(Landing.parameters.from_unit(picked.unit[0])[0])
    assert any(abs(place - LEDGES[name][0]) < 0.1 for name in ("wide", "broad", "coarse"))


def test_what_is_searched_in_rough_weather_meets_the_same_weather_as_its_rivals() -> None:
    met: list[Array] = []

    @dataclass(frozen=True)
    class Watched(Jump):
        def rollout(
            self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
        ) -> list[Rollout]:
            done = super().rollout(trials, values, controllers)
            if trials[0].chance is not None and trials[0].chance.alike:
                met.append(done[0].channels["position"][:, 0, 0] - values[:, 0])
            return done

    search = Everywhere(np.array([0.5]), seed=1)
    hunt(Landing(), Watched(), np.random.default_rng(0), search, noise=NOISE, rough=NOISE, simulations=100)
    assert len(met) > 2
    assert all(np.ptp(weather) < 1e-12 for weather in met)
    assert np.ptp([weather[0] for weather in met]) > 0.005


def test_simulations_that_run_out_and_engines_that_diverge_are_said() -> None:
    out = hunt(
        Landing(), Jump(), np.random.default_rng(0), Everywhere(np.array([0.5]), seed=1), noise=NOISE, simulations=30
    )
    assert out.ended.startswith("stopped after")
    with pytest.raises(CalibrationError, match=r"'landing'.* 4 ms: it became unstable after 0\.2 s.* shorter step"):
        hunt(Landing(), Jump(broken=True), np.random.default_rng(0), Everywhere(np.array([0.5]), seed=1))
