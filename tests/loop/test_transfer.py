# SPDX-License-Identifier: Apache-2.0
"""On the robot: what a candidate means is what the robot is given, and failures say nothing good."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.controllers.controller import Controller
from trueup.engines.simulator import Rollout
from trueup.errors import RobotFellError, TrialError
from trueup.loop.transfer import Shortlist, transfer, try_on_robot
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Channel, Recording
from trueup.trial import Limits, Observed, Trial

Array = NDArray[np.float64]

NOW = np.linspace(0.0, 1.0, 51)


class Swing:
    """A task whose candidates are motions: how far to swing, which is to be 0.8 rad."""

    name = "swing"
    parameters = ParameterSpace((Parameter("reach", "rad", 0.3, 0.0, 2.0),))
    trials = (Trial("swing", 0.0, 1.0, None, {"position": Observed(("arm",), "rad", NOW)}),)

    def controllers(self, values: Array) -> Controller:
        raise NotImplementedError

    def planned(self, candidate: Array) -> tuple[Trial, ...]:
        motion = candidate[0] * np.sin(np.pi * NOW)[:, None]
        return tuple(
            dataclasses.replace(t, command=Channel("command", ("arm",), "rad", NOW, motion)) for t in self.trials
        )

    def score(self, rollouts: Sequence[Rollout]) -> Array:
        return np.abs(rollouts[0].channels["position"].max(axis=(1, 2)) - 0.8)


class Arm:
    """A robot that plays commands, nine tenths as far, and falls over beyond 1.5 rad."""

    repeatable = True

    def __init__(self) -> None:
        self.played: list[Trial] = []

    def perform(self, trial: Trial) -> list[Recording]:
        self.played.append(trial)
        assert trial.command is not None
        if trial.command.values.max() > 1.5:
            raise RobotFellError("over the edge")
        position = trial.command.replace(name="position", values=0.9 * trial.command.values)
        runs = [f"{trial.name}-{k}" for k in range(trial.repeats)]
        return [Recording(n, {"command": trial.command, "position": position}) for n in runs]


def test_a_robot_that_plays_commands_is_given_the_motion_of_the_candidate() -> None:
    arm = Arm()
    tried = try_on_robot(arm, Swing(), np.array([1.0]), repeats=2)
    np.testing.assert_allclose(tried.scores, [0.1, 0.1])
    assert arm.played[0].settings == {"reach": 1.0}
    assert len(tried.recordings[0]) == 2


def test_the_best_on_the_robot_is_kept_whatever_the_simulator_expected() -> None:
    unit = np.array([[0.15], [0.45], [0.9]])
    outcome, tested = transfer(Arm(), Swing(), Shortlist(unit, np.array([0.5, 0.2, 0.1]), np.zeros(3), 0))
    assert outcome.best == 1
    assert np.isnan(outcome.measured[2])
    assert tested[2].fell
    assert outcome.agreement.count == 2


def test_a_motion_beyond_the_limits_never_reaches_the_robot() -> None:
    arm = Arm()
    limits = Limits(("arm",), np.array([-0.5]), np.array([0.5]), np.array([np.nan]), np.array([np.nan]))
    with pytest.raises(TrialError, match=r"'arm' is commanded to 1 rad \(allowed: -0.5 to 0.5\)"):
        try_on_robot(arm, Swing(), np.array([1.0]), limits=limits)
    assert arm.played == []
