# SPDX-License-Identifier: Apache-2.0
"""A simulator whose servos answer wrongly agrees better with a robot once it is grounded, and refuses what is strange."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
import servo_problem

from trueup.arrays import Array
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.engines.simulator import Simulator, broken
from trueup.errors import GroundingError
from trueup.grounding.blend import blended, compared, with_inverse
from trueup.grounding.grounded import GroundedController, GroundedSimulator
from trueup.grounding.learn import Learned, Wishes, learn
from trueup.recording import Recording
from trueup.trial import Trial

NOTHING = np.zeros(0)


def joint_errors(simulator: Simulator, recordings: Sequence[Recording], values: Array) -> Array:
    """(b, recordings) root mean squared errors of replayed joints."""
    return compared(simulator, recordings, values).of("position")


@pytest.fixture(scope="module")
def robot() -> list[Recording]:
    """Seven runs of soft, late servos."""
    rng = np.random.default_rng(1)
    truth = {**servo_problem.NOMINAL, "kp": 12.0, "delay": 0.03}
    return [servo_problem.record(f"run {k}", truth, rng, 6.0) for k in range(7)]


@pytest.fixture(scope="module")
def learned(robot: list[Recording]) -> Learned:
    return learn(robot[:5], Wishes(learners=("linear", "model-tree"), by_row=False))


@pytest.fixture(scope="module")
def simulator(tmp_path_factory: pytest.TempPathFactory) -> MujocoSimulator:
    """The same arm with servos that do nearly as they are told, at once."""
    path = tmp_path_factory.mktemp("model") / "arm.xml"
    stiff = {**servo_problem.NOMINAL, "kp": 400.0, "damping": 12.0, "friction": 0.0}
    path.write_text(servo_problem.ARM.format(**stiff), encoding="utf-8")
    return MujocoSimulator(load(path), step=0.002, threads=1)


def test_grounding_makes_a_simulator_replay_runs_that_were_held_out(
    robot: list[Recording], learned: Learned, simulator: MujocoSimulator
) -> None:
    before = joint_errors(simulator, robot[5:], NOTHING[None])
    forward, found = blended(learned.grounding, simulator, robot[:5], NOTHING)
    both, _ = blended(with_inverse(learned.grounding, simulator, robot[:5], NOTHING), simulator, robot[:5], NOTHING)
    after, inverted = (joint_errors(GroundedSimulator(simulator, g), robot[5:], NOTHING[None]) for g in (forward, both))
    assert found.best > 0.0
    assert np.all(after < 0.8 * before)  # the paper's way
    assert np.all(inverted < 0.4 * before)  # with the simulator's inverse model


def test_a_model_that_goes_on_from_its_own_predictions_replays_better_than_through_simulated_joints(
    robot: list[Recording], learned: Learned, simulator: MujocoSimulator
) -> None:
    through, chained = (
        joint_errors(
            GroundedSimulator(simulator, dataclasses.replace(learned.grounding.weighted(0.0, 1.0), chained=own)),
            robot[5:], NOTHING[None],
        )
        for own in (False, True)
    )  # fmt: skip
    assert np.all(chained < 0.5 * through)
    assert np.all(chained < 0.4 * joint_errors(simulator, robot[5:], NOTHING[None]))


def test_all_of_what_is_requested_is_the_simulator_as_it_is(
    robot: list[Recording], learned: Learned, simulator: MujocoSimulator
) -> None:
    trials = [Trial.of(robot[5], ["position"])]
    (plain,) = simulator.rollout(trials, NOTHING[None])
    (grounded,) = GroundedSimulator(simulator, learned.grounding.weighted(1.0, 0.0)).rollout(trials, NOTHING[None])
    assert grounded.trial is trials[0]
    # Played commands are averaged over each step, a controller's are held: half a step of 2 ms.
    assert np.abs(grounded.channels["position"] - plain.channels["position"]).max() < 5e-3


def test_commands_outside_of_what_was_learned_are_refused_and_named(
    robot: list[Recording], learned: Learned, simulator: MujocoSimulator
) -> None:
    trial = Trial.of(robot[5], ["position"])
    command = trial.command
    assert command is not None
    shifted = np.array(command.values)
    shifted[len(shifted) // 2 :, 1] += 4.0
    strange = dataclasses.replace(trial, name="strange", command=command.replace(values=shifted))
    grounded = GroundedSimulator(simulator, learned.grounding.weighted(0.7, 0.3))
    usual, refused = grounded.rollout([trial, strange], NOTHING[None])
    assert not usual.failures
    assert "elbow" in refused.failures[0]
    assert "outside of what was learned" in refused.failures[0]
    said = broken([refused], grounded)
    assert "learn from runs of its kind too" in said
    assert "shorter" not in said  # nothing is wrong with the step
    values = refused.channels["position"][0]
    assert np.isfinite(values[: len(values) // 2]).all()
    assert np.isnan(values[-1]).all()
    (taken,) = dataclasses.replace(grounded, extrapolate=True).rollout([strange], NOTHING[None])
    assert not taken.failures


def test_rows_of_a_batch_are_grounded_each_by_itself(
    robot: list[Recording], learned: Learned, simulator: MujocoSimulator
) -> None:
    weights = np.array([[1.0, 0.0], [0.7, 0.3]])
    trials = [Trial.of(r, ["position"]) for r in robot[5:]]
    both = GroundedSimulator(simulator, learned.grounding, weights=weights).rollout(trials, np.zeros((2, 0)))
    for row, (a, b) in enumerate(weights):
        alone = GroundedSimulator(simulator, learned.grounding.weighted(a, b)).rollout(trials, NOTHING[None])
        for whole, one in zip(both, alone, strict=True):
            assert np.allclose(whole.channels["position"][row], one.channels["position"][0], atol=1e-9)


def test_a_controller_that_does_not_fit_is_named(learned: Learned) -> None:
    class Slow:
        period = 0.013

        def reset(self, observation: object) -> None: ...

        def command(self, observation: object) -> np.ndarray:
            return np.zeros((1, 2))

    with pytest.raises(GroundingError, match="13 ms does not divide"):
        GroundedController(Slow(), learned.grounding, servo_problem.JOINTS)
    Slow.period = 0.03
    with pytest.raises(GroundingError, match="30 ms is no whole number of the grounding's frames of 20 ms"):
        GroundedController(Slow(), learned.grounding, servo_problem.JOINTS)
    with pytest.raises(GroundingError, match=r"'elbow'.*it commands: shoulder, wrist"):
        GroundedController(Slow(), learned.grounding, ("shoulder", "wrist"))
