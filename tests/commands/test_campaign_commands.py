# SPDX-License-Identifier: Apache-2.0
"""`trueup new`, `run`, `status`, `resume` and `report`: a campaign from the command line, over days, with an operator."""

from __future__ import annotations

import _thread
import json
import re
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from trueup.campaign.events import TrialDone
from trueup.campaign.journal import JOURNAL, read_journal
from trueup.campaign.plan import read_plan
from trueup.campaign.resolve import parts_of
from trueup.campaign.retract import retract
from trueup.cli import main

CAMPAIGN = Path(__file__).parents[1] / "campaign"

PLAN = """
name = "toy"
[robot]
{robot}
[simulator]
type = "toy:Lag"
[task]
type = "toy:Follow"
[calibrate]
method = "toy:regression"
[optimize]
search = "toy:Nearby"
samples = 3
[transfer]
candidates = 2
[stop]
rounds = {rounds}
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the toy, to work in."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(CAMPAIGN / "toy.py", tmp_path)
    return tmp_path


def plan(here: Path, robot: str = 'type = "toy:Cart"', rounds: int = 1) -> None:
    (here / "campaign.toml").write_text(PLAN.format(robot=robot, rounds=rounds), encoding="utf-8")


def test_a_campaign_runs_tells_how_it_stands_and_reports(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan(here)
    assert main(["run"]) == 0
    told = capsys.readouterr()
    for word in ("experiment", "calibrate", "optimize", "transfer", "validate", "best so far"):
        assert word in told.err
    assert "best on the robot" in told.out
    assert main(["status", "--json"]) == 0
    state = json.loads(capsys.readouterr().out)
    assert state["phase"] == "ended"
    assert state["best_score"] < state["first_score"]
    assert set(state["best_settings"]) == {"proportional", "feed forward"}
    assert main(["report", "--out", "story.html"]) == 0
    story = (here / "story.html").read_text("utf-8")
    assert not re.search(r'(src|href)="(https?:)?//', story)
    assert "<script" not in story
    for word in ("Kendall", "trial-001", "gain", "toy:Lag"):
        assert word in story
    assert (here / "round-1" / "calibration.html").exists()


def test_the_second_run_does_not_touch_the_first(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan(here)
    assert main(["run", "--out", "out", "-q"]) == 0
    kept = {p: p.read_bytes() for p in (here / "out").rglob("*") if p.is_file()}
    assert main(["run", "--out", "out", "--seed", "4", "-q"]) == 0
    assert all(p.read_bytes() == content for p, content in kept.items())
    assert (here / "out-2" / JOURNAL).exists()
    capsys.readouterr()
    assert main(["run", "--out", "out", "--json"]) == 0  # the same plan once more: what it came to, and nothing new
    told = capsys.readouterr()
    assert json.loads(told.out)["phase"] == "ended"
    assert "has ended, so nothing is run" in told.err.replace("\n", " ")
    assert not (here / "out-3").exists()
    assert main(["run", "--out", "other", "-q"]) == 0
    assert (here / "other" / JOURNAL).read_bytes() == (here / "out" / JOURNAL).read_bytes()


def test_an_edited_plan_says_how_to_go_on_with_the_older_one(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan(here, 'type = "toy:Cart"\nforgetful = true')
    assert main(["run"]) == 1  # begun, and nobody could be asked whether the robot may move
    plan(here)
    capsys.readouterr()
    assert main(["run"]) == 0
    said = capsys.readouterr().err.replace("\n", " ")
    assert "`trueup resume .`" in said


def test_a_plan_beyond_its_limits_is_refused_dry_and_has_not_begun(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan(here)
    text = (here / "campaign.toml").read_text("utf-8")
    (here / "campaign.toml").write_text(text + "[limits.workspace]\nx = [-0.2, 0.2]\n", encoding="utf-8")
    for command in (["run", "--dry-run"], ["run"], ["run", "."]):
        assert main(command) == 1
        assert "is not handed out: 'x' of reference" in capsys.readouterr().err
    assert main(["status"]) == 0
    assert "not begun" in capsys.readouterr().out
    assert main(["resume"]) == 1
    assert "`trueup run` takes it as it is now" in capsys.readouterr().err.replace("\n", " ")
    (here / "campaign.toml").write_text(text, encoding="utf-8")
    assert main(["run", "-q"]) == 0
    assert not (here / "run-2").exists()


@pytest.mark.parametrize("command", ["status", "resume", "report"])
def test_a_folder_without_a_campaign_is_said_to_be_none(
    here: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    assert main([command, str(here)]) == 1
    assert "not a campaign's folder" in capsys.readouterr().err.replace("\n", " ")


def test_a_mistake_in_the_plan_is_one_message(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan(here, rounds=0)
    assert main(["run"]) == 1
    said = capsys.readouterr().err
    assert "rounds = 0 must be at least 1" in said
    assert "Traceback" not in said
    assert main(["run", "nowhere.toml"]) == 1
    assert "nowhere.toml" in capsys.readouterr().err


def test_hardware_does_not_move_unasked(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan(here, 'type = "toy:Cart"\nforgetful = true\nfolder = "machine"')
    assert main(["run"]) == 1
    said = capsys.readouterr().err
    assert "about to perform one trial, and the plan sets no limits" in said
    assert "trial-001: 4 s, proportional = 1, feed forward = 0.5, target of 101 rows" in said.replace("\n", " ")
    assert "--yes" in said
    assert not (here / "machine").exists()
    assert main(["resume", "--yes"]) == 0
    assert len((here / "machine" / "performed.txt").read_text().split()) == 5


class Operator(threading.Thread):
    """Runs what lies in the outbox on the toy's robot, and drops its logs; stops after `most` trials."""

    def __init__(self, folder: Path, most: int) -> None:
        super().__init__(daemon=True)
        file = read_plan(folder / "campaign.toml")
        self._parts = parts_of(file, folder, lambda line: None)
        toy = __import__("toy")
        self._cart, self._folder, self._left = toy.Cart(), folder, most
        self.stop = threading.Event()

    def run(self) -> None:
        done = {p.stem for p in (self._folder / "accepted").glob("trial-*")}
        while not self.stop.is_set() and self._left:
            for sheet in sorted((self._folder / "outbox").glob("trial-*")):
                if sheet.name not in done and self._left:
                    self._drive(sheet)
                    done.add(sheet.name)
                    self._left -= 1
            time.sleep(0.01)

    def _drive(self, sheet: Path) -> None:
        from dataclasses import replace

        asked = json.loads((sheet / "trial.json").read_text())
        trial = replace(self._parts.task.trials[0], name=sheet.name, settings=asked["settings"])
        (recording,) = self._cart.perform(trial)
        columns = [recording.channel(c).values[:, 0] for c in ("position", "command")]
        head = "time,position/x,command/x"
        np.savetxt(self._folder / "inbox" / f"{sheet.name}.csv", np.column_stack([recording.time, *columns]),
                   delimiter=",", header=head, comments="", fmt="%.12g")  # fmt: skip


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Ctrl-C interrupts, also where the tests were started in the background, whose children ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c")
def test_a_campaign_by_hand_goes_on_the_next_day(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan(here, 'type = "by-hand"\npoll = 0.01\nrest = 0.03')
    first = Operator(here, most=2)
    first.start()

    def evening() -> None:
        while len(list((here / "accepted").glob("*/outcome.json"))) < 2:
            time.sleep(0.01)
        _thread.interrupt_main()

    threading.Thread(target=evening, daemon=True).start()
    assert main(["run"]) == 130
    said = capsys.readouterr().err
    assert "trueup resume" in said
    assert "run outbox/trial-002 ... 004" in said.replace("\n", " ")
    assert main(["status", "--json"]) == 0
    state = json.loads(capsys.readouterr().out)
    assert "trial-004" in state["waiting"]
    second = Operator(here, most=9)
    second.start()
    assert main(["resume"]) == 0
    second.stop.set()
    done = [e for e in read_journal(here) if isinstance(e, TrialDone)]
    assert [e.outcome for e in done] == ["done"] * 5
    assert len(list((here / "accepted").glob("*/trial-*.csv"))) == 5  # the operator's own files are all there
    assert "best on the robot" in capsys.readouterr().out
    retract(here, "trial-002")  # the wrong log was dropped
    third, asked = Operator(here, most=9), len(done)
    third.start()
    assert main(["resume"]) == 0
    third.stop.set()
    again = [e for e in read_journal(here) if isinstance(e, TrialDone)]
    assert [e.outcome for e in again] == ["done"] * asked
    aside = sorted((here / "retracted-1" / "accepted").glob("*/trial-*.csv"))
    assert [p.parent.name for p in aside] == ["trial-002", "trial-005"]
    assert len(list((here / "accepted").glob("*/trial-*.csv"))) == asked


@pytest.mark.parametrize("template", ["blank", "stanley"])
def test_new_writes_a_plan_that_reads_and_never_overwrites(
    here: Path, capsys: pytest.CaptureFixture[str], template: str
) -> None:
    assert main(["new", "mine", "--from", template]) == 0
    found = read_plan(here / "mine" / "campaign.toml")
    assert found.plan.name == "mine"
    before = (here / "mine" / "campaign.toml").read_bytes()
    assert main(["new", "mine"]) == 1
    assert "exists already" in capsys.readouterr().err
    assert (here / "mine" / "campaign.toml").read_bytes() == before
    assert main(["new", "other", "--from", "stanly"]) == 1
    assert "did you mean 'stanley'" in capsys.readouterr().err


def test_every_default_in_the_blank_plan_is_what_it_says(here: Path) -> None:
    """The comments of the scaffold show defaults: uncommented, they change nothing."""
    assert main(["new", "mine"]) == 0
    path = here / "mine" / "campaign.toml"
    plain = read_plan(path).plan
    text = path.read_text("utf-8")
    spoken = re.sub(r"^# ((?:seed|settings|later|repeats|again|evaluations|samples|risk|widen|within|trust|"
                    r"candidates|confirm|incumbent|rounds|patience|trials|method|"
                    r"search) = )", r"\1", text, flags=re.MULTILINE)  # fmt: skip
    assert spoken.count("\n# ") < text.count("\n# ")
    path.write_text(spoken, encoding="utf-8")
    assert _said(read_plan(path).plan) == _said(plain)


def _said(found: object) -> str:
    """A plan as text, without where each part of it was read."""
    return re.sub(r"where='[^']*'", "", repr(found))
