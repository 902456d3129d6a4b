# SPDX-License-Identifier: Apache-2.0
"""Simulators that fall where the robot falls: several, each fitted to other runs of the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import Simulator
from trueup.recording import Recording
from trueup.search.cma_es import CmaEs
from trueup.studies.walk import scenes
from trueup.studies.walk.methods import WALKED, legs
from trueup.studies.walk.search import Scene
from trueup.studies.walk.study import FALL, Story
from trueup.tasks.sway import passing
from trueup.tasks.walking import WalkFront
from trueup.trial import Trial

JOINTS, TORSO = "position", "base_orientation"
_ANYHOW = 0.01  # share of runs that fall, or stand, whatever a simulator says


@dataclass(frozen=True)
class Fitted:
    """Noisy simulators with motors, carpet and torso (`scenes.DOUBTS`) as the robot's runs leave them, which is not one way.

    Each of some members is fitted by CMA-ES to runs drawn anew from all that the robot has walked (bagging: L. Breiman,
    Machine Learning 24, 1996), replayed from their start by the commands that were given, so that members differ in
    what runs do not tell; a walk must stand in all of them. Sway counts as the falls that it makes likely.
    """

    members: int = 6
    drawn: int = 2
    """Runs that each is fitted to."""
    replayed: float = 3.5
    """s of each run."""
    population: int = 24
    generations: int = 8
    seconds: float = 6.0
    """Of a simulated walk."""
    fall: float = FALL
    threads: int | None = None
    name: str = "noisy simulators fitted to the robot's runs"

    def prepared(self, story: Story, seed: int) -> Scene:
        """See Method."""
        simulator, rng = scenes.doubtful(threads=self.threads), np.random.default_rng([seed, self.members])
        walked = [legs(r, torso=True) for t in story.tried for r in t.runs.recordings if r.duration > WALKED]
        begun = [r.slice(r.start, min(r.start + self.replayed, r.stop)) for r in walked]
        models = [
            self.fitted(
                simulator, [begun[k] for k in rng.integers(len(begun), size=self.drawn)], int(rng.integers(2**31))
            )
            for _ in range(self.members)
        ]
        walk = scenes.task(
            WalkFront, runs=1, seconds=self.seconds, fall=self.fall, seed=seed, tips=scenes.TIPS, alike=True
        )
        tips = np.array(scenes.TIPS) / self.unsteadier(simulator, walk, np.array(models), story)
        return Scene(simulator, replace(walk, tips=tuple(tips.tolist())), np.array(models))

    def unsteadier(self, simulator: Simulator, walk: WalkFront, models: Array, story: Story) -> float:
        """How many times the sway of the simulators makes their falls as likely as the robot's, all that it walked counted.

        Between a third and three times, mostly from a half to twice (a normal prior on the logarithm), and the robot's
        pushes and carpet let any walk fall in one of a hundred runs.
        """
        values = np.array([t.values for t in story.tried])
        rows = np.hstack([np.repeat(models, len(values), axis=0), np.tile(values, (len(models), 1))])
        again = replace(walk, runs=2, seed=walk.seed + 500)
        done = simulator.rollout(again.trials, rows, again.controllers)
        shares = np.concatenate([again.swayed(r, scenes.TIPS).reshape(len(models), -1) for r in done])  # (2 p, r)
        failed, runs = np.array([(t.runs.failed, t.runs.number) for t in story.tried]).T
        factors = np.exp(np.linspace(-np.log(3.0), np.log(3.0), 45))
        chances = _ANYHOW + (1.0 - 2.0 * _ANYHOW) * passing(factors[:, None, None] ** 2 * shares).mean(axis=1)
        fits = failed * np.log(chances) + (runs - failed) * np.log1p(-chances)
        return float(factors[np.argmax(fits.sum(axis=1) - 0.5 * (np.log(factors) / np.log(2.0)) ** 2)])

    def fitted(self, simulator: Simulator, runs: Sequence[Recording], seed: int) -> Array:
        """(n,) of the simulator's parameters, with which it replays runs best: joints and torso count alike.

        The logarithms of both errors are added, as in the likelihood of either with a noise that nobody knows.
        """
        space = simulator.parameters
        search = CmaEs(np.full(len(space), 0.5), seed=seed, sigma=0.25, population=self.population, restarts=0,
                       max_evaluations=self.population * self.generations)  # fmt: skip
        while not search.done:
            asked = search.ask()
            errors = replay_errors(simulator, runs, space.from_unit(np.clip(asked, 0.0, 1.0)))
            search.tell(asked, np.nan_to_num(np.log(errors).mean(axis=0).sum(axis=1), nan=np.inf))
        return space.from_unit(np.clip(search.best[0], 0.0, 1.0))


def replay_errors(simulator: Simulator, runs: Sequence[Recording], values: Array) -> Array:
    """(r, b, 2) rad, root mean squares over r runs: joints, and the torso's roll and pitch, with parameters (b, n)."""
    trials = [replace(Trial.of(run, [JOINTS, TORSO]), ends=()) for run in runs]
    found = []
    for run, rollout in zip(runs, simulator.rollout(trials, values), strict=True):
        each = []
        for name, columns in ((JOINTS, slice(None)), (TORSO, slice(2))):
            channel, time = run.channel(name), rollout.trial.observed[name].time
            wrong = rollout.channels[name][:, :, columns] - channel.at(time)[:, columns]
            each.append(np.sqrt(np.mean(np.square(wrong), axis=(1, 2))))
        found.append(np.stack(each, axis=1))
    return np.array(found)
