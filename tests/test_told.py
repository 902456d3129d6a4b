# SPDX-License-Identifier: Apache-2.0
"""What people saw of a run comes back from its recording as it was told; what cannot be is refused with a sentence."""

from __future__ import annotations

from dataclasses import replace

import pytest

from trueup.ends import Ended, ended
from trueup.errors import TrialError
from trueup.told import SIDES, Told, told
from trueup.trial import Trial, Watched

LAPS = Trial(
    "trial-001", 0.0, 120.0, None, {}, settings={"fast": 0.4},
    watched=Watched((2.0, 4.0, 6.0), lambda values: float(values[0]), "at the line", "veered"),
)  # fmt: skip
FRONT = replace(LAPS, duration=15.0, watched=Watched(fastest=lambda values: float(values[0])))


@pytest.mark.parametrize(
    ("trial", "said", "end"),
    [
        (LAPS, Told((10.0, 18.04, 26.3)), Ended(26.3, "at the line")),
        (LAPS, Told((10.0,), fell="forward"), Ended(10.0, "fallen")),
        (LAPS, Told(fell="left"), Ended(0.0, "fallen")),
        (LAPS, Told((10.0, 18.0), 5.5, veered=True), Ended(120.0, "veered")),
        (LAPS, Told((10.0,), late=True), None),
        (FRONT, Told(metres=3.1), None),
        (FRONT, Told(metres=1.2, fell="backward"), Ended(15.0, "fallen")),
    ],
)
def test_what_was_told_comes_back(trial: Trial, said: Told, end: Ended | None) -> None:
    recording = said.recording(trial)
    assert ended(recording) == end
    assert trial.watched is not None
    again = told(recording, trial.watched)
    assert again.seconds == said.seconds
    assert again.fell == said.fell
    far = (0.0, *trial.watched.lines)[len(said.seconds)]
    assert again.metres == (far if said.metres != said.metres else said.metres)
    assert said.words(trial).count("over line") == len(said.seconds)


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (Told((-3.0,)), "above zero"),
        (Told((float("nan"), 18.0, 26.0)), "above zero"),
        (Told((1.0, 18.0, 26.0)), r"2 m/s to line 1, where these settings' steps allow 0.4 m/s"),
        (Told((10.0, 10.5, 26.0)), "4 m/s to line 2"),
        (Told((10.0, 9.0, 26.0)), "times of lines grow"),
        (Told((10.0, 18.0, 26.0, 40.0)), "4 times, where 3 lines are asked for"),
        (Told((10.0, 18.0, 130.0)), "over after 120 s.*late = true"),
        (Told((10.0,)), "line 1 alone of 3, and nothing says how it ended: fell, veered, or late"),
        (Told((10.0, 18.0, 26.0), fell="left"), "passed the last line, where the run is over, and fell"),
        (Told((10.0,), fell="left", late=True), "one way, and this one fell and late"),
        (Told((10.0,), fell="over"), "'over' is not one of: forward, backward, left, right, unknown"),
        (Told((10.0,), 1.0, fell="left"), "metres = 1: it passed the line at 2 m"),
        (Told((10.0,), 4.5, fell="left"), "beyond the line at 4 m"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(said: Told, why: str) -> None:
    with pytest.raises(TrialError, match=why):
        said.recording(LAPS)


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (Told(), "how far it came in 15 s"),
        (Told(metres=31.0), r"2.07 m/s, where these settings' steps allow 0.4"),
        (Told(metres=-1.0), "counted from the start"),
        (Told((3.0,)), "1 times, where none is asked for"),
        (Told(metres=1.0, veered=True), "no line bounds the way"),
    ],
)
def test_a_walk_ahead_is_told_in_metres(said: Told, why: str) -> None:
    with pytest.raises(TrialError, match=why):
        said.recording(FRONT)


def test_a_trial_that_nobody_can_judge_so_asks_for_a_log() -> None:
    with pytest.raises(TrialError, match="asks for a log"):
        Told((3.0,)).recording(replace(LAPS, watched=None))


def test_a_side_tells_forward_from_backward() -> None:
    assert [Told(fell=side).forward for side in SIDES] == [1.0, 0.0, 0.5, 0.5, 0.5]
