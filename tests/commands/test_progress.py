# SPDX-License-Identifier: Apache-2.0
"""What is shown of a calibration under way."""

from __future__ import annotations

import io
from dataclasses import replace

from rich.console import Console

from trueup.calibration import WINDOWS, TracePoint
from trueup.campaign.events import Calibrated
from trueup.commands.campaign_view import calibration_words
from trueup.commands.progress import Watcher
from trueup.loop.watch import Watch


def test_a_search_that_begins_anew_is_numbered() -> None:
    shown = io.StringIO()
    with Watcher(Console(file=shown), "m", quiet=False) as watch:
        for count, stage in (
            (21, "first seconds"),
            (90, "all, full step"),
            (7, "first seconds"),
            (30, "all, full step"),
        ):
            watch(TracePoint(stage, count, 1.0, 0.02, 1.0))
    said = [line.split(":")[0].strip() for line in shown.getvalue().splitlines()]
    assert said == ["first seconds", "all, full step", "search 2, first seconds", "search 2, all, full step"]


def test_errors_of_other_stretches_are_not_compared() -> None:
    """What a look at the first 12 s began at is no measure of what all 40 s come to."""
    shown = io.StringIO()
    with Watcher(Console(file=shown), "m", quiet=False) as watch:
        watch(TracePoint("first seconds", 2, 1.0, 0.02, 1.0, 12.0))
        watch(TracePoint("all, full step", 9, 1.0, 0.05, 2.0, 40.0))
    first, then = shown.getvalue().splitlines()
    assert "20.0 -> 20.0 mm over 12.0 s" in first
    assert "50.0 -> 50.0 mm over 40.0 s" in then


def test_a_log_shows_that_a_long_stage_goes_on() -> None:
    shown = io.StringIO()
    with Watcher(Console(file=shown), "m", quiet=False) as watch:
        for seconds in range(100):
            watch(TracePoint("all, full step", seconds, 1.0, 0.02 / (1.0 + seconds), float(seconds)))
    assert [line.split(",")[-1].strip() for line in shown.getvalue().splitlines()] == ["0 s", "30 s", "60 s", "90 s"]


def test_what_is_simulated_between_two_points_of_a_search_shows_that_it_goes_on() -> None:
    shown, passed = io.StringIO(), iter((0.0, 5.0, 40.0, 45.0, 80.0))
    with Watcher(Console(file=shown), "m", quiet=False) as watcher:
        search = Watch(lambda point: watcher(replace(point, seconds=next(passed))))
        search.goes_on(3)  # nothing is known yet
        search.last = TracePoint("what the model lacks", 7, 1.0, 0.02, 0.0)
        for evaluations in (8, 20, 300, 320, 999):
            search.goes_on(evaluations)
    said = [line.split(", ")[1] for line in shown.getvalue().splitlines()]
    assert said == ["8 simulations", "300 simulations", "999 simulations"]
    assert not search.trace


def test_errors_of_other_windows_are_not_compared() -> None:
    """Whole replays of what stands on its feet are far off where windows of them are not."""
    shown = io.StringIO()
    with Watcher(Console(file=shown), "rad", quiet=False) as watch:
        watch(TracePoint(WINDOWS, 2, 1.0, 0.04, 1.0, 12.0))
        watch(TracePoint("all, full step", 9, 1.0, 0.002, 2.0, 12.0))
    assert "2.00 -> 2.00 mrad over 12.0 s" in shown.getvalue().splitlines()[1]


def test_a_campaign_shows_the_ends_of_what_is_known_and_names_what_is_not() -> None:
    event = Calibrated(
        1, ("elbow.kp", "elbow.kv", "delay"), ("N m/rad", "N m s/rad", "s"), (40.0, 0.44, 0.02), (True, True, False),
        (38.5, 0.01, float("nan")), (41.0, 2.4, float("nan")), ("identified", "weak", "frozen"), (), 12.0, 3.0, "mrad",
        ("drive",),
    )  # fmt: skip
    assert calibration_words(event)[1:] == ["elbow.kp 40 [38.5, 41] N m/rad", "known roughly or not at all: elbow.kv"]
