# SPDX-License-Identifier: Apache-2.0
"""What people saw of a run comes back from its recording as it was told; what cannot be is refused with a sentence."""

from __future__ import annotations

from dataclasses import replace

import pytest

from trueup.ends import Ended, ended
from trueup.errors import TrialError
from trueup.trial import Trial, Watched
from trueup.watched_run import SIDES, WatchedRun, watched_run

LAPS = Trial(
    "trial-001", 0.0, 120.0, None, {}, settings={"fast": 0.4},
    watched=Watched((2.0, 4.0, 6.0), lambda values: float(values[0]), "at the line", "veered"),
)  # fmt: skip
FRONT = replace(LAPS, duration=15.0, watched=Watched(fastest=lambda values: float(values[0])))


@pytest.mark.parametrize(
    ("trial", "said", "end"),
    [
        (LAPS, WatchedRun((10.0, 18.04, 26.3)), Ended(26.3, "at the line")),
        (LAPS, WatchedRun((10.0,), fell="forward"), Ended(10.0, "fallen")),
        (LAPS, WatchedRun(fell="left"), Ended(0.0, "fallen")),
        (LAPS, WatchedRun((10.0, 18.0), 5.5, veered=True), Ended(120.0, "veered")),
        (LAPS, WatchedRun((10.0,), late=True), None),
        (FRONT, WatchedRun(metres=3.1), None),
        (FRONT, WatchedRun(metres=1.2, fell="backward"), Ended(15.0, "fallen")),
    ],
)
def test_what_was_told_comes_back(trial: Trial, said: WatchedRun, end: Ended | None) -> None:
    recording = said.recording(trial)
    assert ended(recording) == end
    assert trial.watched is not None
    again = watched_run(recording, trial.watched)
    assert again.seconds == said.seconds
    assert again.fell == said.fell
    far = (0.0, *trial.watched.lines)[len(said.seconds)]
    assert again.metres == (far if said.metres != said.metres else said.metres)
    assert said.words(trial).count("over line") == len(said.seconds)


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (WatchedRun((-3.0,)), "above zero"),
        (WatchedRun((float("nan"), 18.0, 26.0)), "above zero"),
        (WatchedRun((1.0, 18.0, 26.0)), r"2 m/s to line 1, where these settings' steps allow 0.4 m/s"),
        (WatchedRun((10.0, 10.5, 26.0)), "4 m/s to line 2"),
        (WatchedRun((10.0, 9.0, 26.0)), "times of lines grow"),
        (WatchedRun((10.0, 18.0, 26.0, 40.0)), "4 times, where 3 lines are asked for"),
        (WatchedRun((10.0, 18.0, 130.0)), "over after 120 s.*late = true"),
        (WatchedRun((10.0,)), "line 1 alone of 3, and nothing says how it ended: fell, veered, or late"),
        (WatchedRun((10.0, 18.0, 26.0), fell="left"), "passed the last line, where the run is over, and fell"),
        (WatchedRun((10.0,), fell="left", late=True), "one way, and this one fell and late"),
        (WatchedRun((10.0,), fell="over"), "'over' is not one of: forward, backward, left, right, unknown"),
        (WatchedRun((10.0,), 1.0, fell="left"), "metres = 1: it passed the line at 2 m"),
        (WatchedRun((10.0,), 4.5, fell="left"), "beyond the line at 4 m"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(said: WatchedRun, why: str) -> None:
    with pytest.raises(TrialError, match=why):
        said.recording(LAPS)


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (WatchedRun(), "how far it came in 15 s"),
        (WatchedRun(metres=31.0), r"2.07 m/s, where these settings' steps allow 0.4"),
        (WatchedRun(metres=-1.0), "counted from the start"),
        (WatchedRun((3.0,)), "1 times, where none is asked for"),
        (WatchedRun(metres=1.0, veered=True), "no line bounds the way"),
    ],
)
def test_a_walk_ahead_is_told_in_metres(said: WatchedRun, why: str) -> None:
    with pytest.raises(TrialError, match=why):
        said.recording(FRONT)


def test_a_trial_that_nobody_can_judge_so_asks_for_a_log() -> None:
    with pytest.raises(TrialError, match="asks for a log"):
        WatchedRun((3.0,)).recording(replace(LAPS, watched=None))


def test_a_side_tells_forward_from_backward() -> None:
    assert [WatchedRun(fell=side).forward for side in SIDES] == [1.0, 0.0, 0.5, 0.5, 0.5]
