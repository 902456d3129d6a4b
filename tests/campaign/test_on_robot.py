# SPDX-License-Identifier: Apache-2.0
"""A walk's pace and lean are found on the robot itself: bolder within its trials, told by which way it falls."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from trueup.campaign.campaign import Campaign
from trueup.campaign.doses import Doses
from trueup.campaign.events import Chosen, Event, Scored
from trueup.campaign.folder import Folder
from trueup.campaign.history import History
from trueup.campaign.journal import JOURNAL, Journal, read_journal, set_back
from trueup.campaign.plan import read_plan
from trueup.campaign.resolve import parts_of
from trueup.errors import ParameterError, PlanError
from trueup.parameters import ParameterSpace
from trueup.report.campaign import write_campaign_report
from trueup.report.campaign_grades import grades_shown
from trueup.report.campaign_sections import campaign_sections
from trueup.studies.walk.scenes import LEFT, RIGHT, SIMSPARK
from trueup.tasks.paces import Paces
from trueup.tasks.task import Graded

PLAN = f"""
[robot]
type = "walker:Walker"
[simulator]
type = "mujoco"
model = "biped.xml"
[task]
type = "walk"
course = "line"
quiet = true
left = {list(LEFT)}
right = {list(RIGHT)}
[optimize]
method = "on-robot"
[stop]
trials = 40
"""


def plan_in(folder: Path, *replaced: tuple[str, str]) -> Path:
    text = PLAN
    for old, new in replaced:
        assert old in text
        text = text.replace(old, new)
    shutil.copy(Path(__file__).with_name("walker.py"), folder)
    shutil.copy(SIMSPARK, folder / "biped.xml")
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    return folder / "campaign.toml"


def run(plan: Path, out: Path) -> tuple[Event, ...]:
    folder, said = Folder.begin(read_plan(plan), out, None), list[str]()
    parts = parts_of(folder.file, folder.path, said.append)
    assert not [line for line in said if "calibrated" in line]  # nothing is
    with Journal(folder.path) as journal:
        Campaign(folder.file.plan, folder.checksum, "0", parts, journal).run()
    return read_journal(folder.path)


def test_a_walk_gets_faster_and_leans_as_the_robot_needs_it(tmp_path: Path) -> None:
    plan = plan_in(tmp_path)
    events = run(plan, tmp_path / "out")
    history = History.of(events)
    settings, score = history.best
    assert score < 1.2 * history.first_score < 0.0
    assert settings["fwdOffset"] > -0.0087 + 0.002
    assert len(history.trials) == 39  # the first ones are two runs of one trial
    assert [len(r.scored) for r in history.rounds] == [11, 10, 10, 8]
    last = [s.unit for r in history.rounds for s in r.scored][-8:]
    assert len(set(last)) <= 2  # the last ones are of what is worth the most
    assert "ended early in" in history.falls_of_best
    ended = history.rounds[-1].ended
    assert ended is not None
    share, low, high = ended.early
    assert 0.0 < low < share < high < 0.3
    assert f"together {100 * share:.2g} in 100 are expected to" in history.falls_of_best
    assert ("fell forward" in history.falls_of_best) == ("in 0 of" not in history.falls_of_best)
    shown = "".join(s.body for s in campaign_sections(history, read_plan(plan).plan, {}, "", ()))
    assert "On the robot the speed went from" in shown
    assert "trust region" not in shown
    assert shown.count("amp_swing 1 times, fwdOffset +0 m") >= 1
    assert str(grades_shown(history)) in shown
    assert "(fell forward)" in shown
    assert "(fell backward)" in shown
    out = tmp_path / "again"
    for count in (2 * len(events) // 3,):
        shutil.copytree(tmp_path / "out", out)
        set_back(out, count)
        run(plan, out)
        assert (out / JOURNAL).read_bytes() == (tmp_path / "out" / JOURNAL).read_bytes()
        shutil.rmtree(out)


def test_a_walk_is_fast_enough_by_its_speed(tmp_path: Path) -> None:
    plan = plan_in(tmp_path, ("trials = 40", "trials = 40\nsuccess = 0.1"))
    history = History.of(run(plan, tmp_path / "out"))
    assert history.ended is not None
    assert history.ended.success
    assert history.ended.reason.startswith(f"success: {-history.best[1]:.4g} m/s")
    assert history.score(history.best[1]) == f"{-history.best[1]:.4g} m/s"
    assert -history.best[1] > 0.1
    with pytest.raises(PlanError, match=r"speak of the speed.* success = 0\.1"):
        run(plan_in(tmp_path, ("trials = 40", "trials = 40\nsuccess = -0.1")), tmp_path / "negative")


def test_a_fall_of_which_nothing_else_is_known_counts(tmp_path: Path) -> None:
    plan = plan_in(tmp_path, ('Walker"', 'Walker"\nsilent = true\nbest = 0.0'), ("trials = 40", "trials = 16"))
    events = run(plan, tmp_path / "out")
    scored = [e for e in events if isinstance(e, Scored)]
    assert any(s.fell and not s.tally for s in scored)
    best, _ = History.of(events).best
    assert best["amp_swing"] < 2.0 * 0.148


def test_a_stop_watch_and_eyes_find_what_poses_do(tmp_path: Path) -> None:
    """The same robot, logged and watched: a fall's own distance aside, all that counts is known of both."""
    found = []
    for name, more in (("logged", ""), ("watched", '"\nwatched = true')):
        (tmp_path / name).mkdir()
        plan = plan_in(tmp_path / name, ('Walker"', f"Walker{more or chr(34)}"), ("trials = 40", "trials = 10"))
        events = run(plan, tmp_path / name / "out")
        found.append(([e.numbers for e in events if isinstance(e, Chosen)], History.of(events).best[0]))
    assert found[0] == found[1]
    out = tmp_path / "watched" / "out"
    page = write_campaign_report(out, read_plan(plan).plan).read_text(encoding="utf-8")
    assert "its runs were watched, not logged" in page
    assert "What the robot did" not in page
    set_back(out, len(events) // 2)
    assert run(plan, out) == events


def test_settings_beyond_the_plans_limits_are_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "trueup.campaign.doses.problems", lambda parts, unit, model: ("beyond",) * int(unit[1] > 0.45)
    )  # the swing's share of its range: steps 1.25 times as long
    plan = plan_in(tmp_path, ("trials = 40", "trials = 12"))
    events = run(plan, tmp_path / "out")
    chosen = [e for e in events if isinstance(e, Chosen)]
    assert max(e.numbers[0][0] for e in chosen) == pytest.approx(1.2)
    assert sum(e.unsafe for e in chosen) > 0
    set_back(tmp_path / "out", len(events) // 2)  # what was passed over before the interruption does not matter
    assert run(plan, tmp_path / "out") == events


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('course = "line"', 'course = "around"', "task 'walk around' has no grades.*'front' or 'line'"),
        ("[stop]", "[experiment]\nsettings = 3\n[stop]", r"begins with what the robot runs with today: settings = 1"),
    ],
)
def test_what_cannot_be_tuned_on_the_robot_is_said_before_it_moves(
    tmp_path: Path, old: str, new: str, says: str
) -> None:
    with pytest.raises(PlanError, match=says):
        run(plan_in(tmp_path, (old, new)), tmp_path / "out")


def test_a_walk_of_other_parameters_needs_to_say_which_are_pace_and_lean() -> None:
    space = ParameterSpace(tuple(p for p in _walk().parameters if p.name != "stepPeriod"))
    with pytest.raises(
        ParameterError, match="amp_swing, stepPeriod and fwdOffset; this walk's free parameters are amp"
    ):
        Paces().grades(space, 0.7)
    near_its_end = _walk().with_nominal(np.where(np.array(_walk().names) == "amp_swing", 0.3, _walk().nominal))
    assert Paces().grades(near_its_end, 0.7).numbers[:, 0].max() == pytest.approx(1.1)  # not cut at the bound


def _walk() -> ParameterSpace:
    from trueup.controllers.walk_engine.engine import PARAMETERS

    return PARAMETERS


def test_a_run_that_was_aborted_is_no_fall(tmp_path: Path) -> None:
    parts = parts_of(read_plan(plan_in(tmp_path)), tmp_path / "out", lambda line: None)
    assert isinstance(parts.task, Graded)
    doses = Doses(parts, parts.task, 0, 40)
    unit = tuple(parts.task.parameters.to_unit(parts.task.parameters.nominal).tolist())
    done = Scored(1, "experiment", 0, unit, (-0.1, -0.1), fell=False, tally=((2.0, -4.6, 0.0, 0.0), (0.0,) * 4))
    aborted, fell = (Scored(1, "transfer", 0, unit, (float("nan"),), fell=down) for down in (False, True))
    assert doses.best([done, aborted])[1] == pytest.approx(-0.1)
    assert doses.best([done, fell])[1] == pytest.approx((-0.2 + 0.7) / 3.0)
    assert doses.chosen(1, [aborted], 1).numbers == ((1.0, 0.0),)
