# SPDX-License-Identifier: Apache-2.0
"""The study, small: a motion that fails on the robot is replaced, after a calibration on its runs, by one that works."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("dartpy", reason="the second engine is an extra: pip install trueup[dart]")

from trueup.errors import OutputError
from trueup.loop.surest import Effort
from trueup.studies.balance.calibration import Runs, calibrated, simulator_of
from trueup.studies.balance.campaign import Round, Scale, campaign, performed
from trueup.studies.balance.once import as_told
from trueup.studies.balance.pictures import _lean
from trueup.studies.balance.plan import Size
from trueup.studies.balance.report import html
from trueup.studies.balance.robot import StandInHumanoid
from trueup.studies.balance.scenes import transition
from trueup.studies.balance.study import Findings
from trueup.studies.saved import Parts
from trueup.tasks.transitions import Transition

SCENE, NUMBER = "lean-to-stand", 102
SLOW = np.array([0.5])


@pytest.fixture(scope="module")
def task() -> Transition:
    return transition(SCENE, step=0.004)[1]


@pytest.fixture(scope="module")
def rounds(task: Transition) -> tuple[Round, ...]:
    scale = Scale(rounds=1, repeats=1, generations=2, effort=Effort(population=12, models=2))
    return campaign(SCENE, StandInHumanoid(SCENE, NUMBER), task, SLOW, seed=0, scale=scale)


def test_a_motion_that_fails_is_replaced_after_one_calibration_by_one_that_works(rounds: tuple[Round, ...]) -> None:
    assert [r.succeeded for r in rounds] == [False, True]
    assert rounds[1].motion[0] < SLOW[0]
    assert rounds[0].seconds < 3.0


def test_a_calibration_replays_a_failed_run_of_a_robot_that_lives_in_another_engine(task: Transition) -> None:
    far = StandInHumanoid(SCENE, 100, gap=2.0)
    runs, _ = performed(far, task, np.array([0.08]), "far", 1)
    simulator, fitted = simulator_of(SCENE), Runs(SCENE, runs)
    found = calibrated([fitted], generations=4, members=1, descents=4)
    before, after = (fitted.error(simulator, v) for v in (simulator.parameters.nominal, found.values[0]))
    assert before > 0.1
    assert after < 0.3 * before


def test_the_report_tells_the_rounds_and_shows_them(
    task: Transition, rounds: tuple[Round, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trueup.studies.balance.pictures._PICTURES", 2)
    told = [as_told(SCENE, task, rounds[0], rounds[1].values), as_told(SCENE, task, rounds[1], None)]
    size = Size(stand_ins=1, scenes=(SCENE, "kneel-to-stand", "sit-to-stand"))
    found = Findings(size, {"kneel-to-stand": {"share": 0.0}}, campaigns={SCENE: {NUMBER: told}})
    assert found.share(SCENE, 0) == 0.0
    assert found.share(SCENE, 1) == 1.0
    assert found.needed(SCENE) == [1]
    page = html(found)
    assert "0 of 1, 1 of 1" in page
    assert "no motion was found in the simulator itself" in page
    assert "not computed yet" in page
    assert page.count("<canvas") == 3


def test_the_torsos_lean_goes_on_past_upside_down_whatever_its_angles_do() -> None:
    back = np.linspace(0.0, -1.2 * np.pi, 40)
    turned = Rotation.from_euler("z", 0.7) * Rotation.from_euler("y", back[:, None])
    frames = np.zeros((40, 6))
    frames[:, 3:] = np.unwrap(turned.as_euler("ZYX"), axis=0)[:, ::-1]
    np.testing.assert_allclose(_lean(frames), back, atol=1e-9)


def test_a_study_goes_on_in_its_folder_and_refuses_one_of_another_size(tmp_path: Path) -> None:
    parts, computed = Parts.at(tmp_path, Size()), []
    for _ in range(2):
        assert Parts.at(tmp_path, Size()).text("a part", lambda: computed.append(1) or [1.5]) == [1.5]
    assert len(computed) == 1
    assert parts.has("a part")
    with parts.claimed("a part") as mine, parts.claimed("a part") as again, parts.claimed("another") as other:
        assert (mine, again, other) == (True, False, True)
    with pytest.raises(OutputError, match="another size"):
        Parts.at(tmp_path, Size(stand_ins=3))
