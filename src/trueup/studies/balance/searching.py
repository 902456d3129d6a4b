# SPDX-License-Identifier: Apache-2.0
"""Searches a transition's motion in a simulator of the humanoid that is not quite known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.loop.settle import settled
from trueup.loop.surest import DOUBT, Effort, Surest, surest
from trueup.studies.balance.calibration import STEP, simulator_of
from trueup.studies.balance.scenes import SCENES, transition
from trueup.tasks.transitions import Transition

RANDOM = 4.0 * DOUBT
"""What a model file does not know, as a share of each parameter's box."""


def task_of(scene: str, simulator: MujocoSimulator, values: Array) -> Transition:
    """The transition, begun as this robot rests with values (n,) of the simulator's parameters."""
    _, task = transition(scene, step=STEP)
    given, own = SCENES[scene], simulator.with_parameters(simulator.parameters.with_nominal(values))
    heights = np.linspace(*given.heights, 25).tolist()
    start = settled(own, task.motion.joints, task.motion.first, heights, pitch=given.pitch, name=scene)
    return replace(task, start=start)


def searched(
    scene: str, models: Array, rng: np.random.Generator, *, doubt: float = DOUBT, begin: Array | None = None,
    effort: Effort | None = None, parameters: str = "wider", untried: bool = False,
) -> Surest:  # fmt: skip
    """The surest motion in models (k, n), the likeliest first, from motion `begin` (m,) or from the scene's seeds."""
    simulator = simulator_of(scene, parameters)
    task = task_of(scene, simulator, models[0])
    return surest(task, simulator, models, rng, doubt=doubt, begin=begin, effort=effort, untried=untried)
