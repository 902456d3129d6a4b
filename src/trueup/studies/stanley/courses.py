# SPDX-License-Identifier: Apache-2.0
"""Do gains hold on other paths? Tuned on one course and on several, driven by the robot on courses that neither has seen.

Courses to train on and courses held out are drawn from one distribution of shapes, curvatures and speeds (`drawn_courses`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.campaign.kinds import drives as calibrate_drives
from trueup.engines.simulator import Simulator
from trueup.loop.belief import Belief
from trueup.loop.optimize import TrustRegion, optimize
from trueup.loop.plausible import plausible
from trueup.loop.transfer import shortlist, try_on_robot
from trueup.paths import Path, SpeedLimits
from trueup.paths.courses import LIMITS, Piece, from_pieces
from trueup.robots.stand_in_vehicle import StandInVehicle
from trueup.search.cma_es import CmaEs
from trueup.studies.stanley import chasi
from trueup.tasks.follow_path import FollowPath
from trueup.tracking.windows import noise_of

TRAINING, HELD_OUT = 4, 6
"""How many courses are drawn of each kind."""
_POPULATION = 6  # of a search that may look at a hundred candidates: larger ones are still on their way by then
_RISK = 0.3  # deviations between samples count little, since the robot itself tries what comes out
_APART = 0.15  # share of the range by which candidates for the robot differ


@dataclass(frozen=True, eq=False)
class Courses:
    """True errors of the robot in m, by gains (rows) and course (columns)."""

    courses: tuple[Path, ...]
    """Those that were trained on, then those held out."""
    rows: tuple[str, ...]
    """Today's gains, tuned on each of the first courses alone, tuned on all of them."""
    gains: Array
    """(rows, m)."""
    errors: Array
    """(rows, courses)."""

    @property
    def trained(self) -> int:
        """How many of the courses were trained on."""
        return len(self.rows) - 2

    @property
    def held_out(self) -> Array:
        """(rows,) error on the courses that nothing was tuned on: the geometric mean, as a task of several paths has it."""
        return np.exp(np.log(self.errors[:, self.trained :]).mean(axis=1))

    @property
    def worst(self) -> Array:
        """(rows,) the greatest error on a held-out course."""
        return self.errors[:, self.trained :].max(axis=1)

    @property
    def summary(self) -> tuple[float, float, float]:
        """On the held-out courses: today's gains, tuned on one course (geometric mean of the choices), on all of them."""
        held = self.held_out
        return float(held[0]), float(np.exp(np.log(held[1:-1]).mean())), float(held[-1])


def across_courses(
    robot: StandInVehicle, *, seed: int = 0, evaluations: int = 120, tries: int = 3, samples: int = 4,
    gains: tuple[str, ...] = chasi.TUNED,
) -> Courses:  # fmt: skip
    """Tunes on each training course alone and on all of them, in one simulator, and lets the robot choose.

    The simulator is calibrated on one run of each training course with today's gains, and `samples` of what that leaves
    open judge every candidate. All ways have the same budget: as many simulated runs (`evaluations` candidates on all
    courses, as many times more on a single one), and as many runs of the robot (`tries` candidates on all of them). Then the
    chosen gains are driven in truth, on the courses too that nobody trained on.
    """
    rng = np.random.default_rng([seed, 20261121])
    training, held_out = drawn_courses(TRAINING, rng), drawn_courses(HELD_OUT, rng)
    whole = chasi.task(training, gains)
    space = whole.parameters
    simulator, models = _calibrated(robot, whole, seed, samples)
    rows = {"today's gains": space.nominal}
    for k, paths in enumerate([*((p,) for p in training), training]):
        label = f"tuned on course {k + 1}" if len(paths) == 1 else f"tuned on all {TRAINING}"
        share = TRAINING // len(paths)
        task = chasi.task(paths, gains)
        rows[label] = _tuned(robot, task, simulator, models, seed, evaluations * share, tries * share)
    tried = np.array(list(rows.values()))
    everything = (*training, *held_out)
    errors = np.stack([true_errors(robot, c, tried, gains, repeats=2) for c in everything], axis=1)
    return Courses(everything, tuple(rows), tried, errors)


def _calibrated(robot: StandInVehicle, task: FollowPath, seed: int, samples: int) -> tuple[Simulator, Array]:
    """A simulator, and (samples, n) of what runs of the task with today's gains leave open of it."""
    start = task.parameters.nominal
    first = try_on_robot(robot, task, start)
    drives = [r for runs in first.recordings for r in runs]
    noise = noise_of(drives)
    simulator = chasi.simulator(position_noise=noise[0], heading_noise=noise[1])
    belief = Belief.of(calibrate_drives(drives, simulator), simulator.parameters)
    models = belief.sample(4 * samples, np.random.default_rng(seed))
    return simulator, plausible(task, simulator, models, start, np.array([first.score]), samples)


def _tuned(
    robot: StandInVehicle,
    task: FollowPath,
    simulator: Simulator,
    models: Array,
    seed: int,
    evaluations: int,
    tries: int,
) -> Array:
    """(m,) the gains that the robot did best with, of `tries` distinct ones that the simulator proposes."""
    space = task.parameters
    region = TrustRegion(np.clip(space.to_unit(space.nominal), 0.0, 1.0), 1.0)
    search = CmaEs(region.inside(region.centre), seed=seed, population=_POPULATION, max_evaluations=evaluations)
    found = optimize(task, simulator, models, search, region, risk=_RISK)
    chosen = shortlist(
        found, region, tries, apart=_APART, incumbent=False, task=task, simulator=simulator, models=models
    )
    scores = [
        try_on_robot(robot, task, space.from_unit(unit), label=f", {k + 1} of {len(chosen.unit)}").score
        for k, unit in enumerate(chosen.unit)
    ]
    return space.from_unit(chosen.unit[int(np.nanargmin(scores))])


def true_errors(
    robot: StandInVehicle, course: str | Path, gains: Array, names: Sequence[str] = chasi.TUNED, *, repeats: int = 4,
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


def drawn_courses(
    count: int, rng: np.random.Generator, *, speeds: tuple[float, float] = (0.3, 1.0),
    radii: tuple[float, float] = (1.0, 3.0), length: float = 22.0, limits: SpeedLimits = LIMITS,
) -> tuple[Path, ...]:  # fmt: skip
    """Courses as a robot may meet them: bends of random radius, angle and side, with or without straights in between.

    Each has a cruising speed (m/s) and a usual radius (m, its bends scatter about it) of its own. Over the `count` courses
    both are a Latin hypercube: every course by itself is drawn evenly from the whole range (radii by their logarithm), and
    together they cover it. Each is about `length` m long and may cross itself.
    """
    speed = _spread(count, rng, *speeds)
    radius = np.exp(_spread(count, rng, math.log(radii[0]), math.log(radii[1])))
    return tuple(
        _winding(f"{v:.2f} m/s, bends of {r:.1f} m", float(v), float(r), radii[0], length, limits, rng)
        for v, r in zip(speed, radius, strict=True)
    )


def _spread(count: int, rng: np.random.Generator, low: float, high: float) -> Array:
    """(count,) one number from each of `count` equal parts of a range, in random order."""
    return low + (high - low) * (rng.permutation(count) + rng.random(count)) / count


def _winding(
    name: str, speed: float, usual: float, tightest: float, length: float, limits: SpeedLimits, rng: np.random.Generator
) -> Path:
    pieces: list[Piece] = [(1.0, 0.0)]
    straights = rng.uniform(0.2, 0.7)
    while sum(way for way, _ in pieces) < length:
        radius = max(tightest, usual * math.exp(rng.normal(0.0, 0.25)))
        pieces.append((math.radians(rng.uniform(30.0, 150.0)) * radius, float(rng.choice([-1.0, 1.0])) / radius))
        if rng.random() < straights:
            pieces.append((float(rng.uniform(0.5, 4.0)), 0.0))
    return from_pieces(name, [([*pieces, (1.0, 0.0)], speed)], limits)
