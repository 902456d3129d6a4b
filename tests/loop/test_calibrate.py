# SPDX-License-Identifier: Apache-2.0
"""What a calibration promises: the optimum from anywhere, weights by noise, words for what cannot be told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.discrepancies.weighted import Weighted
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.errors import CalibrationError
from trueup.loop.calibrate import Options, _searched, calibrate
from trueup.loop.fit import DESCENT, fit
from trueup.loop.problem import Problem
from trueup.loop.recalibrate import Earlier, recalibrate
from trueup.loop.watch import Watch
from trueup.parameters import ParameterSpace
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]
JOINTS = ("shoulder", "elbow")
STEP, EVERY = 0.001, 10

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <default>
    <joint axis="0 1 0" damping="{damping}" frictionloss="{friction}" armature="{armature}"
           solimpfriction="0.999 0.999 0.001"/>
    <position kp="{kp}"/>
  </default>
  <worldbody>
    <body>
      <joint name="shoulder"/><inertial pos="0 0 -0.12" mass="0.6" diaginertia="0.004 0.004 0.001"/>
      <body pos="0 0 -0.25">
        <joint name="elbow"/><inertial pos="0 0 -0.1" mass="{mass}" diaginertia="0.002 0.002 0.0005"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="shoulder" joint="shoulder"/><position name="elbow" joint="elbow"/></actuator>
</mujoco>
"""
TRUTH = {"kp": 18.0, "damping": 0.5, "friction": 0.08, "armature": 0.015, "mass": 0.4}
ALONE = Options(cross_validate=False, lacking=False)
LINES = [Declaration("kp"), Declaration("damping"), Declaration("friction"), Declaration("armature")]


def command(seed: int, duration: float = 4.0) -> Array:
    rng = np.random.default_rng(seed)
    time = STEP * EVERY * np.arange(round(duration / (STEP * EVERY)))[:, None, None]
    waves = np.sin(2 * np.pi * rng.uniform(0.2, 2.0, (4, 2)) * time + rng.uniform(0, 6, (4, 2))).sum(axis=1)
    return 0.25 * waves * np.clip(time[:, 0] / 0.5, 0, 1)


def record(name: str, asked: Array, noise: dict[str, float], seed: int = 0) -> Recording:
    """The truth by plain MuJoCo."""
    model = mujoco.MjModel.from_xml_string(ARM.format(**TRUTH))
    data = mujoco.MjData(model)
    rows = {"position": np.empty_like(asked), "velocity": np.empty_like(asked)}
    for k in range(len(asked)):
        rows["position"][k], rows["velocity"][k] = data.qpos, data.qvel
        data.ctrl[:] = asked[k]
        mujoco.mj_step(model, data, EVERY)
    rng = np.random.default_rng(seed)
    time = STEP * EVERY * np.arange(len(asked), dtype=np.float64)
    channels = {"command": Channel("command", JOINTS, "rad", time, asked)}
    for role, sigma in noise.items():
        unit = "rad" if role == "position" else "rad/s"
        values = rows[role] + sigma * rng.standard_normal(asked.shape)
        channels[role] = Channel(role, JOINTS, unit, time, values)
    return Recording(name, channels)


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    return [record(f"r{i}", command(i, 4.0 - i), {"position": 3e-4}, i) for i in range(3)]


@pytest.fixture
def simulator(tmp_path: Path) -> Callable[..., MujocoSimulator]:
    """Makes a simulator of the arm with wrong values and these declarations."""

    def make(lines: list[Declaration] | None = None) -> MujocoSimulator:
        path = tmp_path / "arm.xml"
        wrong = {**TRUTH, "kp": 10.0, "damping": 0.2, "friction": 0.03, "armature": 0.008}
        path.write_text(ARM.format(**wrong), encoding="utf-8")
        model = load(path)
        return MujocoSimulator(model, *declare(model, lines or LINES), step=STEP)

    return make


def test_starts_on_bounds_and_far_off_reach_the_optimum(
    simulator: Callable[..., MujocoSimulator], recordings: list[Recording]
) -> None:
    made = simulator()
    space = made.parameters
    short = [r.slice(0.0, 2.0) for r in recordings[:2]]
    problem = Problem(made, short, Weighted.estimated(short, ["position"]))
    rng = np.random.default_rng(1)
    truth = np.repeat([TRUTH[k] for k in ("kp", "damping", "friction", "armature")], 2)
    reached = 0
    for i in range(8):
        far = truth * 10.0 ** rng.choice([-1, 1], 8) if i % 2 else space.from_unit(rng.integers(0, 2, 8).astype(float))
        start = space.from_unit(np.clip(space.to_unit(far), 0.0, 1.0))
        found = fit(problem, space, start, Watch(), stages=DESCENT)
        reached += bool(np.allclose(found.values, truth, rtol=0.05))
    assert reached >= 7


def test_a_resumed_calibration_ends_where_an_uninterrupted_one_does(
    simulator: Callable[..., MujocoSimulator], recordings: list[Recording]
) -> None:
    states: list[dict[str, object]] = []
    options = Options(select=False, cross_validate=False, lacking=False)
    short = [r.slice(0.0, 1.5) for r in recordings[:2]]
    whole = calibrate(simulator(), short, options=options, checkpoint=states.append)
    assert len(states) > 2
    again = calibrate(simulator(), short, options=options, resume=states[len(states) // 2])
    assert np.allclose(again.values, whole.values, rtol=1e-2)


def test_an_interrupted_calibration_goes_on_in_the_windows_it_had(
    simulator: Callable[..., MujocoSimulator], recordings: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    """How long they are hangs on what was free at first, not on what has been frozen since."""
    freed: list[list[str]] = []

    def cut(problem: Problem, values: Array, space: ParameterSpace, *_: object) -> tuple[object, ...]:
        freed.append([p.name for p in space.parameters if not p.frozen])
        return problem, values, np.inf, []

    monkeypatch.setattr("trueup.loop.calibrate.cut_for_search", cut)
    made, states = simulator(), list[dict[str, Any]]()
    short, options = (
        [r.slice(0.0, 1.5) for r in recordings[:1]],
        Options(cross_validate=False, select=False, lacking=False),
    )
    calibrate(made, short, options=options, checkpoint=states.append)
    held = {made.parameters.names[0]: float(made.parameters.nominal[0])}
    left = {**states[-1]["search"], "point": states[-1]["search"]["point"][1:]}
    calibrate(made, short, options=options, resume={**states[-1], "frozen": held, "search": left})
    assert freed[0] == freed[1]


def test_an_interrupted_calibration_goes_on_with_the_values_at_which_it_held_others(
    simulator: Callable[..., MujocoSimulator],
) -> None:
    """What an earlier look had led to, or that of a structure that is not there, not where they began."""
    space = simulator().parameters
    name = space.names[0]
    left, chosen = _searched(space, (), {"frozen": {name: 1.25}})
    assert left[name].frozen
    assert left[name].nominal == 1.25
    assert chosen


def test_later_recordings_cost_a_third_of_a_search_anew_and_are_fitted_as_well(
    simulator: Callable[..., MujocoSimulator], recordings: list[Recording]
) -> None:
    options = ALONE
    first, every = calibrate(simulator(), recordings[1:2], options=options), recordings[1:]
    again = recalibrate(simulator(), every, (), Earlier.of(first), options)
    anew = calibrate(simulator(), every, options=options)
    assert again.evaluations <= 0.35 * anew.evaluations
    for mine, cold in zip(again.estimates, anew.estimates, strict=True):
        assert mine.value == pytest.approx(cold.value, abs=0.5 * (cold.high - cold.low)), mine.name
        assert mine.high - mine.low == pytest.approx(cold.high - cold.low, rel=0.3), mine.name


class ByNorm(Weighted):
    """What others do: each channel divided by its signal's size instead of its noise."""

    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        return np.full(len(labels), {"position": 0.3, "velocity": 3.0}[channel])


def test_weights_by_noise_beat_weights_by_signal_size(simulator: Callable[..., MujocoSimulator]) -> None:
    truth = np.repeat([TRUTH[k] for k in ("kp", "damping", "friction", "armature")], 2)
    noisy = [record(f"r{i}", command(i, 2.0), {"position": 1e-4, "velocity": 0.3}, i) for i in range(2)]
    errors = []
    for measure in (None, ByNorm({})):
        options = Options(search="gradient", select=False, cross_validate=False, robust=np.inf, lacking=False,
                          channels=("position", "velocity"))  # fmt: skip
        result = calibrate(simulator(), noisy, options=options, discrepancy=measure)
        errors.append(np.abs(np.log(result.values / truth)).max())
    assert errors[0] < 0.5 * errors[1]


def test_what_cannot_be_told_is_named_and_not_fitted(
    simulator: Callable[..., MujocoSimulator], recordings: list[Recording]
) -> None:
    result = calibrate(
        simulator([*LINES, Declaration("force_limit", ("elbow",), nominal=50.0)]), recordings[1:2], options=ALONE
    )
    limit = next(e for e in result.estimates if e.name == "elbow.force_limit")
    assert limit.verdict in ("not identified", "no effect")
    assert limit.value == pytest.approx(50.0)
    assert "never met in these recordings" in limit.note


def test_estimates_lie_within_their_intervals_of_the_truth(
    simulator: Callable[..., MujocoSimulator], recordings: list[Recording]
) -> None:
    result = calibrate(simulator(), recordings[1:2], recordings[2:], options=ALONE)
    truth = np.repeat([TRUTH[k] for k in ("kp", "damping", "friction", "armature")], 2)
    assert np.allclose(result.values, truth, rtol=0.03)
    (held_out,) = result.held_out()
    assert held_out.rmse_after().max() < 1.2 * 3e-4  # noise, and the start state estimated from noisy samples
    assert [e.verdict for e in result.estimates] == ["identified"] * 8


def test_frozen_parameters_alone_are_refused(
    simulator: Callable[..., MujocoSimulator], recordings: list[Recording]
) -> None:
    with pytest.raises(CalibrationError, match="all parameters are frozen"):
        calibrate(simulator([Declaration("kp", frozen=True)]), recordings)


@pytest.mark.parametrize("measured", [0.2999, 0.35], ids=["where it was told to be", "where no servo holds it"])
def test_what_a_robot_at_rest_does_not_tell_is_handed_over_as_it_came(
    simulator: Callable[..., MujocoSimulator], measured: float
) -> None:
    time = 0.02 * np.arange(150.0)
    columns = {"command": np.full((150, 2), 0.3), "position": np.full((150, 2), measured)}
    rest = Recording("rest", {n: Channel(n, JOINTS, "rad", time, v) for n, v in columns.items()})
    found = calibrate(simulator([Declaration("kp"), Declaration("friction")]), [rest], options=ALONE)
    assert [e.verdict for e in found.estimates] == ["not identified"] * 4
    assert [e.value for e in found.estimates] == pytest.approx([e.start for e in found.estimates])
    assert all(e.note.endswith("kept at its start value") for e in found.estimates)
    assert any("all is as it came" in note for note in found.notes)
