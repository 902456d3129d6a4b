# SPDX-License-Identifier: Apache-2.0
"""The stand-in humanoid: what it hides is fixed by its number, and its recordings look like those of a real robot."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("dartpy", reason="the second engine is an extra: pip install trueup[dart]")

from trueup.ends import Fallen, ended
from trueup.errors import MissingExtraError
from trueup.inspection.repeats import bridged
from trueup.recording import Recording
from trueup.studies.balance.hidden import ENCODER
from trueup.studies.balance.robot import LEAD, StandInHumanoid, led
from trueup.studies.balance.scenes import transition
from trueup.tasks.task import as_rollout
from trueup.tasks.transitions import Transition
from trueup.trial import Trial


@pytest.fixture(scope="module")
def task() -> Transition:
    return transition("lean-to-stand", step=0.004)[1]


@pytest.fixture(scope="module")
def trial(task: Transition) -> Trial:
    (planned,) = task.planned(np.array([0.05]))
    return replace(led(planned), repeats=2)


@pytest.fixture(scope="module")
def runs(trial: Trial) -> list[Recording]:
    return StandInHumanoid("lean-to-stand", 100, gap=0.0).perform(trial)


def test_a_robot_that_hides_nothing_does_in_dart_what_mujoco_foretold(task: Transition, runs: list[Recording]) -> None:
    stood = task.succeeded([as_rollout(task.trials[0], [bridged(r).slice(0.0, 99.0) for r in runs])])
    assert stood.all()


def test_encoders_tell_steps_and_motion_capture_has_noise_drop_outs_and_begins_before_the_motion(
    runs: list[Recording],
) -> None:
    joints = runs[0].channel("position").values / ENCODER
    np.testing.assert_allclose(joints, np.round(joints), atol=1e-6)
    torso = [r.channel("base_position") for r in runs]
    assert torso[0].time[0] == pytest.approx(-LEAD)
    resting = torso[0].values[torso[0].time < 0.0]
    assert 2e-4 < resting[:, 2].std() < 1e-3
    assert any(np.isnan(c.values).any() for c in torso)
    # Put down anew each time, by hand.
    apart = np.abs(np.nanmean(torso[0].values[:30], axis=0) - np.nanmean(torso[1].values[:30], axis=0))
    assert 1e-4 < apart[:2].max() < 0.01


def test_its_number_fixes_what_it_hides_and_masses_are_wrong_by_up_to_two_fifths() -> None:
    hidden = [StandInHumanoid("sit-to-stand", n).truth for n in range(10)]
    again = StandInHumanoid("lean-to-stand", 3).truth
    np.testing.assert_array_equal(hidden[3].servos.stiffness, again.servos.stiffness)
    factors = np.array([np.mean(list(t.mass.values())) for t in hidden])
    assert factors.min() > 0.7
    assert 1.2 < factors.max() < 1.6
    assert len({t.delay for t in hidden}) == 10


def test_a_robot_that_falls_says_when(task: Transition) -> None:
    (planned,) = task.planned(np.array([0.05]))
    assert planned.command is not None
    bent = {"thigh": -1.2, "heel": -0.5}
    later = planned.command.time[:, None] > 0.2
    tipped = planned.command.values + later * [bent.get(j[2:], 0.0) for j in planned.command.labels]
    fall = replace(planned, command=planned.command.replace(values=tipped), name="tipped", ends=(Fallen(tilt=1.0),))
    (run,) = StandInHumanoid("lean-to-stand", 100, gap=0.0).perform(led(fall))
    end = ended(run)
    assert end is not None
    assert end.name == "fallen"
    assert 0.4 < end.at < planned.duration
    assert run.channel("base_position").time[-1] < end.at + 0.15


def test_without_dartpy_the_error_says_what_mends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda n, *a: None if n == "dartpy" else found(n, *a))
    with pytest.raises(MissingExtraError, match=r"pip install .*trueup\[dart\]"):
        _ = StandInHumanoid("sit-to-stand", 0).truth
