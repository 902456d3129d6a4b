# SPDX-License-Identifier: Apache-2.0
"""Calibration on whole runs of a humanoid: what a fall shows is found, what it does not tell stays open in the ensemble."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.discrepancies.whole_body import WholeBody
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.errors import RecordingError
from trueup.loop.problem import Problem
from trueup.loop.whole_runs import losses, whole_body, whole_runs
from trueup.studies.balance.calibration import CHANNELS, declared
from trueup.studies.balance.robot import led
from trueup.studies.balance.scenes import model_of, transition

Array = NDArray[np.float64]

FREE = ("kp", "kd.damping", "torso.com_x", "torso.com_z", "l_arm+r_arm.com_y")


@pytest.fixture(scope="module")
def falling() -> tuple[Problem, Array]:
    """A robot with softer servos and its weight further back pushes itself off the wall; its true values."""
    space, assignments = declared("lean-to-stand", "parameters")
    space = space.freeze([n for n in space.names if n not in FREE])
    simulator = MujocoSimulator(model_of("lean-to-stand"), space, assignments, step=0.004)
    _, task = transition("lean-to-stand", step=0.004)
    (planned,) = task.planned(np.array([0.3]))
    truth = np.array(space.nominal)
    truth[[space.index("kp"), space.index("torso.com_x")]] = 7.0, -0.018
    recording = simulator.rollout([led(planned)], truth[None])[0].recording()
    return Problem(simulator, [recording], WholeBody(), CHANNELS, ends=task.trials[0].ends), truth


def test_what_a_run_shows_is_recovered_and_what_it_does_not_tell_differs_between_members(
    falling: tuple[Problem, Array],
) -> None:
    problem, _ = falling
    space = problem.simulator.parameters
    found = whole_runs([problem], space, seed=0, population=12, generations=3, members=3, descents=5, prior=1e-3)
    assert (np.diff(found.losses) >= 0.0).all()
    before = losses(problem, space.nominal[None])[0]
    assert losses(problem, found.values[:1])[0] < 0.02 * before
    assert found.values[0, space.index("kp")] == pytest.approx(7.0, rel=0.05)
    assert found.values[0, space.index("torso.com_x")] == pytest.approx(-0.018, abs=0.002)
    # In the box: how far an arm's weight is to the side changes nothing in a symmetric motion.
    spread = np.ptp(space.to_unit(found.values), axis=0)
    names = [n for n in space.names if n in FREE]
    assert spread[names.index("l_arm+r_arm.com_y")] > 3.0 * spread[names.index("kp")]


def test_what_several_motions_tell_adds_against_the_prior(falling: tuple[Problem, Array]) -> None:
    problem, _ = falling
    space = problem.simulator.parameters
    effort: dict[str, Any] = {"seed": 0, "population": 8, "generations": 2, "members": 2, "descents": 2}
    once = whole_runs([problem], space, prior=1e-2, **effort)
    twice = whole_runs([problem, problem], space, prior=2e-2, **effort)
    assert twice.losses == pytest.approx(2.0 * once.losses)
    assert twice.values == pytest.approx(once.values)


def test_each_channel_counts_alike_however_often_it_was_sampled(falling: tuple[Problem, Array]) -> None:
    problem, truth = falling
    assert losses(problem, truth[None])[0] < 1e-5
    rarely = [
        replace(t, observed={n: replace(o, time=o.time[::2]) for n, o in t.observed.items()}) for t in problem.trials
    ]
    halved = problem.replayed_by(rarely, problem.owners)
    nominal = problem.simulator.parameters.nominal[None]
    assert losses(halved, nominal)[0] == pytest.approx(losses(problem, nominal)[0], rel=0.05)


def test_repeats_count_as_one_run_and_a_lost_base_is_named(falling: tuple[Problem, Array]) -> None:
    problem, truth = falling
    (run,) = problem.recordings
    command = problem.trials[0].command
    assert command is not None
    runs = [run.replace(name=name) for name in ("first", "again")]
    (trial,) = (whole := whole_body(problem.simulator, runs)).trials
    assert trial.name == "first"
    assert losses(whole, truth[None])[0] < 1e-5
    torso = run.channel("base_orientation")
    gone = torso.replace(
        values=np.where((torso.time > 0.2)[:, None] & (torso.time < 0.8)[:, None], np.nan, torso.values)
    )
    with pytest.raises(RecordingError, match=r"'base_orientation' was lost from 0\.2 to 0\.8 s"):
        whole_body(problem.simulator, [run.with_channel(gone)])
