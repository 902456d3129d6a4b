# SPDX-License-Identifier: Apache-2.0
"""Runs the whole study on one stand-in robot and writes its report: what `make demo` shows."""

from __future__ import annotations

import dataclasses
import signal
import time
import warnings
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from trueup.arrays import Array
from trueup.campaign.history import History
from trueup.engines.vehicle import BETAS
from trueup.loop.transfer import try_on_robot
from trueup.robots.stand_in_vehicle import StandInVehicle
from trueup.studies.stanley import chasi
from trueup.studies.stanley.courses import across_courses, true_errors
from trueup.studies.stanley.paper import (
    CALIBRATION_TRIALS,
    TUNING_TRIALS,
    PaperStudy,
    Told,
    calibrate_betas,
    on_path,
    paper_study,
)  # fmt: skip
from trueup.studies.stanley.profile import profiles
from trueup.studies.stanley.rounds import in_rounds
from trueup.studies.stanley.study import Study
from trueup.tasks.task import as_rollout

NOISY = (*BETAS, "position_noise", "heading_noise")


def run_study(
    folder: Path | None, say: Callable[[str], None] = lambda line: None, *, number: int = 0, seed: int = 0,
    calibration_trials: int = CALIBRATION_TRIALS, tuning_trials: int = TUNING_TRIALS, evaluations: int = 160,
    rounds: int = 2, told: Told | None = None,
) -> Study:  # fmt: skip
    """The study on stand-in `number`; its pages go to folder/report.html and study.html unless `folder` is None.

    `evaluations` candidates are tried in each of the `rounds` of the shipped plan. `say` is given one line at each step.
    Raises OutputError where the folder cannot be written.
    """
    began = time.perf_counter()
    robot = chasi.robot(number, seed)
    _compiled(robot)
    say(f"compiled the vehicle, its controller and time warping in {time.perf_counter() - began:.0f} s")
    with get_context("spawn").Pool(1, _unheard) as beside:
        # In a process of its own, as the rest mostly takes one core; what ends the rest ends it too.
        asked = {"seed": seed, "evaluations": min(evaluations, 120)}
        others = beside.apply_async(across_courses, (robot,), asked)
        paper, lasted = _paper(robot, seed, calibration_trials, tuning_trials, say, told)
        story = in_rounds(robot, seed=seed, say=say, rounds=rounds, evaluations=evaluations)
        task = chasi.task()
        drives = [r for runs in try_on_robot(robot, task, task.parameters.nominal).recordings for r in runs]
        betas = chasi.simulator(BETAS, 0.0, 0.0)
        seen = profiles(chasi.task(gains=("k1", "k2", "k3")), betas, paper.calibration.best, np.ones(3), drives[0])
        noisy = calibrate_betas(drives[0], NOISY, seed=seed, trials=calibration_trials, told=told)
        courses = others.get()
    today, one, several = courses.summary
    say(
        f"courses that nothing was tuned on: {_mm(today)} with today's gains, {_mm(one)} tuned on one, "
        f"{_mm(several)} on {courses.trained}"
    )
    study = Study(
        paper, lasted, story, noisy, (robot.truth.position_noise, robot.truth.heading_noise), seen, courses,
        _errors(robot, paper, story), _driven(robot, story), time.perf_counter() - began,
    )  # fmt: skip
    return study if folder is None else _reported(study, Path(folder), say)


def _unheard() -> None:
    """A process that leaves Ctrl-C to the one that began it, and says nothing of loops that are compiled."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore")


def _paper(
    robot: StandInVehicle, seed: int, calibration_trials: int, tuning_trials: int, say: Callable[[str], None],
    told: Told | None,
) -> tuple[PaperStudy, float]:  # fmt: skip
    """The paper's way, and how long it took, in s."""
    started = time.perf_counter()
    paper = paper_study(robot, seed=seed, calibration_trials=calibration_trials, tuning_trials=tuning_trials, told=told)
    lasted = time.perf_counter() - started
    trials = calibration_trials + tuning_trials
    say(f"the paper's way: {trials} simulated runs of {chasi.DURATION:.0f} s and 2 on the robot in {lasted:.1f} s; "
        f"as the robot measures itself {_mm(paper.scores[0])} -> {_mm(paper.scores[1])} from its path")  # fmt: skip
    return paper, lasted


def _reported(study: Study, folder: Path, say: Callable[[str], None]) -> Study:
    from trueup.studies.stanley.demo_page import write_demo_report
    from trueup.studies.stanley.report import write_study_report  # pictures are loaded when there is something to show

    write_study_report(study, folder / "study.html")
    path = write_demo_report(study, folder / "report.html")
    say(f"wrote {path}")
    return dataclasses.replace(study, report=path)


def _errors(robot: StandInVehicle, paper: PaperStudy, rounds: History) -> Array:
    """(3,) what really happens, localisation noise aside."""
    initial = np.array([*paper.tuning.start, 0.0])
    gains = np.array([initial, [*paper.tuning.best, 0.0], list(rounds.best[0].values())])
    return true_errors(robot, "hairpin", gains)


def _driven(robot: StandInVehicle, rounds: History) -> tuple[Array, Array]:
    """Where the robot drives with the gains that it came with, and with the best of the rounds."""
    task = chasi.task()
    best = np.array([rounds.best[0][name] for name in task.parameters.names])
    runs = [try_on_robot(robot, task, gains).recordings[0][0] for gains in (task.parameters.nominal, best)]
    first, last = (on_path(task, as_rollout(task.trials[0], [r])) for r in runs)
    return first, last


def _compiled(robot: StandInVehicle) -> None:
    """Runs everything once, briefly, so that compilation does not count as the study."""
    twin = StandInVehicle(robot.truth, robot.settings, seed=99)
    paper_study(twin, calibration_trials=2, tuning_trials=2)


def _mm(error: float) -> str:
    return f"{1e3 * error:.1f} mm"
