# SPDX-License-Identifier: Apache-2.0
"""Film strips of walks on the robot: one cycle each, side by side in time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from trueup.arrays import Array
from trueup.controllers.walk_engine.engine import PARAMETERS
from trueup.engines.mujoco.filming import pictures
from trueup.report.film_strip import film_strip
from trueup.studies.walk import scenes
from trueup.studies.walk.robot import StandInNao
from trueup.tasks.task import robot_trials
from trueup.tasks.walking import WalkFront

_BEGUN = 3.0  # s: steps have grown to their full length


def strip(robot: StandInNao, walks: Mapping[str, tuple[Array, float]], out: Path, *, shown: int = 8) -> Path:
    """Writes an SVG of walks by name, each its values (17,) and its share of the largest step, over a cycle of the first.

    Raises RenderingError where the machine has no off-screen graphics.
    """
    first = next(iter(walks.values()))[0]
    time = _BEGUN + np.linspace(0.0, float(first[PARAMETERS.index("stepPeriod")]), shown)
    rows = {}
    for name, (values, share) in walks.items():
        walk = scenes.task(WalkFront, runs=1, seconds=float(time[-1]) + 0.2, share=share)
        (run,) = robot.perform(robot_trials(walk, values, f" filmed {name}")[0])
        rows[name] = pictures(robot.model, run, time.tolist(), width=160, height=200, distance=0.9, azimuth=110.0)
    out.write_text(film_strip(rows, time.tolist(), "One cycle of each walk on the robot"), encoding="utf-8")
    return out
