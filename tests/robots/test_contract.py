# SPDX-License-Identifier: Apache-2.0
"""The robots of trueup keep the contract that it asks of others, and the check finds what breaks it."""

from __future__ import annotations

import dataclasses
import importlib.util
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from trueup.recording import Channel, Recording
from trueup.robots.by_hand import ByHand
from trueup.robots.stand_in import StandInArm
from trueup.studies.servo_arm.demo import model_path
from trueup.studies.walk.comparison import truth_of
from trueup.studies.walk.robot import StandInNao
from trueup.studies.walk.scenes import task
from trueup.tasks.task import robot_trials
from trueup.tasks.walking import LineWalk
from trueup.testing import check_robot
from trueup.testing.broken import ContractBrokenError
from trueup.trial import Observed, Trial


def arm_trial(repeats: int = 1) -> Trial:
    arm = StandInArm(model_path())
    now = np.arange(31) / 50.0
    command = Channel("command", arm.joints, "rad", now, 0.2 * np.sin(3.0 * now)[:, None] * np.ones(len(arm.joints)))
    return Trial("sine", 0.0, float(now[-1]), command, {"position": Observed(arm.joints, "rad", now)}, repeats=repeats)


def test_the_stand_in_arm_keeps_the_contract() -> None:
    check_robot(StandInArm(model_path()), arm_trial(repeats=2))


def test_the_stand_in_nao_keeps_it_walking_and_playing() -> None:
    robot, line = StandInNao(truth_of(0), threads=1, log=20.0), task(LineWalk, runs=1, line=0.1)
    (trial,) = robot_trials(line, line.parameters.nominal)
    check_robot(robot, dataclasses.replace(trial, repeats=2))  # which ends at the line
    (walked,) = robot.perform(trial)
    plain = dataclasses.replace(trial, name="played", command=walked.channel("command"), settings={}, references={})
    check_robot(robot, plain)


def test_the_toy_of_the_campaign_tests_keeps_it() -> None:
    place = Path(__file__).parents[1] / "campaign" / "toy.py"
    found = importlib.util.spec_from_file_location("toy_for_contract", place)
    assert found is not None
    assert found.loader is not None
    toy = importlib.util.module_from_spec(found)
    sys.modules["toy_for_contract"] = toy
    found.loader.exec_module(toy)
    settings = {"proportional": 2.0, "feed forward": 0.5}
    check_robot(toy.Cart(), dataclasses.replace(toy.Follow().trials[0], settings=settings, repeats=2))


def test_a_robot_run_by_hand_keeps_it(tmp_path: Path) -> None:
    trial = arm_trial()
    robot = ByHand(tmp_path, poll=0.01, rest=0.02)

    def operator() -> None:
        sheet = tmp_path / "outbox" / "sine"
        while not sheet.exists():
            time.sleep(0.01)
        rows = np.loadtxt(sheet / "command.csv", delimiter=",", skiprows=1)
        labels = [h.split(" [")[0] for h in (sheet / "command.csv").read_text().splitlines()[0].split(",")[1:]]
        head = ["time", *(f"cmd_{x}" for x in labels), *(f"pos_{x}" for x in labels)]
        rows = np.column_stack([rows, rows[:, 1:]])
        np.savetxt(tmp_path / "inbox" / "sine.csv", rows, delimiter=",", header=",".join(head), comments="", fmt="%.9g")

    person = threading.Thread(target=operator)
    person.start()
    check_robot(robot, trial)
    person.join()


class Broken:
    """A robot with a fault."""

    repeatable = True

    def __init__(self, fault: str) -> None:
        self._fault, self._arm, self._rng = fault, StandInArm(model_path()), np.random.default_rng(0)

    def perform(self, trial: Trial) -> list[Recording]:
        (recording,) = self._arm.perform(trial)
        position = recording.channel("position")
        if self._fault == "forgets a repeat":
            return []
        if self._fault == "loses a joint":
            return [recording.with_channel(position.select(position.labels[1:]))]
        if self._fault == "speaks in degrees":
            return [recording.with_channel(position.replace(unit="deg"))]
        if self._fault == "stops early":
            return [recording.slice(0.0, 0.3)]
        if self._fault == "keeps no command":
            return [recording.without("command")]
        return [recording.with_channel(position.replace(values=position.values + self._rng.standard_normal()))]


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("forgets a repeat", "0 recordings for 1 repeats"), ("loses a joint", "lacks"), ("speaks in degrees", "'deg'"),
        ("stops early", "covers 0.3 s"), ("keeps no command", "requested is not in"), ("never twice the same", "repeatable"),
    ],
)  # fmt: skip
def test_what_breaks_the_contract_is_found(fault: str, words: str) -> None:
    with pytest.raises(ContractBrokenError, match=words):
        check_robot(Broken(fault), arm_trial())
