# SPDX-License-Identifier: Apache-2.0
"""Residuals of a planar motion whose start pose is not known better than it was measured: it is fitted beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.discrepancies.discrepancy import measured_at
from trueup.discrepancies.weighted import Weighted
from trueup.engines.simulator import Rollout
from trueup.recording import Recording
from trueup.rounding import ROUNDED


class RigidlyAligned:
    """As Weighted, after the simulated motion was turned and shifted so that it fits best (x, y in m, heading in rad).

    A vehicle moves the same wherever it starts, so an error of the start pose turns and shifts all that follows. Fitting
    these three numbers for each recording keeps the noise of one pose out of the parameters; what is left is shape.
    Other channels than 'position' (x, y) and 'heading' are compared as they are.
    """

    def __init__(self, weighted: Weighted) -> None:
        self._weighted = weighted

    @classmethod
    def estimated(cls, recordings: Sequence[Recording], channels: Sequence[str]) -> RigidlyAligned:
        """With noise estimated from the recordings."""
        return cls(Weighted.estimated(recordings, channels))

    def scale(self, channel: str, labels: tuple[str, ...]) -> Array:
        """(k,) see Discrepancy."""
        return self._weighted.scale(channel, labels)

    def residual(self, real: Recording, simulated: Rollout) -> Array:
        """See Discrepancy."""
        trial = simulated.trial
        if "position" not in simulated.channels or trial.observed["position"].labels != ("x", "y"):
            return self._weighted.residual(real, simulated)
        measured = {n: measured_at(real, n, o.labels, o.time) for n, o in trial.observed.items()}
        return self._weighted.residual(real, replace(simulated, channels=self._aligned(simulated, measured)))

    def _aligned(self, simulated: Rollout, measured: dict[str, Array]) -> dict[str, Array]:
        """The channels, turned about the mean of where positions were measured and shifted to it, all rows at once: by
        Gauss-Newton steps, whose sums over samples turn as the motion does.
        """
        iterations = (
            3  # the rotation enters almost linearly: start headings are measured to a few hundredths of a radian
        )
        points, place = simulated.channels["position"], measured["position"]
        seen = np.isfinite(place).all(axis=1)
        good = slice(None) if seen.all() else seen  # no copies where nothing is missing
        weight = 1.0 / float(np.mean(self.scale("position", ("x", "y")))) ** 2
        # Where nobody saw where it was, nothing says how far to shift it.
        centre = points[:, good].mean(axis=1, keepdims=True) if seen.any() else points[:, :1]
        there = place[good].mean(axis=0) if seen.any() else points[:, :1]
        arms = points - centre
        x, y = arms[:, :, 0], arms[:, :, 1]
        ahead, aside = (place[good] - there).T if seen.any() else np.zeros((2, 0))
        along, across = x[:, good] @ ahead + y[:, good] @ aside, x[:, good] @ aside - y[:, good] @ ahead
        below = weight * np.sum(arms[:, good] ** 2, axis=(1, 2)) + ROUNDED
        late, known, each = np.zeros(len(points)), np.zeros(0, dtype=bool), 0.0
        if "heading" in simulated.channels:
            known = np.isfinite(measured["heading"][:, 0])
            each = 1.0 / float(self.scale("heading", ("heading",))[0]) ** 2
            late = np.sum(measured["heading"][known, 0] - simulated.channels["heading"][:, known, 0], axis=1)
        turn = np.zeros(len(points))
        for _ in range(iterations):
            pull = weight * (np.cos(turn) * across - np.sin(turn) * along) + each * (late - known.sum() * turn)
            turn += pull / (below + each * known.sum())
        cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
        moved = {**simulated.channels, "position": np.stack([cos * x - sin * y, sin * x + cos * y], axis=2) + there}
        if "heading" in moved:
            moved["heading"] = moved["heading"] + turn[:, None, None]
        return moved
