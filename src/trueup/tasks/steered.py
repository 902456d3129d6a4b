# SPDX-License-Identifier: Apache-2.0
"""Was a run steered by the law, with the settings that were asked for?"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trueup.arrays import Array
from trueup.controllers.controller import Controller, Observation
from trueup.engines.simulator import Rollout
from trueup.instant import STILL
from trueup.samples import rms

UNLIKE = 0.3
"""Share of what the law commands, from which what was commanded instead is said to be another's, and of the distance from
one law, below which another explains it. Of three made-up robots the first was 0.2 at most where the pose is late and a
`lead` acts on a turn rate that is only seen in the heading.
"""


def steered_otherwise(
    rollout: Rollout, path: str, today: Array, controllers: Callable[[Array], Controller]
) -> list[str]:
    """A sentence for each run along a path, by its name, whose steering is not what the law commands along it, where its
    settings are known; `today` (m,) are those that the robot came with.

    Each sample is compared with the law at the pose that was logged then. What only noise and late poses do to it
    averages out over a stretch of road; another law, other gains or another run's log do not.
    """
    found = []
    for row, settings in enumerate([] if rollout.settings is None else rollout.settings):
        (own, spread), (other, _) = _apart(rollout, row, controllers(np.stack([settings, today])))
        if own > STILL and other < UNLIKE * own:
            found.append(
                f"what was steered along path '{path}' is what the law commands with the settings of today, to "
                f"{other:.2g} rad, and {own:.2g} rad from what it commands with those of this run: were they set? "
                "`trueup resume --retract` asks for the run again"
            )
        elif own > max(UNLIKE * spread, STILL):
            found.append(
                f"what was steered along path '{path}' is {own:.2g} rad from what the law commands with these "
                f"settings where the log says the robot was (it commands {spread:.2g} rad; both root mean square): were "
                "these settings in force, is this the log of this run, and is the robot's law that of docs/vehicles.md? "
                "`trueup resume --retract` takes a wrong log back"
            )
    return found


def _apart(rollout: Rollout, row: int, law: Controller) -> list[tuple[float, float]]:
    """For each of two copies of the law: by how much the steering of a run differs from its, and how much it steers, in rad,
    over means of seconds.
    """
    names = ("position", "heading", "speed", "command")
    known = np.isfinite(np.concatenate([rollout.channels[n][row] for n in names], axis=1)).all(axis=1)
    time = rollout.trial.observed["position"].time[known]
    position, heading, speed, command = (rollout.channels[n][row][known] for n in names)
    if len(time) < 3:
        return [(0.0, 0.0)] * 2
    turn = np.gradient(np.unwrap(heading[:, 0]), time)
    pose, velocity = np.hstack([position, heading]), np.column_stack([speed[:, 0], turn])
    seen = [
        Observation(t, np.stack([p, p]), np.stack([v, v]), {}, rollout.trial)
        for t, p, v in zip(time, pose, velocity, strict=True)
    ]
    law.reset(seen[0])
    found = []
    for lawful in np.swapaxes([law.command(o) for o in seen], 0, 1):
        driving = (lawful[:, 0] > 0.0) & (command[:, 0] != 0.0)  # neither is beyond the path's end
        second = np.floor(time - time[0]).astype(int)[driving]
        count = np.maximum(np.bincount(second), 1)
        own, done = (np.bincount(second, of[driving, 1]) / count for of in (lawful, command))
        found.append((float(rms(done - own)), float(rms(own))) if len(own) else (0.0, 0.0))
    return found
