# SPDX-License-Identifier: Apache-2.0
"""How the loss changes along each calibrated parameter, the others held: which of them the data can see at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.discrepancies.path_shape import path_loss
from trueup.engines.vehicle import BicycleSimulator
from trueup.recording import Recording
from trueup.studies.stanley.paper import BAND, SPACING
from trueup.tasks.follow_path import FollowPath
from trueup.tasks.task import as_rollout

FLAT = 1.1
"""A loss below this many times the least one is as good: what lies between cannot be told apart."""


@dataclass(frozen=True, eq=False)
class Profile:
    """The losses along one parameter."""

    name: str
    unit: str
    values: Array
    """(n,) across its range."""
    found: float
    warped: Array
    """(n,) by time warping, joint reading, in m^2: the paper's loss."""
    timed: Array
    """(n,) mean squared distance at the same instants, in m^2."""

    @property
    def open_share(self) -> tuple[float, float]:
        """Shares of the range over which the loss, warped and timed, is as good as at its best."""
        return float(np.mean(self.warped < FLAT * self.warped.min())), float(
            np.mean(self.timed < FLAT * self.timed.min())
        )

    @property
    def verdict(self) -> str:
        """In words."""
        warped, timed = self.open_share
        if warped <= 0.2:
            return "seen"
        if timed <= 0.2:
            return "hidden by the warping: seen where instants are compared"
        return "hardly seen" if min(warped, timed) <= 0.4 else "not seen by this drive"


def profiles(
    task: FollowPath, simulator: BicycleSimulator, found: Array, gains: Array, drive: Recording, points: int = 25
) -> tuple[Profile, ...]:
    """One profile a parameter about the values `found` (n,), for the drive that was made with `gains` (m,)."""
    real = as_rollout(task.trials[0], [drive])
    measured = task.driven(real)[0]
    known = np.isfinite(measured).all(axis=1)
    rows = []
    for k, p in enumerate(simulator.parameters.parameters):
        unit = np.repeat(simulator.parameters.to_unit(found)[None], points, axis=0)
        unit[:, k] = np.linspace(0.0, 1.0, points)
        values = simulator.parameters.from_unit(unit)
        tried = np.concatenate([values, np.tile(gains, (points, 1))], axis=1)
        driven = task.driven(simulator.rollout(task.trials[:1], tried, task.controllers)[0])
        warped = [path_loss(measured[known], d, spacing=SPACING, band=BAND) for d in driven]
        timed = np.mean(np.sum((driven[:, known] - measured[known]) ** 2, axis=2), axis=1)
        rows.append(Profile(p.name, p.unit, values[:, k], float(found[k]), np.array(warped), timed))
    return tuple(rows)
