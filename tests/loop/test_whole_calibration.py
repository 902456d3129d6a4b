# SPDX-License-Identifier: Apache-2.0
"""A run of a humanoid that falls is fitted whole, and what it does not tell is said to be as open as before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trueup.campaign.motions import transition
from trueup.campaign.plan import templates
from trueup.discrepancies.whole_body import orientation_error
from trueup.engines.mujoco.model import load
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.errors import CalibrationError
from trueup.loop.prepare import Preparation, prepare
from trueup.loop.whole_calibration import calibrate_whole
from trueup.loop.whole_runs import whole_body
from trueup.recording import Recording

SMALL = templates()["motion"] / "small_humanoid.xml"
FEW = ("kp", "damping", "friction", "torso.com_x", "left_arm+right_arm.com_y", "floor_friction")
WEAKER = (('kp="25"', 'kp="14"'), ('damping="0.6" frictionloss="0.05"', 'damping="0.9" frictionloss="0.1"'))


@pytest.fixture(scope="module")
def fallen(tmp_path_factory: pytest.TempPathFactory) -> tuple[Preparation, Recording]:
    """The small humanoid as its file is, free in a few parameters, and a run of a weaker one."""
    text = SMALL.read_text("utf-8")
    for old, new in WEAKER:
        assert old in text
        text = text.replace(old, new)
    weaker = tmp_path_factory.mktemp("robot") / "robot.xml"
    weaker.write_text(text, encoding="utf-8")
    _, task = transition(SMALL, "sit", "stand", between=["lean"])
    trial = replace(task.watched(task.parameters.nominal), ends=())
    (run,) = MujocoSimulator(load(weaker), step=0.004).rollout([trial], np.zeros((1, 0)))
    recording = run.recording()
    ready = prepare(SMALL, (recording,), propose=False, step=0.004).for_whole_runs()
    space = ready.simulator.parameters
    assert isinstance(ready.simulator, MujocoSimulator)
    few = ready.simulator.with_parameters(space.freeze([n for n in space.names if n not in FEW]))
    return replace(ready, simulator=few), recording


def test_what_the_fall_tells_is_found_and_the_rest_is_left_as_open_as_it_was(
    fallen: tuple[Preparation, Recording],
) -> None:
    ready, _ = fallen
    found = calibrate_whole(ready.simulator, ready.recordings)
    problem = whole_body(ready.simulator, ready.recordings)
    each = ready.simulator.parameters.nominal, found.values
    before, after = (orientation_error(problem.recordings, problem.rollouts(x[None])) for x in each)
    assert before > 0.2  # rad
    assert after < 0.15 * before
    by_name = {e.name: e for e in found.estimates}
    for name, truth in (("kp", 14.0), ("damping", 0.9), ("torso.com_x", 0.0)):
        assert by_name[name].low < truth < by_name[name].high
    sideways = by_name["left_arm+right_arm.com_y"]  # moves nothing of what is alike on both sides
    assert sideways.verdict == "not identified"
    assert sideways.high - sideways.low > 0.9 * (sideways.upper_bound - sideways.lower_bound)
    assert by_name["torso.mass"].verdict == "frozen"
    assert len(found.covariance) == len(FEW)


def test_without_the_torso_s_pose_it_is_said_what_to_do(fallen: tuple[Preparation, Recording]) -> None:
    ready, recording = fallen
    joints = Recording("joints", {n: recording.channel(n) for n in ("command", "position")})
    with pytest.raises(CalibrationError, match=r"no recording has 'base_orientation' .* method = \"fit\""):
        calibrate_whole(ready.simulator, [joints])
