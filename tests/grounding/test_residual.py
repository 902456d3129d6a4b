# SPDX-License-Identifier: Apache-2.0
"""What a simulator lacks is found by search in it: added to commands or to joints, it replays a robot, also runs held out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import servo_problem

from trueup.arrays import Array
from trueup.controllers.controller import Observation
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.simulator import InPlaceOf, Rollout, Simulator
from trueup.errors import GroundingError
from trueup.grounding.blend import compared
from trueup.grounding.grounded import GroundedSimulator
from trueup.grounding.grounding import Grounding
from trueup.grounding.learn import Wishes, learn
from trueup.grounding.residual import Response, inverse_replay, with_residual
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.trial import Observed, Trial

NOTHING = np.zeros(0)


def joint_errors(simulator: Simulator, recordings: Sequence[Recording], values: Array) -> Array:
    """(b, recordings) root mean squared errors of replayed joints."""
    return compared(simulator, recordings, values).of("position")


@pytest.fixture(scope="module")
def robot() -> list[Recording]:
    """Four runs of soft, late servos."""
    rng = np.random.default_rng(1)
    truth = {**servo_problem.NOMINAL, "kp": 12.0, "delay": 0.03}
    return [servo_problem.record(f"run {k}", truth, rng, 4.0) for k in range(4)]


@pytest.fixture(scope="module")
def grounding(robot: list[Recording]) -> Grounding:
    return learn(robot[:3], Wishes(learners=("linear",), by_row=False, view="relative", history=3)).grounding


@pytest.fixture(scope="module")
def simulator(tmp_path_factory: pytest.TempPathFactory) -> MujocoSimulator:
    """The same arm with servos that do nearly as they are told, at once."""
    path = tmp_path_factory.mktemp("model") / "arm.xml"
    stiff = {**servo_problem.NOMINAL, "kp": 400.0, "damping": 12.0, "friction": 0.0}
    path.write_text(servo_problem.ARM.format(**stiff), encoding="utf-8")
    return MujocoSimulator(load(path), step=0.002, threads=1)


@pytest.mark.parametrize("torque", [False, True])
def test_what_is_found_to_be_missing_replays_runs_that_were_held_out(
    robot: list[Recording], grounding: Grounding, simulator: MujocoSimulator, torque: bool, tmp_path: Path
) -> None:
    found = inverse_replay(grounding, simulator, robot[:1], NOTHING, torque=torque)
    assert np.all(found.after < 0.02 * found.before)
    made = with_residual(grounding, simulator, robot[:3], NOTHING, torque=torque)
    before = joint_errors(simulator, robot[3:], NOTHING[None])
    through, chained = (
        joint_errors(GroundedSimulator(simulator, dataclasses.replace(made, chained=own)), robot[3:], NOTHING[None])
        for own in (False, True)
    )
    assert np.all(through < 0.5 * before)
    assert np.all(chained < 0.2 * before)  # of states that the robot's model foretells
    made.save(tmp_path / "grounding.npz")
    again = GroundedSimulator(simulator, Grounding.load(tmp_path / "grounding.npz"))
    assert np.array_equal(joint_errors(again, robot[3:], NOTHING[None]), through)


def test_commands_outside_of_what_it_was_found_for_are_refused(
    robot: list[Recording], grounding: Grounding, simulator: MujocoSimulator
) -> None:
    trial = Trial.of(robot[3], ["position"])
    assert trial.command is not None
    strange = dataclasses.replace(trial, command=trial.command.replace(values=trial.command.values + 4.0))
    made = with_residual(grounding, simulator, robot[:1], NOTHING, torque=True)
    usual, refused = GroundedSimulator(simulator, made).rollout([trial, strange], NOTHING[None])
    assert not usual.failures
    assert "outside of what was learned" in refused.failures[0]


def test_a_response_is_recovered_and_answers_an_error_that_it_explains(rng: np.random.Generator) -> None:
    pulse = np.array([[0.2], [0.5], [0.25], [0.05]])
    noise = [rng.standard_normal((200, 1)) for _ in range(2)]
    moved = [np.convolve(n[:, 0], np.concatenate([[0.0], pulse[:, 0]]))[:200, None] for n in noise]
    zero = [np.zeros((200, 1))] * 2
    found = Response.estimated(noise, zero, moved, 6)
    assert np.allclose(found.pulse[:4], pulse, atol=1e-9)
    wanted = np.cumsum(0.1 * rng.standard_normal((200, 1)), axis=0)
    error = np.convolve(wanted[:, 0], np.concatenate([[0.0], pulse[:, 0]]))[:200, None]
    assert np.allclose(found.answer(error, zero[0], np.full(1, 1e-4))[:190], wanted[:190], atol=0.05)


class Pushing:
    """A controller that pushes on one joint with a constant torque and commands nothing."""

    period, forced = 0.02, ("hinge",)

    def __init__(self, copies: int) -> None:
        self.torque = 0.3 * np.arange(1, copies + 1)[:, None]

    def reset(self, observation: Observation) -> None: ...

    def command(self, observation: Observation) -> np.ndarray:
        return np.zeros((len(self.torque), 1))


def test_a_joint_that_is_pushed_accelerates_by_torque_over_inertia(tmp_path: Path) -> None:
    path = tmp_path / "wheel.xml"
    path.write_text(
        "<mujoco><option gravity='0 0 0'/><worldbody><body><joint name='hinge' axis='0 0 1'/>"
        "<inertial pos='0 0 0' mass='1' diaginertia='.1 .1 .2'/></body></worldbody>"
        "<actuator><motor name='m' joint='hinge' ctrlrange='-.01 .01'/></actuator></mujoco>", encoding="utf-8"
    )  # fmt: skip
    time = np.arange(26, dtype=np.float64) * 0.02
    trial = Trial("push", 0.0, 0.5, None, {"velocity": Observed(("hinge",), "rad/s", time)})
    simulator = MujocoSimulator(load(path), step=0.002, threads=1)
    (done,) = simulator.rollout([trial], np.zeros((3, 0)), lambda values: Pushing(len(values)))
    expected = 0.3 * np.arange(1, 4)[:, None] / 0.2 * time
    assert np.allclose(done.channels["velocity"][:, :, 0], expected, atol=1e-6)


@dataclasses.dataclass(frozen=True, eq=False)
class Sealed(InPlaceOf):
    """A simulator that nobody can push into."""

    whole: Simulator

    @property
    def parameters(self) -> ParameterSpace:
        return self.whole.parameters

    def at_step(self, step: float) -> Sealed:
        return self

    def rollout(self, *args: object, **more: object) -> list[Rollout]:
        raise NotImplementedError


def test_a_simulator_whose_joints_cannot_be_pushed_is_said(
    robot: list[Recording], grounding: Grounding, simulator: MujocoSimulator
) -> None:
    with pytest.raises(GroundingError, match="no joints that can be pushed on"):
        with_residual(grounding, Sealed(simulator), robot, NOTHING, torque=True)
    made = dataclasses.replace(grounding, torque=True)
    with pytest.raises(GroundingError, match="no joints that can be pushed on"):
        GroundedSimulator(Sealed(simulator), made).rollout([Trial.of(robot[0], ["position"])], NOTHING[None])
