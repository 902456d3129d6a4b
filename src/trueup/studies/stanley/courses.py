# SPDX-License-Identifier: Apache-2.0
"""Do gains hold on other paths? Tuned on one course and on several, driven by the robot on courses that neither has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.loop.belief import Belief
from trueup.loop.optimize import optimize
from trueup.loop.plausible import plausible
from trueup.loop.transfer import try_on_robot
from trueup.robots.stand_in_vehicle import StandInVehicle
from trueup.search.cma_es import CmaEs
from trueup.simulators.simulator import Simulator
from trueup.studies.stanley import chasi
from trueup.studies.stanley.drives import calibrate_drives, doubted, noise_of
from trueup.tasks.follow_path import FollowPath

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
    robot: StandInVehicle, *, seed: int = 0, evaluations: int = 160, samples: int = 4,
    gains: tuple[str, ...] = chasi.TUNED,
) -> Courses:  # fmt: skip
    """Tunes on each training course alone and on all of them, in one simulator and with as many candidates for each.

    The simulator is calibrated on one run of each training course with today's gains, and `samples` of what that leaves
    open judge every candidate. Then all gains are driven in truth, on the courses too that nobody trained on.
    """
    whole = chasi.task(TRAINING, gains)
    space = whole.parameters
    simulator, models = _calibrated(robot, whole, seed, samples)
    rows = {"today's gains": space.nominal}
    choices = {f"tuned on the {name.replace('_', ' ')}": (name,) for name in TRAINING}
    for label, paths in {**choices, "tuned on all three": TRAINING}.items():
        search = CmaEs(np.clip(space.to_unit(space.nominal), 0.0, 1.0), seed=seed, max_evaluations=evaluations)
        found = optimize(chasi.task(paths, gains), simulator, models, search)
        rows[label] = space.from_unit(found.unit[found.best])
    courses = (*TRAINING, *HELD_OUT)
    tried = np.array(list(rows.values()))
    errors = np.stack([true_errors(robot, c, tried, gains) for c in courses], axis=1)
    return Courses(courses, tuple(rows), tried, errors)


def _calibrated(robot: StandInVehicle, task: FollowPath, seed: int, samples: int) -> tuple[Simulator, Array]:
    """A simulator, and (samples, n) of what runs of the task with today's gains leave open of it."""
    start = task.parameters.nominal
    first = try_on_robot(robot, task, start)
    drives = [r for runs in first.recordings for r in runs]
    noise = noise_of(drives)
    simulator = chasi.simulator(position_noise=noise[0], heading_noise=noise[1])
    belief = Belief.of(doubted(calibrate_drives(drives, simulator)), simulator.parameters)
    models = belief.sample(4 * samples, np.random.default_rng(seed))
    return simulator, plausible(task, simulator, models, start, np.array([first.score]), samples)


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
