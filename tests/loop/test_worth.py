# SPDX-License-Identifier: Apache-2.0
"""Parameters are chosen by what they do and by what recordings tell of them, and what is expected comes true."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.discrepancies.weighted import Weighted
from trueup.errors import CalibrationError
from trueup.loop.prepare import prepare
from trueup.loop.problem import Problem
from trueup.loop.whole_runs import whole_runs
from trueup.loop.worth import worth_calibrating
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel
from trueup.trial import Observed, Trial

Array = NDArray[np.float64]
SPACE = ParameterSpace(tuple(Parameter(n, "", 0.5, 0.0, 1.0) for n in "abcdef"))
SAMPLES = 50


@dataclass
class Linear:
    """Recordings whose residuals are X z: what a Problem is near one point."""

    x: Array
    trials: tuple[None] = (None,)
    segments: list[Any] = field(init=False)

    def __post_init__(self) -> None:
        m = len(self.x)
        self.segments = [SimpleNamespace(columns=slice(0, m), count=m, channel="position")]

    def residuals(self, values: Array) -> Array:
        return values @ self.x.T


def problems(rng: np.random.Generator) -> tuple[Any, Any]:
    """A and b do the same, c something else; d matters to the recordings alone, e to the outcome alone, f to nothing."""
    seen, wanted = np.zeros((2, SAMPLES, 6))
    seen[:, 0] = seen[:, 1] = 4.0 * rng.standard_normal(SAMPLES)
    seen[:, 2], seen[:, 3] = 3.0 * rng.standard_normal((2, SAMPLES))
    wanted[:, 0] = wanted[:, 1] = 4.0 * rng.standard_normal(SAMPLES)
    wanted[:, 2], wanted[:, 4] = 2.0 * rng.standard_normal((2, SAMPLES))
    return Linear(seen), Linear(wanted)


def test_what_matters_and_can_be_told_is_taken_and_the_rest_is_left_for_a_reason() -> None:
    seen, wanted = problems(np.random.default_rng(0))
    choice = worth_calibrating([seen], SPACE, [wanted], rng=np.random.default_rng(2))
    assert sorted(choice.chosen) in (["a", "c"], ["b", "c"])
    why = {w.name: w.why for w in choice.rows}
    other = "b" if "a" in choice.chosen else "a"
    assert "done by those taken, most of all by " + choice.chosen[0] in why[other]
    assert "hardly depends" in why["d"]
    assert "leave it open" in why["e"]
    assert "hardly depends" in why["f"]
    assert choice.notes[0].startswith("2 of 6 parameters are worth calibrating")
    assert [p.name for p in choice.of(SPACE).parameters if not p.frozen] == sorted(choice.chosen)


def test_the_expected_error_is_the_one_that_fits_to_noisy_recordings_have() -> None:
    rng = np.random.default_rng(1)
    seen, wanted = problems(rng)
    choice = worth_calibrating([seen], SPACE, [wanted], rng=np.random.default_rng(2))
    s = [SPACE.index(n) for n in choice.chosen]
    truth, x = rng.uniform(-0.5, 0.5, (4000, 6)), seen.x[:, s]  # anywhere in the range: of a variance of 1 / 12
    measured = truth @ seen.x.T + rng.standard_normal((4000, SAMPLES))  # 50 independent samples of noise 1
    found = np.zeros_like(truth)
    found[:, s] = np.linalg.solve(x.T @ x + 12.0 * np.eye(len(s)), x.T @ measured.T).T
    error = np.sqrt(np.mean(((truth - found) @ wanted.x.T) ** 2))
    assert choice.expected[1] == pytest.approx(error, rel=0.03)
    assert choice.expected[0] == pytest.approx(np.sqrt(np.mean((truth @ wanted.x.T) ** 2)), rel=0.03)


def test_nothing_free_is_said() -> None:
    seen, _ = problems(np.random.default_rng(0))
    with pytest.raises(CalibrationError, match="no parameter is free"):
        worth_calibrating([seen], SPACE.freeze(SPACE.names), rng=np.random.default_rng(0))


CART = """<mujoco><worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0" damping="1"/>
  <inertial pos="0 0 0" mass="2" diaginertia=".1 .1 .1"/></body></worldbody>
  <actuator><position name="push" joint="x" kp="20" kv="4"/></actuator></mujoco>"""


def test_of_two_dampings_that_do_the_same_one_is_calibrated(tmp_path: Path) -> None:
    (tmp_path / "cart.xml").write_text(CART)
    lines = ("kp", "push"), ("kv", "push"), ("damping", "x")
    (tmp_path / "wide.toml").write_text("".join(f'[[parameter]]\nquantity = "{q}"\nof = "{n}"\n' for q, n in lines))
    time = np.arange(201) / 50.0
    waves = 0.1 * np.sign(np.sin(3.0 * time))[:, None]
    robot = prepare(tmp_path / "cart.xml", [], parameters=tmp_path / "wide.toml").simulator
    trial = Trial(
        "r", 0.0, 4.0, Channel("command", ("x",), "m", time, waves), {"position": Observed(("x",), "m", time)}
    )
    (run,) = robot.rollout([trial], robot.parameters.nominal[None] * [1.3, 0.8, 1.0])
    made = run.recording()
    noisy = made.channel("position").values + 1e-3 * np.random.default_rng(0).standard_normal((201, 1))
    made = made.with_channel(made.channel("position").replace(values=noisy))
    ready, choice = prepare(tmp_path / "cart.xml", [made], parameters=tmp_path / "wide.toml").worthwhile()
    free = {p.name for p in ready.simulator.parameters.parameters if not p.frozen}
    assert free == set(choice.chosen)
    assert len(free) == 2
    assert any(name.endswith("kp") for name in free)
    space = ready.simulator.parameters
    problem = Problem(ready.simulator, [made], Weighted.estimated([made], ["position"]), ["position"])
    found = whole_runs([problem], space, seed=0, generations=0, members=1, descents=4, prior=1e-6)
    frozen = ~space.free
    assert np.array_equal(found.values[0][frozen], space.nominal[frozen])
    name = next(n for n in space.names if n.endswith("kp"))
    assert found.values[0][space.index(name)] == pytest.approx(1.3 * space[name].nominal, rel=0.02)


def test_structures_that_are_left_out_are_not_there_and_what_a_file_says_stays() -> None:
    limit = Parameter("limit", "rad/s", 1.2, 0.1, 50.0, optional="speed limit", absent=1e4)
    declared = limit.replace(name="declared", optional="")
    space = ParameterSpace((limit, declared, Parameter("kp", "", 40.0, 1.0, 100.0)))
    left = space.left_out(["limit", "declared"])
    assert left.nominal.tolist() == [1e4, 1.2, 40.0]
    assert left.free.tolist() == [False, False, True]
