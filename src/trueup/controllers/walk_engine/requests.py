# SPDX-License-Identifier: Apache-2.0
"""Where a walk is to go: toward a trial's targets one after the other, or as it was asked in another run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from trueup.arrays import Array
from trueup.articulated.pose import yaw_of
from trueup.controllers.controller import Observation
from trueup.errors import TrialError
from trueup.rounding import SAME_INSTANT
from trueup.samples import wrapped
from trueup.trial import Reference

TARGETS, REQUESTS = "targets", "requests"
"""Names of a trial's references that a walk follows."""


class Requests(Protocol):
    """Says where b robots are to walk."""

    def __call__(self, observation: Observation) -> Array:
        """(b, 3) forward, left and turning left, each as a share of the largest step, -1 ... 1."""
        ...


def targets(rows: Array) -> Reference:
    """Targets (k, 5): from which time on (s), x and y (m, NaN to step on the spot), with which share of the largest step
    (at most 1), and whether (1 or 0) also sideways and backward; else the robot turns to its target and walks ahead.
    """
    return Reference(
        ("time", "x", "y", "share", "sideways"), ("s", "m", "m", "1", "1"), np.asarray(rows, dtype=np.float64)
    )


def requests(rows: Array) -> Reference:
    """Requests (k, 4): from which time on (s), and shares of the largest step forward, left and turning left."""
    return Reference(("time", "forward", "left", "turn"), ("s", "1", "1", "1"), np.asarray(rows, dtype=np.float64))


@dataclass(frozen=True)
class OfTrial:
    """What the observation's trial says: its `requests`, whatever the robot does, or toward its present one of `targets`.

    The base's pose is seven numbers of `Observation.position` from `base` on.
    """

    full_turn: float = 0.6
    """rad aside of which a target is turned to with full effort."""
    near: float = 0.2
    """m from the target within which steps become shorter."""
    base: int = 0

    def __call__(self, observation: Observation) -> Array:
        """See Requests. Raises TrialError where the trial has neither reference."""
        trial = observation.trial
        references = trial.references if trial is not None else {}
        if REQUESTS in references:
            return np.repeat(_present(references[REQUESTS], observation)[None], len(observation.position), axis=0)
        if TARGETS not in references:
            raise TrialError(
                f"trial '{trial.name if trial is not None else ''}' does not say where to walk: it needs a reference "
                f"'{TARGETS}' or '{REQUESTS}'; it has: {', '.join(references) or 'none'}"
            )
        return self._toward(_present(references[TARGETS], observation), observation.position)

    def _toward(self, target: Array, position: Array) -> Array:
        x, y = position[:, self.base : self.base + 2].T
        if np.isnan(target[:2]).any():
            return np.zeros((len(x), 3))
        yaw = yaw_of(position[:, self.base + 3 : self.base + 7])
        dx, dy = target[0] - x, target[1] - y
        aside = wrapped(np.arctan2(dy, dx) - yaw)
        share = target[2] * np.minimum(np.hypot(dx, dy) / self.near, 1.0)
        anyhow = target[3] > 0.0
        ahead = np.cos(aside) if anyhow else np.maximum(np.cos(aside), 0.0)
        left = np.sin(aside) if anyhow else np.zeros_like(aside)
        return share[:, None] * np.stack([ahead, left, np.clip(aside / self.full_turn, -1.0, 1.0)], axis=1)


def _present(reference: Reference, observation: Observation) -> Array:
    """(k,) the row that holds now, without its time."""
    row = int(np.searchsorted(reference.values[:, 0], observation.time + SAME_INSTANT, side="right")) - 1
    return reference.values[max(row, 0), 1:]
