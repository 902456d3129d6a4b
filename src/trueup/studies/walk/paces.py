# SPDX-License-Identifier: Apache-2.0
"""A faster walk by two numbers found on the robot, how boldly it walks and how it leans, within its trials and time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from trueup.loop.dosing import SURE, Ledger
from trueup.robots.robot import Robot
from trueup.studies.walk.evaluation import Runs, at_once
from trueup.studies.walk.study import Budget, Story, Tried, lap_track, spent
from trueup.tasks.task import robot_tally
from trueup.tasks.walking import LineWalk

LAPS = 3
"""Lines behind one another of a trial: bold walks are quick, and there is time for three."""


def paced(
    robot: Robot, budget: Budget, seed: int, *, line: LineWalk | None = None, told: Callable[[str], None] | None = None
) -> Story:
    """The story of a robot on which the start walk's pace and lean are found (`loop.dosing`), within the budget.

    The first trials are of the start walk; what is worth the most in the end is one of the walks that were tried.
    """
    say = told or (lambda _: None)
    track = replace(lap_track(line, replace(budget, laps=LAPS)), fall=budget.fall)
    grades = track.grades()
    rng, ledger, runs = np.random.default_rng([seed, budget.trials]), Ledger(grades), dict[int, Runs]()

    def tried(grade: int, label: str) -> Runs:
        done = at_once(robot, track, grades.settings[grade], 1, label)
        ledger.add(grade, robot_tally(track, [done.recordings]))
        runs[grade] = runs.get(grade, Runs()) + done
        return done

    for k in range(budget.start):
        tried(0, f" start {k}")
    count, last = budget.start, budget.trials - round(SURE * budget.trials)
    while not spent(list(runs.values()), budget):
        grade = ledger.next(rng, settled=count >= last)
        assert grade is not None  # none is barred
        done = tried(grade, f" pace {seed} {count}")
        count += 1
        steps, lean = grades.numbers[grade]
        say(f"trial {count}: steps x {steps:g}, lean {1e3 * lean:+.0f} mm: {ended_in(done)}")
    _, worths = ledger.best(rng)
    rows = zip(ledger.tried, worths, strict=True)
    return Story(tuple(Tried(min(k, 1), grades.settings[g], None, runs[g], float(w)) for k, (g, w) in enumerate(rows)))


def ended_in(runs: Runs) -> str:
    """What became of a trial, in words."""
    if not runs.failed:
        return f"{100 * runs.speed:.1f} cm/s"
    return "fell forward" if runs.forward else "fell backward" if runs.falls else "veered"
