# SPDX-License-Identifier: Apache-2.0
"""The contract of simulators is kept by MuJoCo and vehicles (in their own tests), and the check finds what breaks it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.controllers.controller import Controller, ControllerFactory, Observation
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.simulator import Rollout, Simulator
from trueup.errors import ModelError
from trueup.recording import Channel, Recording
from trueup.testing import check_simulator
from trueup.testing.broken import ContractBrokenError
from trueup.trial import Trial

Array = NDArray[np.float64]
CART = """<mujoco><worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/>
  <inertial pos="0 0 0" mass="2" diaginertia=".1 .1 .1"/></body></worldbody>
  <actuator><position name="push" joint="x" kp="20" kv="4"/></actuator></mujoco>"""
Trials = Sequence[Trial]


def cart(tmp_path: Path) -> MujocoSimulator:
    (tmp_path / "cart.xml").write_text(CART)
    model = load(tmp_path / "cart.xml")
    return MujocoSimulator(model, *declare(model, [Declaration("damping", ("x",)), Declaration("kp", ("push",))]))


def recording() -> Recording:
    time = np.arange(101) / 50.0
    values = 0.1 * np.sin(3.0 * time)[:, None]
    return Recording("r", {n: Channel(n, ("x",), "rad", time, values) for n in ("command", "position")})


class Faulty:
    """A simulator that does all as the whole one does, but for one thing."""

    def __init__(self, whole: Simulator, fault: Callable[[Simulator, Trials, Array, object], list[Rollout]]) -> None:
        self._whole, self._fault = whole, fault

    def __getattr__(self, name: str) -> object:
        return getattr(self._whole, name)

    def rollout(self, trials: Trials, values: Array, controllers: ControllerFactory | None = None) -> list[Rollout]:
        return self._fault(self._whole, trials, values, controllers)


def blanking(whole: Simulator, trials: Trials, values: Array, controllers: ControllerFactory | None) -> list[Rollout]:
    done = whole.rollout(trials, values, controllers)
    for rollout in done:
        for row in rollout.ends:
            rollout.channels["position"][row] = np.nan
    return done


class Unaware:
    """A controller that is not told in which trial it is."""

    def __init__(self, told: Controller) -> None:
        self._told, self.period = told, told.period

    def reset(self, observation: Observation) -> None:
        self._told.reset(replace(observation, trial=None))

    def command(self, observation: Observation) -> Array:
        return self._told.command(replace(observation, trial=None))


def without(*fields: str) -> Callable[[Simulator, Trials, Array, ControllerFactory | None], list[Rollout]]:
    """Ignores what a trial declares."""

    def rollout(
        whole: Simulator, trials: Trials, values: Array, controllers: ControllerFactory | None
    ) -> list[Rollout]:
        plain = [replace(t, **{name: () for name in fields}) for t in trials]  # type: ignore[arg-type]
        done = whole.rollout(plain, values, controllers)
        return [replace(r, trial=t) for r, t in zip(done, trials, strict=True)]

    return rollout


def guessing(whole: Simulator, trials: Trials, values: Array, controllers: ControllerFactory | None) -> list[Rollout]:
    return whole.rollout(trials, values, controllers and (lambda v: Unaware(controllers(v))))


def deaf(whole: Simulator, trials: Trials, values: Array, controllers: ControllerFactory | None) -> list[Rollout]:
    return whole.rollout([replace(t, controller=None) for t in trials], values, controllers)


def fatal(whole: Simulator, trials: Trials, values: Array, controllers: ControllerFactory | None) -> list[Rollout]:
    done = whole.rollout(trials, values, controllers)
    return [replace(r, failures={**r.failures, **dict.fromkeys(r.ends, "it fell")}) for r in done]


def refusing(whole: Simulator, trials: Trials, values: Array, controllers: ControllerFactory | None) -> list[Rollout]:
    if any(t.ends for t in trials):
        raise ModelError("cannot do that")
    return whole.rollout(trials, values, controllers)


def test_a_cart_keeps_it(tmp_path: Path) -> None:
    check_simulator(cart(tmp_path), recording())


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (without("ends"), "not in Rollout.ends"), (without("disturbances"), "disturbances: another seed gave the same"),
        (without("sensing"), "sensing: another seed gave the same"), (blanking, "before an end is not what it is without"),
        (guessing, "Observation.trial is None"), (deaf, "own controller goes before"), (fatal, "an outcome, not a failure"),
        (refusing, "must name it and the simulator; it says: cannot do that"),
    ],
)  # fmt: skip
def test_what_breaks_it_is_found(
    tmp_path: Path, fault: Callable[[Simulator, Trials, Array, object], list[Rollout]], words: str
) -> None:
    broken: Simulator = Faulty(cart(tmp_path), fault)  # type: ignore[assignment]
    with pytest.raises(ContractBrokenError, match=words):
        check_simulator(broken, recording())
