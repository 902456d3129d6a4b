# SPDX-License-Identifier: Apache-2.0
"""The paper's experiment: five betas by Optuna on the warped path, then three gains, then the robot.

"Simulation-Driven Optimization of Stanley Controller Gains for Enhanced Tracking in Autonomous Navigation Robots".
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from trueup.arrays import Array
from trueup.controllers.stanley import GAINS
from trueup.discrepancies.path_shape import mean_distance, path_loss
from trueup.engines.simulator import Rollout
from trueup.engines.vehicle import BETAS, BicycleSimulator
from trueup.noise import estimate_noise
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.robots.robot import Robot
from trueup.search.optuna import OptunaSearch
from trueup.studies.stanley import chasi
from trueup.tasks.follow_path import FollowPath
from trueup.tasks.task import as_rollout, robot_trials

CALIBRATION_TRIALS, TUNING_TRIALS = 324, 116
"""N_s and N_o of the paper."""

SPACING, BAND = 0.04, 0.03
"""Points are warped this far apart (m), and by at most this share of the path: their spacing must stay below the errors
that are to be seen, and the robot is never metres ahead of itself."""

Told = Callable[[str, int, int, float], None]
"""(stage, trials done, all trials, best loss so far in m^2)."""


@dataclass(frozen=True, eq=False)
class Searched:
    """One search by Optuna."""

    names: tuple[str, ...]
    start: Array
    best: Array
    tried: Array
    """(N, n) in the order of the trials, in the parameters' units."""
    losses: Array
    """(N,)."""
    seconds: float


@dataclass(frozen=True, eq=False)
class PaperStudy:
    """What the paper's figure and table show. Paths are (n, 2) in m, of the axle that is steered onto the path."""

    desired: Array
    robot_before: Array
    """T^r with the initial gains."""
    default: Array
    """T^s with the initial gains and default parameters."""
    calibrated: Array
    """T^s with the initial gains and calibrated parameters."""
    tuned: Array
    """T^s with the tuned gains and calibrated parameters."""
    robot_after: Array
    """T^r with the tuned gains."""
    calibration: Searched
    tuning: Searched
    scores: Array = field(default_factory=lambda: np.zeros(2))
    """(2,) distance of the robot from the path before and after, by the task's score, in m."""

    def tracking(self, reading: str) -> tuple[float, float]:
        """Error of the robot before and after, by a reading of eq. (8), or 'mean' distance of warped points in m."""
        if reading == "mean":
            before, after = (mean_distance(self.desired, r, spacing=SPACING, band=BAND) for r in self.robot)
        else:
            before, after = (
                path_loss(self.desired, r, reading=reading, spacing=SPACING, band=BAND) for r in self.robot
            )
        return before, after

    @property
    def robot(self) -> tuple[Array, Array]:
        """What the robot drove before and after."""
        return self.robot_before, self.robot_after


def paper_study(
    robot: Robot, *, seed: int = 0, calibration_trials: int = CALIBRATION_TRIALS, tuning_trials: int = TUNING_TRIALS,
    told: Told | None = None,
) -> PaperStudy:  # fmt: skip
    """Algorithm 1 on a robot: one run, two searches, one more run."""
    task = chasi.task(gains=GAINS)
    gains, desired = task.parameters, task.paths[0].points
    drive = _performed(robot, task, gains.nominal, "")
    calibration = calibrate_betas(drive, seed=seed, trials=calibration_trials, told=told)
    simulator = chasi.simulator(BETAS, 0.0, 0.0, threads=1)

    def tracking(values: Array) -> float:
        driven = on_path(task, _simulated(task, simulator, calibration.best, values))
        return path_loss(desired, driven, spacing=SPACING, band=BAND)

    tuning = _searched("tune", gains, tracking, tuning_trials, seed + 1, told)
    before, after = (as_rollout(task.trials[0], [r]) for r in (drive, _performed(robot, task, tuning.best, ", tuned")))
    default = _simulated(task, simulator, calibration.start, gains.nominal)
    calibrated = _simulated(task, simulator, calibration.best, gains.nominal)
    tuned = _simulated(task, simulator, calibration.best, tuning.best)
    return PaperStudy(
        desired, on_path(task, before), on_path(task, default), on_path(task, calibrated), on_path(task, tuned),
        on_path(task, after), calibration, tuning, np.concatenate([task.score([before]), task.score([after])]),
    )  # fmt: skip


def calibrate_betas(
    drive: Recording, names: tuple[str, ...] = BETAS, *, seed: int = 0, trials: int = CALIBRATION_TRIALS,
    gains: Array | None = None, told: Told | None = None,
) -> Searched:  # fmt: skip
    """Eq. (10): the parameters `names` that make the simulator, with the same gains (3,), drive the recorded path.

    With localisation noise among them (the paper's future work) the loss also compares how restless the measured pose
    is: a path alone hardly shows it.
    """
    task = chasi.task(gains=GAINS)
    noisy = "position_noise" in names
    simulator = chasi.simulator(names, 0.006 if noisy else 0.0, 0.005 if noisy else 0.0, threads=1)
    recorded = as_rollout(task.trials[0], [drive])
    real, unrest = on_path(task, recorded), _unrest(recorded)
    used = task.parameters.nominal if gains is None else gains

    def misfit(values: Array) -> float:
        rollout = _simulated(task, simulator, values, used)
        loss = path_loss(real, on_path(task, rollout), spacing=SPACING, band=BAND)
        return loss * (1.0 + float(np.sum(np.log(_unrest(rollout) / unrest) ** 2))) if noisy else loss

    return _searched("calibrate", simulator.parameters, misfit, trials, seed, told)


def _searched(
    stage: str, space: ParameterSpace, loss: Callable[[Array], float], trials: int, seed: int, told: Told | None
) -> Searched:
    """Optuna's TPE over a space, one trial after the other, from the nominal values."""
    began = time.perf_counter()
    search = OptunaSearch(space.to_unit(space.nominal), seed=seed, trials=trials, labels=space.names)
    tried, losses = [], []
    while not search.done:
        asked = search.ask()
        values = space.from_unit(asked)
        found = np.array([loss(v) for v in values])
        search.tell(asked, found)
        tried += list(values)
        losses += found.tolist()
        if told is not None:
            told(stage, len(losses), trials, float(np.nanmin(losses)))
    best = int(np.nanargmin(losses))
    return Searched(space.names, space.nominal, tried[best], np.array(tried), np.array(losses),
                    time.perf_counter() - began)  # fmt: skip


def _performed(robot: Robot, task: FollowPath, gains: Array, label: str) -> Recording:
    return robot.perform(robot_trials(task, gains, label)[0])[0]


def _simulated(task: FollowPath, simulator: BicycleSimulator, values: Array, gains: Array) -> Rollout:
    return simulator.rollout(task.trials, np.concatenate([values, gains])[None], task.controllers)[0]


def on_path(task: FollowPath, rollout: Rollout) -> Array:
    """(n, 2) where the judged axle was, as far as it was measured."""
    driven = task.driven(rollout)[0]
    return driven[np.isfinite(driven).all(axis=1)]


def _unrest(rollout: Rollout) -> Array:
    """(2,) noise of position (m) and heading (rad) as the measurements show it."""
    time_of = {n: o.time for n, o in rollout.trial.observed.items()}
    found = []
    for name in ("position", "heading"):
        values = rollout.channels[name][0]
        known = np.isfinite(values).all(axis=1)
        found.append(float(np.median(estimate_noise(values[known], time_of[name][known]))))
    return np.maximum(found, 1e-6)
