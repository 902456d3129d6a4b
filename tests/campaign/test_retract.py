# SPDX-License-Identifier: Apache-2.0
"""What became of a trial can be taken back, and the campaign is then the one in which that mistake was never made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from trueup.calibration import Calibration
from trueup.campaign.campaign import Campaign
from trueup.campaign.events import TrialDone, TrialPlanned
from trueup.campaign.folder import Folder
from trueup.campaign.journal import JOURNAL, Journal, read_journal
from trueup.campaign.plan import read_plan
from trueup.campaign.resolve import parts_of
from trueup.campaign.retract import retract
from trueup.cli import main
from trueup.errors import JournalError, RecordingError
from trueup.recording import Recording
from trueup.trial import Trial

Write = Callable[..., Path]


class Misread:
    """A robot around another, of which one run is recorded wrong."""

    repeatable = False

    def __init__(self, robot: object, trial: str) -> None:
        self._robot, self._trial = robot, trial
        self.asked: list[str] = []

    def perform(self, trial: Trial) -> list[Recording]:
        self.asked.append(trial.name)
        found: list[Recording] = self._robot.perform(trial)  # type: ignore[attr-defined]
        if trial.name != self._trial:
            return found
        return [r.replace(channels={n: c.replace(values=3.0 * c.values) for n, c in r.channels.items()}) for r in found]


def run(plan: Path, out: Path, wrong: str = "") -> list[str]:
    """The trials that were asked of the robot."""
    folder = Folder.begin(read_plan(plan), out, None)
    parts = parts_of(folder.file, folder.path, lambda line: None)
    robot = Misread(parts.robot, wrong)
    with Journal(folder.path) as journal:
        Campaign(folder.file.plan, folder.checksum, "0", replace(parts, robot=robot), journal).run()
    return robot.asked


def test_a_trial_taken_back_leaves_no_trace_in_what_follows(write_plan: Write, tmp_path: Path) -> None:
    plan, right, out = write_plan(), tmp_path / "right", tmp_path / "out"
    run(plan, right)
    every = [e.trial for e in read_journal(right) if isinstance(e, TrialPlanned)]
    misread = every[3]
    run(plan, out, misread)
    assert (out / JOURNAL).read_bytes() != (right / JOURNAL).read_bytes()
    aside, later = retract(out, misread)
    assert (aside / "recordings" / f"{misread}.json").exists()
    assert later
    assert all(name > misread for name in later)
    assert all((aside / "recordings" / f"{name}.json").exists() for name in later)
    assert run(plan, out) == [misread, *later]  # what was planned beside it is not asked for again
    assert (out / JOURNAL).read_bytes() == (right / JOURNAL).read_bytes()


def test_what_has_no_outcome_is_refused_and_the_command_says_what_it_did(
    write_plan: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, out = write_plan(("rounds = 2", "rounds = 1")), tmp_path / "out"
    run(plan, out)
    with pytest.raises(JournalError, match="'trial-099' has no outcome to take back; trials that have: trial-001, "):
        retract(out, "trial-099")
    before = (out / JOURNAL).read_bytes()
    assert main(["resume", str(out), "--retract", "trial-002", "--yes"]) == 0
    assert "trial-002 is taken back" in capsys.readouterr().err
    assert (out / "retracted-1" / "journal-1.jsonl").read_bytes() == before
    assert [e.trial for e in read_journal(out) if isinstance(e, TrialDone)].count("trial-002") == 1


def test_a_recording_that_no_calibration_can_use_is_said_with_the_command_that_takes_it_back(
    write_plan: Write, tmp_path: Path
) -> None:
    def picky(recordings: Sequence[Recording], *rest: object) -> Calibration:
        raise RecordingError(f"recording '{recordings[1].name}' has no stretch in which the vehicle moves")

    folder = Folder.begin(read_plan(write_plan()), tmp_path / "out", None)
    parts = replace(parts_of(folder.file, folder.path, lambda line: None), calibrator=picky)
    with Journal(folder.path) as journal, pytest.raises(RecordingError) as error:
        Campaign(folder.file.plan, folder.checksum, "0", parts, journal).run()
    assert f"in which the vehicle moves. `trueup resume {folder.path} --retract trial-002` takes" in str(error.value)
    assert "trial-001" not in str(error.value)
