# SPDX-License-Identifier: Apache-2.0
"""A robot that walks by a formula, for plans of the tests: it falls forward or backward the more, the bolder it walks."""

from __future__ import annotations

import zlib

import numpy as np

from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.ends import Ended, with_end
from trueup.errors import RobotFellError
from trueup.recording import Channel, Recording
from trueup.tasks.paces import features
from trueup.trial import Trial
from trueup.watched_run import WatchedRun

_RISKS = np.array([[-4.0, 10.0, -1.2, 0.0, 0.0], [-4.0, 10.0, 1.2, 0.0, 0.0]])


class Walker:
    """A Robot that is safest where its feet are `best` m further ahead; `silent`: of a fall it says nothing else; `watched`:
    its runs are not logged, but people see how they end and take the time.
    """

    repeatable = True

    def __init__(self, best: float = 0.006, silent: bool = False, watched: bool = False) -> None:
        self._best, self._silent, self._watched = best, silent, watched

    def perform(self, trial: Trial) -> list[Recording]:
        rng, s = np.random.default_rng(zlib.crc32(trial.name.encode())), trial.settings
        steps = s["amp_swing"] / PARAMETERS["amp_swing"].nominal
        lean = (
            s["fwdOffset"] / 1.0848 - PARAMETERS["fwdOffset"].nominal - self._best
        ) / 0.006  # SimSpark's legs are longer
        odds = np.exp(features(np.array([[steps, lean]]))[0] @ _RISKS.T)[0]
        return [self._run(trial, 0.12 * steps ** (4.0 / 3.0), odds, rng) for _ in range(trial.repeats)]

    def _run(self, trial: Trial, speed: float, odds: np.ndarray, rng: np.random.Generator) -> Recording:
        fate = int(rng.choice(3, p=[*odds, 1.0] / (1.0 + odds.sum())))
        if fate < 2 and self._silent:
            raise RobotFellError("it lies")
        far = 2.38 if fate == 2 else 1.0
        if self._watched:
            told = WatchedRun((far / speed,)) if fate == 2 else WatchedRun(fell=("forward", "backward")[fate])
            return told.recording(trial)
        time = np.linspace(0.0, far / speed, 60)
        place = np.stack([speed * time * 1.0001, 0.0 * time, 0.0 * time + 0.36], axis=1)
        angles = np.stack([0.0 * time, np.where(time == time[-1], (0.8, -0.8, 0.0)[fate], 0.0), 0.0 * time], axis=1)
        run = Recording(trial.name, {
            "base_position": Channel("base_position", ("x", "y", "z"), "m", time, place),
            "base_orientation": Channel("base_orientation", ("roll", "pitch", "yaw"), "rad", time, angles),
        })  # fmt: skip
        return with_end(run, Ended(float(time[-1]), "at the line" if fate == 2 else "fallen"))
