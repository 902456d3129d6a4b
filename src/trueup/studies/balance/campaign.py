# SPDX-License-Identifier: Apache-2.0
"""One transition on one stand-in: try the motion, calibrate on what the robot did, search again, at most so many rounds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from trueup.arrays import Array
from trueup.inspection.repeats import bridged
from trueup.loop.surest import Effort, Surest
from trueup.recording import Recording
from trueup.robots.robot import Robot
from trueup.studies.balance.calibration import Runs, calibrated, simulator_of
from trueup.studies.balance.robot import led
from trueup.studies.balance.searching import searched
from trueup.tasks.task import as_rollout
from trueup.tasks.transitions import Transition

Told = Callable[[str], None]
Kept = Callable[[str, Callable[[], Any]], Any]
"""From a name, and what makes it, to what it is: anything that JSON holds."""

REPEATS = 3
"""Runs of a motion, as the paper has them. A motion works where most of them end as wanted."""


def most(stood: Sequence[bool]) -> bool:
    """Whether most repeats ended as wanted."""
    return 2 * sum(stood) > len(stood)


@dataclass(frozen=True, eq=False)
class Round:
    """A motion on the robot, and what the simulator made of it."""

    motion: Array
    recordings: tuple[Recording, ...]
    stood: tuple[bool, ...]
    expected: float
    """Share of the simulator's models in which it stood."""
    values: Array
    """(n,) of the simulator's parameters with which it was found."""
    errors: tuple[float, float]
    """rad from the torso as recorded to the simulated one: by the model file, and with `values`, which never saw them."""

    @property
    def succeeded(self) -> bool:
        """Whether most repeats did."""
        return most(self.stood)

    @property
    def seconds(self) -> float:
        """Of the robot's time: each motion until it had to stand still, or fell."""
        return float(sum(max(0.0, float(r.channel("base_position").time[-1])) for r in self.recordings))


@dataclass(frozen=True)
class Scale:
    """How much is done in each round."""

    rounds: int = 2
    repeats: int = REPEATS
    generations: int = 10
    """Of CMA-ES in the calibration, of 32."""
    effort: Effort = field(default_factory=Effort)
    parameters: str = "wider"


def performed(
    robot: Robot, task: Transition, motion: Array, name: str, repeats: int = REPEATS
) -> tuple[tuple[Recording, ...], tuple[bool, ...]]:
    """What the robot does with a motion (m,), and which of the repeats end as wanted.

    Raises RecordingError where the motion capture lost it for too long.
    """
    recordings = robot.perform(led(replace(task.watched(motion), name=name, repeats=repeats)))
    seen = [bridged(r) for r in recordings]
    done = as_rollout(task.trials[0], [r.slice(0.0, r.stop) for r in seen], motion)
    return tuple(recordings), tuple(bool(x) for x in task.succeeded([done]))


def campaign(
    scene: str, robot: Robot, task: Transition, first: Array, *, seed: int, scale: Scale | None = None,
    told: Told = lambda line: None, kept: Kept = lambda name, make: make(),
) -> tuple[Round, ...]:  # fmt: skip
    """Rounds until a motion works on the robot, the first with motion `first` (m,) of the model file as it is.

    `kept` gives what was made under a name before, in place of making it again.
    """
    given = scale or Scale()
    simulator = simulator_of(scene, given.parameters)
    values, motion, expected, rounds = simulator.parameters.nominal, first, 1.0, []
    for number in range(given.rounds + 1):
        recordings, stood = performed(robot, task, motion, f"{scene}-{number}", given.repeats)
        runs = Runs(scene, recordings, task.trials[0].ends)
        rounds.append(Round(motion, recordings, stood, expected, values, runs.errors(values, given.parameters)))
        told(f"{scene}, round {number}: {sum(stood)} of {len(stood)} repeats stood")
        if rounds[-1].succeeded or number == given.rounds:
            break
        known = [Runs(scene, r.recordings, task.trials[0].ends) for r in rounds]
        later = kept(f"round {number + 1}", partial(_designed, scene, known, motion, given, [seed, number]))
        values, motion, expected = np.array(later["values"]), np.array(later["motion"]), later["share"]
    return tuple(rounds)


def _designed(
    scene: str, known: Sequence[Runs], motion: Array, scale: Scale, seeds: Sequence[int]
) -> dict[str, list[float] | float]:
    """The likeliest model after `known` runs, and the motion that succeeds in the largest share of all that are possible."""
    rng = np.random.default_rng(seeds)
    seed = int(rng.integers(2**31))
    models = calibrated(
        known, scale.parameters, seed=seed, generations=scale.generations, members=scale.effort.models
    ).values

    def search(begin: Array | None) -> Surest:
        return searched(scene, models, rng, begin=begin, effort=scale.effort, parameters=scale.parameters)

    found = search(motion)
    if found.share < 0.5:  # not from there: from the scene's own seeds
        found = max(found, search(None), key=lambda f: f.share)
    return {"values": models[0].tolist(), "motion": found.values.tolist(), "share": found.share}
