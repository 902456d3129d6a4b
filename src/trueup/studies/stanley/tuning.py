# SPDX-License-Identifier: Apache-2.0
"""The loop in rounds, without a campaign: calibrate on all drives so far, tune under doubt, try several on the robot."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.calibration import Calibration
from trueup.campaign.kinds import drives as calibrate_drives
from trueup.engines.simulator import Simulator
from trueup.loop.belief import Belief
from trueup.loop.optimize import TrustRegion, optimize
from trueup.loop.plausible import plausible
from trueup.loop.ranking import Agreement
from trueup.loop.transfer import Tested, best_known, compared, mean_score, shortlist, try_on_robot
from trueup.recording import Recording
from trueup.robots.robot import Robot
from trueup.search.cma_es import CmaEs
from trueup.search.search import Search
from trueup.tasks.task import Task

Array = NDArray[np.float64]

RISK = 0.3
"""Deviations between samples that count against a candidate: little, since the robot itself tries what comes out."""
_CONFIRMED = 3  # runs at most to make sure that the best was not merely lucky


@dataclass(frozen=True, eq=False)
class Round:
    """One round: what was calibrated, what was tried on the robot, and how well the simulator had foreseen it."""

    calibration: Calibration
    models: Array
    """(p, n) samples of the simulator's parameters that candidates were judged with."""
    candidates: Array
    """(c, m) in the parameters' units; the first is the best so far, run again."""
    predicted: Array
    measured: Array
    """(c,) scores in the simulator and on the robot."""
    agreement: Agreement
    best: Array
    """(m,) the best that the robot has shown after this round."""
    score: float


@dataclass(frozen=True, eq=False)
class Tuned:
    """The outcome of `tune`."""

    start: Tested
    """The robot with today's gains."""
    rounds: tuple[Round, ...]
    best: Array
    """(m,) the best gains that the robot has shown, in more than one run."""
    score: float
    """Their mean score on the robot."""
    runs: int
    """On the robot, in all."""


def tune(
    robot: Robot, task: Task, simulator: Simulator, *, rounds: int = 2, candidates: int = 3, evaluations: int = 160,
    samples: int = 8, seed: int = 0, search: Callable[[Array, int], Search] | None = None,
    say: Callable[[str], None] | None = None, start: Tested | None = None,
) -> Tuned:  # fmt: skip
    """Tunes the task's parameters for a robot, from today's; each round makes one calibration and `candidates` + 1 runs.

    Nothing is lost by it: the best that the robot itself has shown is kept, today's gains among them, and it is run again
    before it is believed. `start`: the run with today's gains, if it was made already.
    """
    tell = say or (lambda line: None)
    make = search or (lambda at, number: CmaEs(at, seed=number, max_evaluations=evaluations))
    space = task.parameters
    region = TrustRegion(np.clip(space.to_unit(space.nominal), 0.0, 1.0), 1.0)
    first = start or try_on_robot(robot, task, space.nominal)
    units, scores, drives = [region.centre], [first.scores], list(_recordings([first]))
    done: list[Round] = []
    for number in range(rounds):
        calibration = calibrate_drives(drives, simulator)
        belief = Belief.of(calibration, simulator.parameters)
        models = belief.sample(4 * samples, np.random.default_rng([seed, number]))
        so_far = np.array([mean_score(s) for s in scores])
        models = plausible(task, simulator, models, space.from_unit(np.array(units)), so_far, samples)
        found = make(region.inside(region.centre), seed + number)
        optimum = optimize(task, simulator, models, found, region, risk=RISK)
        chosen = shortlist(optimum, region, candidates, task=task, simulator=simulator, models=models, apart=0.15)
        tested = [
            try_on_robot(robot, task, space.from_unit(u), label=f", round {number + 1}, candidate {k}")
            for k, u in enumerate(chosen.unit)
        ]
        units += list(chosen.unit)
        scores += [t.scores for t in tested]
        drives += _recordings(tested)
        best, score = best_known(units, scores)
        measured = np.array([t.score for t in tested])
        rank = compared(chosen.predicted, measured).agreement
        done.append(Round(calibration, models, space.from_unit(chosen.unit), chosen.predicted, measured, rank,
                          space.from_unit(best), score))  # fmt: skip
        region = dataclasses.replace(region, centre=best)
        tell(f"round {number + 1}: {1e3 * first.score:.1f} -> {1e3 * score:.1f} mm on the robot")
    best, score = _confirmed(robot, task, units, scores)
    return Tuned(first, tuple(done), space.from_unit(best), score, len(units))


def _confirmed(robot: Robot, task: Task, units: list[Array], scores: list[Array]) -> tuple[Array, float]:
    """The best in the unit box and its score, run again if it was run but once; the lists grow by these runs."""
    for k in range(_CONFIRMED):
        best, _ = best_known(units, scores)
        if sum(np.array_equal(u, best) for u in units) > 1:
            break
        again = try_on_robot(robot, task, task.parameters.from_unit(best), label=f", confirmed {k + 1}")
        units.append(best)
        scores.append(again.scores)
    return best_known(units, scores)


def _recordings(tested: Sequence[Tested]) -> list[Recording]:
    return [r for t in tested for runs in t.recordings for r in runs]
