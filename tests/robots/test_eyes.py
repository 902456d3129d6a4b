# SPDX-License-Identifier: Apache-2.0
"""A walk judged by a stop watch and eyes: what is filled in counts as a log of it would, and nonsense counts nothing."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trueup.controllers.controller import Controller
from trueup.errors import TrialAbortedError
from trueup.parameters import Parameter, ParameterSpace
from trueup.recording import Recording
from trueup.robots.by_hand import ByHand
from trueup.tasks.task import robot_scores, robot_tally, robot_trials
from trueup.tasks.walking import AheadWalk, LineWalk, WalkFront
from trueup.trial import Trial

SPACE = ParameterSpace((Parameter("a", "1", 0.0, -1.0, 1.0),))


def none(values: np.ndarray) -> Controller:
    raise NotImplementedError


def of(kind: type[AheadWalk], **more: object) -> tuple[AheadWalk, Trial]:
    walk = kind(parameters=SPACE, make=none, height=0.4, runs=1, steps=lambda v: np.full(len(v), 0.3), **more)  # type: ignore[arg-type]
    return walk, replace(robot_trials(walk, np.zeros(1))[0], name="trial-001")


class Desk:
    """Where an operator sits."""

    def __init__(self, folder: Path, trial: Trial) -> None:
        self.folder, self.trial, self.said = folder, trial, list[str]()
        self.inbox, self.sheet = folder / "inbox", folder / "outbox" / trial.name
        self.again().hand_out([trial])

    def again(self) -> ByHand:
        self.robot = ByHand(self.folder, say=self.said.append, poll=0.01, rest=0.01)
        return self.robot

    def drop(self, text: str, name: str = "trial-001.toml") -> str:
        (self.inbox / name).write_text(text, encoding="utf-8")
        self.said.clear()
        for _ in range(2):
            self.robot.look()
            time.sleep(0.02)
        return "\n".join(self.said)

    def run(self, text: str, name: str = "trial-001.toml") -> Recording:
        self.drop(text, name)
        (recording,) = self.robot.perform(self.trial)
        return recording


@pytest.mark.parametrize(
    ("laps", "text", "score", "tally"),
    [
        (1, "seconds = 14", -0.17, [[1, np.log(0.17), 0, 0], [0] * 4]),
        (1, 'fell = "forward"', 0.7, [[0, 0, 1, 0], [0] * 4]),
        (1, 'fell = "backward"\nmetres = 1.19', 0.7 - 0.025, [[0, 0, 0, 1], [0] * 4]),
        (1, "veered = true", 0.0, [[0, 0, 0.5, 0.5], [0] * 4]),
        (1, "late = true\nmetres = 2.0", -2.0 / 47.6, [[0, 0, 0.5, 0.5], [0] * 4]),
        (3, "seconds = [14, 24, 34]", -(0.17 + 2 * 0.238) / 3, [[1, np.log(0.17), 0, 0], [2, 2 * np.log(0.238), 0, 0]]),
        (3, 'seconds = [14]\nfell = "right"', (0.7 - 0.17) / 2, [[1, np.log(0.17), 0, 0], [0, 0, 0.5, 0.5]]),
        (3, 'seconds = 14.0\nfell = "forward"', (0.7 - 0.17) / 2, [[1, np.log(0.17), 0, 0], [0, 0, 1, 0]]),
    ],
)  # fmt: skip
def test_what_was_seen_counts_as_a_log_of_it_would(
    tmp_path: Path, laps: int, text: str, score: float, tally: list[list[float]]
) -> None:
    walk, trial = of(LineWalk, laps=laps)
    seen = Desk(tmp_path, trial).run(text)
    assert robot_scores(walk, [[seen]]) == pytest.approx(score)
    np.testing.assert_allclose(robot_tally(walk, [[seen]]), tally)


def test_how_far_it_came_is_what_a_walk_ahead_makes_good(tmp_path: Path) -> None:
    walk, trial = of(WalkFront)
    seen = Desk(tmp_path, trial).run("metres = 3\nnote = 'on the carpet'")
    assert robot_scores(walk, [[seen]]) == pytest.approx(-0.2)
    assert robot_tally(walk, [[seen]])[0].tolist() == pytest.approx([1.0, np.log(0.2), 0.0, 0.0])
    assert seen.provenance["note"] == "came 3 m; on the carpet"


def test_the_sheet_has_a_file_to_fill_in_that_says_nothing_by_itself(tmp_path: Path) -> None:
    desk = Desk(tmp_path, of(LineWalk, laps=2)[1])
    template = (desk.sheet / "trial-001.toml").read_text()
    assert "it says nothing yet" in desk.drop(template)
    read = (desk.sheet / "README.txt").read_text()
    for word in ("seconds", "metres", "fell", "veered", "late", "aborted", "note"):
        assert f"  {word} = " in read
        assert f"# {word} = " in template
    filled = template.replace("# seconds = [] ", "seconds = [14.0, 25.2] ")
    seen = desk.run(filled)
    assert seen.provenance["note"] == "over line 1 after 14 s (0.17 m/s), over line 2 after 25.2 s (0.212 m/s)"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("seconds = 14,2", "cannot be read as TOML.*decimal point"),
        ("seconds = 1.42", r"1.68 m/s to line 1, where these settings' steps allow 0.402 m/s"),
        ("seconds = 'soon'", "seconds = 'soon' is no number"),
        ("seconds = true", "seconds = True is no number"),
        ("seconds = inf", "no number that can be"),
        ("sconds = 14.2", "key 'sconds' is not in such a file .did you mean 'seconds'"),
        ("fell = 'forwards'", "fell = 'forwards' is not one of: forward, backward, left, right, unknown"),
        ("veered = 1", "veered = 1 is neither true nor false"),
        ("outcome = 'won'", "'won' is not one of: aborted, fell, repeat, done"),
    ],
)
def test_nonsense_is_refused_and_nothing_is_lost(tmp_path: Path, text: str, why: str) -> None:
    desk = Desk(tmp_path, of(LineWalk)[1])
    assert re.search(f"trial-001.toml not taken: .*{why}", desk.drop(text))
    assert "trial-001.toml: " in (desk.inbox / "problems.txt").read_text()
    assert (desk.inbox / "trial-001.toml").read_text() == text
    desk.run("seconds = 14.2")  # the trial is open still
    assert "seconds" not in (desk.inbox / "problems.txt").read_text()


@pytest.mark.parametrize("name", ["trial-001.toml.txt", "trial-001-fell.toml", "monday.toml", "Trial 1.toml"])
def test_a_file_is_known_by_what_it_says(tmp_path: Path, name: str) -> None:
    walk, trial = of(LineWalk)
    seen = Desk(tmp_path, trial).run("\ufefffell = 'forward'\n", name)
    assert robot_tally(walk, [[seen]])[0].tolist() == [0.0, 0.0, 1.0, 0.0]


def test_it_is_the_same_the_next_day(tmp_path: Path) -> None:
    desk = Desk(tmp_path, of(LineWalk, laps=2)[1])
    seen = desk.run("seconds = [13.9]\nfell = 'backward'\nmetres = 3.3")
    (again,) = desk.again().perform(desk.trial)
    assert list(again.content()) == list(seen.content())
    assert dict(again.provenance) == dict(seen.provenance)


def test_two_runs_may_look_alike(tmp_path: Path) -> None:
    desk = Desk(tmp_path, replace(of(LineWalk)[1], repeats=2))
    desk.drop("seconds = 14.2", "trial-001-a.toml")
    desk.drop("seconds = 14.2", "trial-001-b.toml")
    assert len(desk.robot.perform(desk.trial)) == 2


def test_a_run_that_was_stopped_says_nothing(tmp_path: Path) -> None:
    desk = Desk(tmp_path, of(LineWalk)[1])
    desk.drop("aborted = true\nnote = 'a cable'")
    with pytest.raises(TrialAbortedError, match="a cable"):
        desk.robot.perform(desk.trial)


def test_what_is_neither_log_nor_filled_in_is_said_to_be_so(tmp_path: Path) -> None:
    said = Desk(tmp_path, of(LineWalk)[1]).drop("seconds\n14.2\n", "trial-001.csv")
    assert "A run without a log is told in trial-001.toml" in said


def test_a_run_that_needs_a_log_is_not_judged_by_eye(tmp_path: Path) -> None:
    desk = Desk(tmp_path, replace(of(LineWalk)[1], watched=None))
    assert not (desk.sheet / "trial-001.toml").exists()
    assert "trial-001 asks for a log" in desk.drop("seconds = 14.2")
