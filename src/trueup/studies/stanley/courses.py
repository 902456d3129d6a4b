# SPDX-License-Identifier: Apache-2.0
"""Do gains hold on other paths? Tuned on one course and on several, driven by the robot on courses that neither has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.loop.optimize import optimize
from trueup.robots.stand_in_vehicle import StandInVehicle
from trueup.search.cma_es import CmaEs
from trueup.simulators.simulator import Simulator
from trueup.studies.stanley import chasi

Array = NDArray[np.float64]

TRAINING = ("hairpin", "figure_eight", "slalom")
"""The study's own course first; the others add right turns, and turns that follow one another."""
HELD_OUT = ("rounded_rectangle", "chicane", "loops")


@dataclass(frozen=True, eq=False)
class Courses:
    """True errors of the robot in m, by gains (rows) and course (columns)."""

    courses: tuple[str, ...]
    rows: tuple[str, ...]
    gains: Array
    """(rows, m)."""
    errors: Array
    """(rows, courses)."""

    @property
    def held_out(self) -> Array:
        """(rows,) mean error on the courses that nothing was tuned on."""
        return self.errors[:, [self.courses.index(c) for c in HELD_OUT]].mean(axis=1)

    @property
    def summary(self) -> tuple[float, float, float]:
        """On the held-out courses: today's gains, tuned on one course (the mean of the choices), tuned on all three."""
        held = self.held_out
        return float(held[0]), float(held[1:-1].mean()), float(held[-1])


def across_courses(
    robot: StandInVehicle, simulator: Simulator, models: Array, *, seed: int = 0, evaluations: int = 160,
    gains: tuple[str, ...] = chasi.TUNED,
) -> Courses:  # fmt: skip
    """Tunes in the calibrated simulator, of samples `models` (p, n), on each training course alone and on all of them."""
    start = chasi.task(gains=gains).parameters
    rows = {"today's gains": start.nominal}
    choices = {f"tuned on the {name.replace('_', ' ')}": (name,) for name in TRAINING}
    for label, paths in {**choices, "tuned on all three": TRAINING}.items():
        task = chasi.task(paths, gains)
        search = CmaEs(np.clip(start.to_unit(start.nominal), 0.0, 1.0), seed=seed, max_evaluations=evaluations)
        optimum = optimize(task, simulator, models, search)
        rows[label] = start.from_unit(optimum.unit[optimum.best])
    courses = (*TRAINING, *HELD_OUT)
    tried = np.array(list(rows.values()))
    errors = np.stack([true_errors(robot, c, tried, gains) for c in courses], axis=1)
    return Courses(courses, tuple(rows), tried, errors)


def true_errors(
    robot: StandInVehicle, course: str, gains: Array, names: Sequence[str] = chasi.TUNED, *, repeats: int = 4,
    measure: str = "rms",
) -> Array:  # fmt: skip
    """(b,) distance of the robot from a course in truth, not as measured, in m.

    Gains are (b, m), for `names`; each is driven `repeats` times, the mean counts. The same noise acts on all.
    """
    task = chasi.task((course,), tuple(names), measure)
    found = []
    for run in range(repeats):
        truth = robot.drive(task.trials[0], np.atleast_2d(gains), tuple(names), noise=run).truth
        heading = truth[:, :, 2]
        ahead = task.settings.wheelbase * np.stack([np.cos(heading), np.sin(heading)], axis=2)
        found.append(task.distances(truth[:, :, :2] + ahead, task.paths[0]))
    return np.mean(found, axis=0)
