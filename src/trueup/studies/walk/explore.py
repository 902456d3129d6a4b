# SPDX-License-Identifier: Apache-2.0
"""How the robot is explored: a course walked in the simulator, and what was asked of that walk asked of the robot again.

The robot does not know where it is, so that it cannot walk the course itself (the paper, section 4.3).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.controllers.controller import Controller, Observation
from trueup.controllers.walk_engine.engine import WalkEngine
from trueup.controllers.walk_engine.requests import REQUESTS, requests
from trueup.engines.simulator import Simulator
from trueup.errors import SimulationFailedError
from trueup.studies.walk import scenes
from trueup.tasks.omni_walk import OmniWalk
from trueup.trial import Trial


class _Asked:
    """A Controller that remembers what its walk was asked for."""

    def __init__(self, walk: WalkEngine) -> None:
        self.period, self._walk = walk.period, walk
        self.rows: list[Array] = []

    def reset(self, observation: Observation) -> None:
        """See Controller."""
        self._walk.reset(observation)

    def command(self, observation: Observation) -> Array:
        """See Controller."""
        order = self._walk.command(observation)
        self.rows.append(np.concatenate([[observation.time], self._walk.asked[0]]))
        return order


def exploration(
    simulator: Simulator, values: Array, *, seed: int = 0, share: float = 0.67, stretch: float = 1.0
) -> Trial:
    """A trial for the robot: the requests of the walk (17,) through the course, ahead and turning only; see `OmniWalk`.

    Raises SimulationFailedError where the simulated robot falls before half of the course is done.
    """
    course = scenes.task(OmniWalk, noisy=False, runs=1, seed=seed, share=share, stretch=stretch, sideways=False)
    kept: list[_Asked] = []

    def made(rows: Array) -> Controller:
        kept.append(_Asked(course.make(rows)))  # type: ignore[arg-type]
        return kept[-1]

    (done,) = simulator.rollout(course.trials, np.concatenate([simulator.parameters.nominal, values])[None], made)
    table = np.array(kept[0].rows)
    if 0 in done.ends:
        table = table[table[:, 0] <= done.ends[0].at - 1.0]
        if table[-1, 0] < 0.5 * course.duration:
            raise SimulationFailedError(
                f"the walk falls after {done.ends[0].at:.1f} s of a course of {course.duration:.0f} s in the simulator: "
                "there is nothing to explore with; take a gentler walk or smaller steps"
            )
    (trial,) = course.trials
    return replace(
        trial, name=f"explore {seed}", duration=float(table[-1, 0]), references={REQUESTS: requests(table)}, ends=(),
        observed={n: replace(o, time=o.time[o.time <= table[-1, 0]]) for n, o in trial.observed.items()},
    )  # fmt: skip
