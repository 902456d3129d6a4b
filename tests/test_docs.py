# SPDX-License-Identifier: Apache-2.0
"""The pages say what is so: their tables are complete, their examples can be read."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trueup.articulated.declaration_file import read_declarations
from trueup.articulated.quantities.known import quantities
from trueup.calibration import pooled_rmse
from trueup.campaign.history import History
from trueup.campaign.journal import read_journal
from trueup.campaign.plan import read_plan, templates
from trueup.campaign.rehearsal import rehearse
from trueup.campaign.resolve import parts_of
from trueup.cli import main
from trueup.formats import is_recording, read
from trueup.loop.prepare import prepare
from trueup.tasks.task import robot_trials, simulated_scores

PAGE = Path(__file__).resolve().parents[1] / "docs" / "calibrate.md"


def test_the_table_of_quantities_is_complete() -> None:
    rows = re.findall(r"^\| `(\w+)` \| (\w+) \| ([^|]+) \| ([^|]+) \|$", PAGE.read_text("utf-8"), re.MULTILINE)
    assert rows == [(k.name, k.family, k.unit or "-", k.title) for k in quantities().values()]


def test_the_example_of_a_parameters_file_is_one(tmp_path: Path) -> None:
    (example,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    (tmp_path / "parameters.toml").write_text(example, encoding="utf-8")
    lines = read_declarations(tmp_path / "parameters.toml")
    assert [line.quantity for line in lines] == ["kp", "friction", "friction_creep", "delay", "mass"]
    assert lines[-1].frozen


ARM = """
<mujoco model="arm"><compiler angle="radian"/><option timestep="0.005"/><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0" range="-2 2"/><geom type="capsule" fromto="0 0 0 0 0 .3" size=".02"/>
    <body pos="0 0 .3"><joint name="elbow" axis="0 1 0" range="-2 2"/><geom type="capsule" fromto="0 0 0 0 0 .2" size=".02"/>
  </body></body></worldbody>
  <default><joint damping=".5" armature=".02"/></default>
  <actuator><position joint="shoulder" kp="60"/><position joint="elbow" kp="40"/></actuator></mujoco>
"""
PLAN = """
[robot]
type = "by-hand"
[simulator]
type = "mujoco"
model = "arm.xml"
parameters = "parameters.toml"
[task]
type = "task:Move"
[calibrate]
method = "none"
"""


def test_the_task_of_the_page_on_campaigns_is_one_that_a_plan_can_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (PAGE.parent / "campaigns.md").read_text("utf-8")
    (code,) = (b for b in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if b.startswith("# task.py"))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "task", raising=False)
    for name, text in (("task.py", code), ("arm.xml", ARM), ("campaign.toml", PLAN)):
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "parameters.toml").write_text('[[parameter]]\nquantity = "kp"\nof = "*"\n')
    plan = read_plan(tmp_path / "campaign.toml")
    parts = parts_of(plan, tmp_path, lambda line: None)
    assert rehearse(parts, plan.plan) == ""
    task, simulator = parts.task, parts.simulator
    values = np.array([0.05, 0.02])
    by_controller = simulated_scores(task, simulator, simulator.parameters.nominal, values[None])[0, 0]
    (run,) = simulator.rollout(robot_trials(task, values), simulator.parameters.nominal[None])
    assert task.score([run])[0] == pytest.approx(
        by_controller, rel=1e-3
    )  # the motion sent is the one that was simulated
    late = simulated_scores(task, simulator, simulator.parameters.nominal, np.zeros((1, 2)))[0, 0]
    assert 0.0 < late < 0.05  # it begins where the model is put
    assert abs(by_controller - late) > 1e-3


ROBOT = """
import numpy as np
from trueup.loop.prepare import prepare
from trueup.recording import Channel, Recording


class Arm:  # another arm than the file's: softer servos, with friction
    repeatable = True

    def __init__(self, folder_of_plan):
        self.simulator = prepare(folder_of_plan / "robot_as_it_is.xml", (), propose=False).simulator

    def perform(self, trial):
        (run,) = self.simulator.rollout([trial], np.zeros((1, 0)))
        return [Recording(trial.name, {"command": trial.command, "position": run.recording(0).channel("position")})]
"""


def test_a_blank_plan_runs_once_model_task_and_robot_are_given_and_leaves_the_calibrated_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (PAGE.parent / "campaigns.md").read_text("utf-8")
    (code,) = (b for b in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if b.startswith("# task.py"))
    plan = (templates()["blank"] / "campaign.toml").read_text("utf-8").replace('"by-hand"', '"driver:Arm"')
    plan = plan.replace('"task:Task"', '"task:Move"').replace("# rounds = 3", "rounds = 1")
    plan = plan.replace("# evaluations = 200", "evaluations = 40").replace("# samples = 8", "samples = 2")
    plan = plan.replace('# parameters = ["*"] ', 'parameters = ["*kp", "*friction"] ')
    soft = ARM.replace("<joint ", '<joint frictionloss="0.05" ').replace('kp="60', 'kp="42')
    for name, text in (("task.py", code), ("driver.py", ROBOT), ("robot.xml", ARM), ("robot_as_it_is.xml", soft),
                       ("campaign.toml", plan)):  # fmt: skip
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for module in ("task", "driver"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    assert main(["run", "-q"]) == 0
    history = History.of(read_journal(tmp_path))
    first = history.rounds[0].calibrated
    assert first is not None
    assert {n.rpartition(".")[2] for n in first.names} >= {"kp"}, "proposed from the first experiment"
    assert {n.rpartition(".")[2] for n, free in zip(first.names, first.fitted, strict=True) if free} == {
        "kp",
        "friction",
    }
    assert first.error_after < 0.3 * first.error_before
    assert history.best[1] < history.first_score
    told = capsys.readouterr().out.split()[-1]
    assert told == str(Path("round-1") / "calibrated.xml")
    runs = read(sorted(tmp_path.glob("recordings/*")))  # each Parquet file, and what was noted of it
    assert [r.name for r in runs] == [r.name for r in read([tmp_path / "recordings"])]
    assert [p.suffix for p in sorted(tmp_path.glob("recordings/*-001.*")) if is_recording(p)] == [".parquet"]
    fitted = [r for r in runs if r.name in first.recordings]
    assert len(fitted) == len(first.recordings)
    written = prepare(tmp_path / told, fitted, propose=False).compare()  # the file alone, without parameters.toml
    assert pooled_rmse([r for r in written.replays if r.channel == "position"], after=True) == pytest.approx(
        first.error_after,
        rel=0.1,  # starts are taken from the runs anew
    )
    before = (tmp_path / "journal.jsonl").read_bytes()
    lines = before.splitlines(keepends=True)
    assert (
        main(["resume", str(tmp_path), "--from-line", str(len(lines) // 2), "-q"]) == 0
    )  # it goes on as it would have
    assert (tmp_path / "journal.jsonl").read_bytes() == before


def test_the_example_of_the_page_on_motions_finds_one_that_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, *_ = re.findall(r"```python\n(.*?)```", (PAGE.parent / "motions.md").read_text("utf-8"), re.DOTALL)
    model = templates()["motion"] / "small_humanoid.xml"
    (tmp_path / model.name).write_text(model.read_text("utf-8"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(code, names)
    assert names["found"].winners
    assert all(min(w.shares) >= 5 / 6 for w in names["found"].winners)
    assert names["command"].labels == names["task"].motion.joints
    assert "</html>" in (tmp_path / "film.html").read_text("utf-8")
