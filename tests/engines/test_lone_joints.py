# SPDX-License-Identifier: Apache-2.0
"""Joints replayed one by one move as the engine moves them all, where gears make them stiff; where not, it can be seen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.articulated.declarations import Declaration, declare
from trueup.articulated.gains import Gains
from trueup.controllers.controller import ControllerFactory
from trueup.discrepancies.weighted import Weighted
from trueup.engines.mujoco.lone.lone_joints import LoneJoints
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.simulator import Rollout, Simulator
from trueup.inspection.settings import ALL
from trueup.loop.calibrate import Options, calibrate
from trueup.loop.fit import DESCENT, STAGES
from trueup.loop.mixed import Mixed
from trueup.loop.problem import Problem
from trueup.recording import Channel, Recording
from trueup.testing import check_simulator
from trueup.trial import Trial

Array = NDArray[np.float64]

JOINTS = ("base", "shoulder", "elbow")
ARM = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default>
    <joint damping="0.4" frictionloss="0.1" armature="{armature}" solimpfriction="0.99 0.999 0.001"/>
    <position kp="{kp}" kv="0.3" forcerange="-4 4"/>
  </default>
  <worldbody>
    <geom type="plane" size="1 1 1" pos="0 0 {floor}"/>
    <body name="turret">
      <joint name="base" axis="0 0 1"/><inertial pos="0 0 0.05" mass="0.2" diaginertia="2e-4 2e-4 2e-4"/>
      <body name="upper" pos="0 0 0.1">
        <joint name="shoulder" axis="0 1 0"/><inertial pos="0.06 0.01 0" mass="0.15" diaginertia="4e-5 2e-4 2e-4"/>
        <body name="lower" pos="0.12 0 0">
          <joint name="elbow" axis="0 1 0"/><inertial pos="0.08 0 0.01" mass="0.12" diaginertia="3e-5 2e-4 2e-4"/>
          <geom type="sphere" size="0.01" pos="0.1 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="base_servo" joint="base"/>
    <position name="shoulder_servo" joint="shoulder" ctrlrange="-1.2 1.2"/>
    <{elbow} name="elbow_servo" joint="elbow"/>
  </actuator>
</mujoco>
"""
GEARED = {"armature": "0.02", "kp": "25", "elbow": "position", "floor": "-1"}
LINES = [
    Declaration("kp"), Declaration("kv"), Declaration("force_limit"), Declaration("gain"), Declaration("zero"),
    Declaration("delay", tie="all"), Declaration("damping"), Declaration("damping_quadratic"), Declaration("friction"),
    Declaration("friction_creep", tie="all"), Declaration("armature"), Declaration("bias"), Declaration("offset"),
    Declaration("mass", ("lower",)), Declaration("com_x", ("lower",)), Declaration("inertia_d2", ("upper",)),
    Declaration("tilt_roll"), Declaration("sensor_delay", ("position",)), Declaration("clock", ("r",)),
    Declaration("joint_sensor_delay", ("elbow",)),
    Declaration("speed_limit", nominal=4.0), Declaration("acceleration_limit", nominal=60.0),
    Declaration("lead", nominal=0.03),
]  # fmt: skip
LIVE = [
    Declaration("dead_band", nominal=0.02), Declaration("friction_static", nominal=0.1),
    Declaration("stribeck_speed", nominal=0.2), Declaration("friction_load", nominal=0.1),
]  # fmt: skip


@pytest.fixture(autouse=True)
def short_recordings_stand_for_long_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trueup.loop.problem.WORTH", 0.0)


def arm(folder: Path, lines: list[Declaration], **design: str) -> MujocoSimulator:
    path = folder / "arm.xml"
    path.write_text(ARM.format(**{**GEARED, **design}), encoding="utf-8")
    model = load(path)
    names = {"recording": ("r",), "channel": ("position",)}
    return MujocoSimulator(model, *declare(model, lines, names))


def commands(duration: float, seed: int) -> Channel:
    """Multisines on steps at 50 Hz, from rest, with the time stamps of a real clock."""
    rng = np.random.default_rng(seed)
    time = 0.02 * np.arange(round(50 * duration), dtype=np.float64)
    frequency, phase = rng.uniform(0.2, 2.0, (2, 5, len(JOINTS))) * [[[1.0]], [[3.0]]]
    waves = 0.12 * np.sin(2.0 * np.pi * frequency * time[:, None, None] + phase).sum(axis=1)
    steps = rng.uniform(-0.5, 0.5, (int(duration) + 1, len(JOINTS)))[time.astype(int)]
    return Channel("command", JOINTS, "rad", time, np.where(time[:, None] < 0.4, 0.0, waves + steps))


def recorded(
    simulator: MujocoSimulator, duration: float = 6.0, values: Array | None = None, name: str = "r", gain: float = 1.0
) -> Recording:
    """What the arm, nominal or with values (n,), makes of commands, as an encoder of 12 bits sees it."""
    command = commands(duration, ord(name[0]))
    command = command.replace(values=gain * command.values)
    still = Channel("position", JOINTS, "rad", command.time, np.zeros_like(command.values))
    trial = Trial.of(Recording(name, {"command": command, "position": still}))
    (done,) = simulator.rollout([trial], np.atleast_2d(simulator.parameters.nominal if values is None else values))
    grid = 2.0 * np.pi / 4096.0
    seen = grid * np.round(done.channels["position"][0] / grid)
    return Recording(name, {"command": command, "position": still.replace(values=seen)})


def moved(simulator: MujocoSimulator, share: float) -> Array:
    """(n + 1, n) the nominal values, and each parameter moved by a share of its range."""
    space = simulator.parameters
    nominal = np.clip(space.to_unit(space.nominal), 0.05, 0.95)
    return space.from_unit(np.concatenate([nominal[None], nominal + share * np.eye(len(nominal))]))


def positions(simulator: MujocoSimulator | LoneJoints, trial: Trial, values: Array) -> Array:
    (done,) = simulator.rollout([trial], values)
    assert not done.failures
    return done.channels["position"]


def alone(simulator: MujocoSimulator, trial: Trial) -> LoneJoints:
    made = LoneJoints.of(simulator, [trial])
    assert made is not None
    return made


def test_a_geared_arm_moves_as_in_the_engine_within_a_milliradian(tmp_path: Path) -> None:
    simulator = arm(tmp_path, LINES)
    trial = Trial.of(recorded(simulator))
    values = simulator.parameters.nominal[None]
    apart = positions(alone(simulator, trial), trial, values) - positions(simulator, trial, values)
    assert np.abs(apart).max() < 1e-3


@pytest.mark.parametrize(
    ("lines", "drives", "bodies"), [(LINES, 0.05, 0.2), ([Declaration("kp"), *LIVE], 0.1, 0.2)], ids=["fields", "live"]
)
def test_every_quantity_changes_a_lone_joint_as_it_changes_the_arm(
    tmp_path: Path, lines: list[Declaration], drives: float, bodies: float
) -> None:
    """A body's mass moves all joints a little, each of which moves the others: only this is missed."""
    simulator = arm(tmp_path, lines)
    trial = Trial.of(recorded(simulator))
    values = moved(simulator, 0.02)
    exact, lone = (p[1:] - p[0] for p in (positions(s, trial, values) for s in (simulator, alone(simulator, trial))))
    size, error = (np.sqrt(np.mean(change**2, axis=(1, 2))) for change in (exact, lone - exact))
    for quantity, name, a, b in zip(simulator.quantities, simulator.parameters.names, error, size, strict=True):
        share = bodies if quantity.quantity.family == "body" else drives
        assert a < share * b + 1e-5, f"{name}: changes {a:.2g} rad apart, of {b:.2g}"


def test_it_is_a_simulator_like_others(tmp_path: Path) -> None:
    simulator = arm(tmp_path, [Declaration("kp"), Declaration("mass", ("lower",)), Declaration("delay", tie="all")])
    recording = recorded(simulator, 2.0)
    check_simulator(alone(simulator, Trial.of(recording)), recording)


def test_recordings_side_by_side_are_replayed_as_each_by_itself_also_where_one_has_gains_of_its_own(
    tmp_path: Path,
) -> None:
    plain = arm(tmp_path, LINES)
    runs = [recorded(plain, 3.0, name=name) for name in "rst"]
    whole = plain.with_gains(Gains({"kp": {"s": {ALL: 2.0}}}))
    trials = [Trial.of(run, ["position"]) for run in runs]
    values = np.repeat(whole.parameters.nominal[None], 2, axis=0)
    values[1, :4] *= 1.3
    together = whole.approximation(trials)
    assert isinstance(together, LoneJoints)
    for trial, done in zip(trials, together.rollout(trials, values), strict=True):
        alone = LoneJoints.of(whole, [trial])
        assert alone is not None
        (seen,) = alone.rollout([trial], values)
        np.testing.assert_array_equal(done.channels["position"], seen.channels["position"])
    again = whole.at_step(0.004).approximation(trials)
    assert isinstance(again, LoneJoints)
    assert again.dynamics is together.dynamics  # motions that were measured are the same at every step


def test_a_joint_that_only_its_torque_holds_is_seen_to_be_coupled(tmp_path: Path) -> None:
    """A light elbow without gear swings with the arm: what it does to the shoulder and the shoulder to it is no load."""
    simulator = arm(tmp_path, [Declaration("damping")], armature="1e-4", elbow="motor")
    trial = Trial.of(recorded(simulator))
    values = moved(simulator, 0.3)[[1, 3]]
    apart = positions(alone(simulator, trial), trial, values) - positions(simulator, trial, values)
    assert np.abs(apart[..., 2]).max() > 0.05


def test_what_cannot_be_taken_joint_by_joint_is_left_to_the_engine(tmp_path: Path) -> None:
    simulator = arm(tmp_path, [Declaration("backlash", ("elbow",))])
    recording = recorded(arm(tmp_path, []), 2.0)
    assert LoneJoints.of(simulator, [Trial.of(recording)]) is None
    planned = Trial("planned", 0.0, 1.0, recording.channel("command"), Trial.of(recording).observed)
    assert LoneJoints.of(arm(tmp_path, []), [planned]) is None


class Counted:
    """A simulator that counts its steps, and offers its approximation or not."""

    def __init__(self, simulator: Simulator, offers: bool, steps: list[float] | None = None) -> None:
        self.whole, self.offers, self.steps = simulator, offers, [0.0] if steps is None else steps
        self.name, self.parameters, self.step = simulator.name, simulator.parameters, simulator.step
        self.shipped, self.observable = simulator.shipped, simulator.observable

    def at_step(self, step: float) -> Counted:
        return Counted(self.whole.at_step(step), self.offers, self.steps)

    def approximation(self, trials: Sequence[Trial]) -> Simulator | None:
        assert isinstance(self.whole, MujocoSimulator)
        return self.whole.approximation(trials) if self.offers else None

    def rollout(
        self, trials: Sequence[Trial], values: Array, controllers: ControllerFactory | None = None
    ) -> list[Rollout]:
        self.steps[0] += len(np.atleast_2d(values)) * sum(t.duration for t in trials) / self.step
        return self.whole.rollout(trials, values, controllers)


FITTED = [
    Declaration("kp"), Declaration("damping"), Declaration("friction"), Declaration("armature"), Declaration("zero"),
    Declaration("delay", tie="all"), Declaration("mass", ("lower",)),
]  # fmt: skip


def test_a_search_with_lone_joints_is_at_least_as_good_at_an_eighth_of_the_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What estimates owe to the step and to others is asked of the engine once a search has ended, with and without them.
    monkeypatch.setattr("trueup.loop.calibrate.considered", lambda *_: ())
    simulator = arm(tmp_path, FITTED)
    space = simulator.parameters
    away = np.random.default_rng(0).uniform(-0.1, 0.1, len(space))
    truth = space.from_unit(np.clip(space.to_unit(space.nominal), 0.1, 0.9) + away)
    recordings = [recorded(simulator, 6.0, truth, name) for name in ("a", "b")]
    errors, steps = [], []
    for offers in (True, False):
        counted = Counted(simulator, offers)
        fit = calibrate(counted, recordings, options=Options(stages=DESCENT, cross_validate=False, lacking=False))
        errors.append(np.abs(space.to_unit(fit.values) - space.to_unit(truth)))
        steps.append(counted.steps[0])
        assert any("approximation" in note for note in fit.notes) == offers
    assert steps[0] < 0.125 * steps[1]
    assert errors[0].max() < max(errors[1].max(), 0.01)


def problem_of(simulator: MujocoSimulator, recordings: list[Recording]) -> tuple[Problem, Problem]:
    """A problem, and what is approximated of it in the middle of the box."""
    problem = Problem(simulator, recordings, Weighted.estimated(recordings, ["position"]), ("position",))
    space = simulator.parameters
    values = space.from_unit(np.clip(space.to_unit(space.nominal), 0.2, 0.8))
    return problem, problem.approximated(values, problem.residuals(values[None])[0])


def test_joints_that_are_coupled_are_left_to_the_engine(tmp_path: Path) -> None:
    simulator = arm(tmp_path, [Declaration("damping", nominal=0.01)], armature="1e-4", elbow="motor")
    problem, approximated = problem_of(simulator, [recorded(simulator)])
    assert approximated.simulator is problem.simulator


def test_only_the_recording_that_touches_something_is_simulated_by_the_engine(tmp_path: Path) -> None:
    simulator = arm(tmp_path, [Declaration("kp")], floor="-0.05")
    free, stopped = recorded(simulator, 3.0, name="free", gain=0.3), recorded(simulator, 3.0, name="stopped", gain=2.5)
    _, approximated = problem_of(simulator, [free, stopped])
    assert isinstance(approximated.simulator, Mixed)
    assert approximated.simulator.exact == {"stopped"}


def test_joints_alone_that_end_in_another_valley_are_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulator = arm(tmp_path, FITTED)
    space = simulator.parameters
    away = np.random.default_rng(0).uniform(-0.1, 0.1, len(space))
    truth = space.from_unit(np.clip(space.to_unit(space.nominal), 0.1, 0.9) + away)
    recordings = [recorded(simulator, 6.0, truth, name) for name in ("a", "b")]
    monkeypatch.setattr("trueup.loop.joint_by_joint.apart", lambda *_: np.full(len(space), 0.97))
    stages = tuple(s for s in STAGES if s in DESCENT or s.name == "glance")
    fit = calibrate(simulator, recordings, options=Options(stages=stages, cross_validate=False, lacking=False))
    assert not any("approximation" in note for note in fit.notes)
    monkeypatch.setattr("trueup.loop.problem.WORTH", np.inf)
    plain = calibrate(simulator, recordings, options=Options(stages=DESCENT, cross_validate=False, lacking=False))
    np.testing.assert_allclose(fit.values, plain.values, rtol=1e-9)  # as if there had never been any
