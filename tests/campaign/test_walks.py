# SPDX-License-Identifier: Apache-2.0
"""A biped's file and the names of its legs are enough to walk with it; what cannot walk is named, with what to add."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import trueup
from trueup.campaign.kinds import TASKS
from trueup.campaign.making import instance
from trueup.campaign.plan import Component
from trueup.chance import Buffeting
from trueup.controllers.walk_engine.engine import sized
from trueup.errors import ModelError, ParameterError, UnknownNameError
from trueup.search.cma_es import CmaEs
from trueup.studies.walk.scenes import LEFT, NAO, RIGHT, SIMSPARK, simulator
from trueup.tasks.omni_walk import OmniWalk
from trueup.tasks.walking import AheadWalk, WalkFront


def test_a_biped_walks_by_its_file_and_the_names_of_its_legs() -> None:
    robot, task = trueup.walk(NAO, LEFT, RIGHT, runs=1)
    slow = task.parameters.nominal.copy()
    slow[task.parameters.index("amp_swing")] *= 0.5
    done = robot.rollout(task.trials, np.stack([task.parameters.nominal, slow]), task.controllers)
    score = -task.score(done)
    assert not done[0].ends
    assert 0.09 < score[0] < 0.15
    assert 0.4 < score[1] / score[0] < 0.8
    (buffeting,) = [d for d in task.trials[0].disturbances if isinstance(d, Buffeting)]
    assert buffeting.force == pytest.approx(0.02 * 5.305 * 9.81, rel=0.01)


def test_lengths_among_the_start_values_are_in_proportion_to_the_legs() -> None:
    _, task = trueup.walk(SIMSPARK, LEFT, RIGHT, quiet=True)
    legs = 0.2201 / 0.2029  # of a NAO, whose values they are
    assert task.parameters["fwdOffset"].nominal == pytest.approx(-0.008 * legs, rel=1e-3)
    assert task.parameters["fwdOffset"].upper == pytest.approx(0.03 * legs, rel=1e-3)
    assert task.parameters["stepPeriod"].nominal == 0.51


def test_shorter_legs_begin_with_quicker_steps() -> None:
    space = sized(0.14)
    assert space["stepPeriod"].nominal == pytest.approx(0.51 * np.sqrt(0.14 / 0.2029))
    assert space["stepPeriod"].lower == pytest.approx(0.34 * np.sqrt(0.14 / 0.2029))


def test_a_robot_that_steps_quicker_than_any_bound_has_all_paces_before_it() -> None:
    walks = (trueup.walk(NAO, LEFT, RIGHT, course="line", nominal=n)[1] for n in ({"stepPeriod": 0.33}, {}))
    quick, usual = (walk for walk in walks if isinstance(walk, AheadWalk))
    assert quick.parameters["stepPeriod"].nominal == 0.33  # and not the 0.34 s of the bound
    assert quick.grades().numbers.tolist() == usual.grades().numbers.tolist()


@pytest.mark.parametrize(("name", "value", "says"), [
    ("stepPeriod", 450.0, r"stepPeriod = 450 s is no start value of a walk: bipeds of this size have 0.34 to 0.8 s"),
    ("stepPeriod", 0.0, "stepPeriod = 0 s"), ("gyro_hipRoll", 30.0, "gyro_hipRoll = 30"),
])  # fmt: skip
def test_a_start_value_that_no_walk_has_is_refused(name: str, value: float, says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        trueup.walk(NAO, LEFT, RIGHT, nominal={name: value})


def test_a_plan_names_the_walk_and_its_course() -> None:
    options = {"left": list(LEFT), "right": list(RIGHT), "course": "around", "quiet": True, "nominal": {"knee": 0.9}}
    component = Component("walk", options, "plan.toml, [task]")
    task = instance(component, "task", TASKS, {"simulator": simulator()}, NAO.parent)
    assert isinstance(task, OmniWalk)
    assert not task.disturbances
    assert task.parameters["knee"].nominal == 0.9
    assert task.parameters["v_short"].nominal == 1.765


def test_the_pages_example_walks_a_biped_with_other_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text, theirs = NAO.read_text("utf-8"), ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle_pitch", "ankle_roll")
    for side, ours in (("left", LEFT), ("right", RIGHT)):
        for name, joint in zip(theirs, ours, strict=True):
            text = text.replace(f'"{joint}"', f'"{side}_{name}"')
    (tmp_path / "biped.xml").write_text(text, encoding="utf-8")
    page = Path(__file__).resolve().parents[2] / "docs" / "walking.md"
    (example,) = re.findall(r"```python\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    less = {"population=32": "population=6", "range(20)": "range(1)", "for j in leg])\n": "for j in leg], runs=1)\n"}
    for much, little in less.items():
        assert much in example
        example = example.replace(much, little)
    exec(example, names)
    search = names["search"]
    assert isinstance(search, CmaEs)
    assert search.best[1] < -0.05


def test_what_a_walk_lacks_is_named(tmp_path: Path) -> None:
    text = SIMSPARK.read_text("utf-8")

    def without(pattern: str) -> Path:
        path = tmp_path / f"biped{len(list(tmp_path.iterdir()))}.xml"
        path.write_text(re.sub(pattern, "", text, flags=re.DOTALL), encoding="utf-8")
        return path

    with pytest.raises(ModelError, match=r"no sensor 'gyro'.*<gyro name=.*accelerometer"):
        trueup.walk(without("<gyro [^>]*>"), LEFT, RIGHT)
    with pytest.raises(ModelError, match="keyframe"):
        trueup.walk(without("<keyframe>.*</keyframe>"), LEFT, RIGHT)
    with pytest.raises(UnknownNameError, match="LHipYaw"):
        trueup.walk(SIMSPARK, ("LHipYaw", *LEFT[1:]), RIGHT)
    with pytest.raises(UnknownNameError, match=r"'moonwalk'.*front"):
        trueup.walk(SIMSPARK, LEFT, RIGHT, course="moonwalk")
    assert isinstance(trueup.walk(SIMSPARK, LEFT, RIGHT)[1], WalkFront)


def test_a_walk_is_simulated_at_the_models_own_step_where_that_is_finer(tmp_path: Path) -> None:
    text = SIMSPARK.read_text("utf-8")
    assert 'timestep="0.005"' in text
    fine, coarse = tmp_path / "fine.xml", tmp_path / "coarse.xml"
    fine.write_text(text.replace('timestep="0.005"', 'timestep="0.001"'), encoding="utf-8")
    coarse.write_text(text.replace('timestep="0.005"', 'timestep="0.02"'), encoding="utf-8")
    steps = {path: trueup.walk(path, LEFT, RIGHT, quiet=True)[0].step for path in (fine, coarse, SIMSPARK)}
    assert steps == {fine: 0.001, coarse: 0.005, SIMSPARK: 0.005}
    assert trueup.walk(fine, LEFT, RIGHT, step=0.004)[0].step == 0.004
