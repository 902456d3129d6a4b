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
        iterations = (
            3  # the rotation enters almost linearly: start headings are measured to a few hundredths of a radian
        )
        trial = simulated.trial
        if "position" not in simulated.channels or trial.observed["position"].labels != ("x", "y"):
            return self._weighted.residual(real, simulated)
        measured = {n: measured_at(real, n, o.labels, o.time) for n, o in trial.observed.items()}
        moved = dict(simulated.channels)
        moved["position"] = np.array(moved["position"])
        if "heading" in moved:
            moved["heading"] = np.array(moved["heading"])
        for _ in range(iterations):
            self._turn(moved, measured)
        return self._weighted.residual(real, replace(simulated, channels=moved))

    def _turn(self, moved: dict[str, Array], measured: dict[str, Array]) -> None:
        """One Gauss-Newton step of turn and shift, in place, all rows at once."""
        seen = np.isfinite(measured["position"]).all(axis=1)
        good = slice(None) if seen.all() else seen  # no copies where nothing is missing
        weight = 1.0 / float(np.mean(self.scale("position", ("x", "y")))) ** 2
        points = moved["position"]
        centre, shift = points[:, :1], np.zeros((1, 1, 2))
        if seen.any():  # else nobody saw where it was, and nothing says how far to shift it
            centre = points[:, good].mean(axis=1, keepdims=True)
            shift = (measured["position"][good][None] - points[:, good]).mean(axis=1, keepdims=True)
        arms = points[:, good] - centre
        gap = measured["position"][good][None] - points[:, good] - shift
        above = weight * np.sum(arms[:, :, 0] * gap[:, :, 1] - arms[:, :, 1] * gap[:, :, 0], axis=1)
        below = weight * np.sum(arms**2, axis=(1, 2)) + ROUNDED
        if "heading" in moved:
            known = np.isfinite(measured["heading"][:, 0])
            each = 1.0 / float(self.scale("heading", ("heading",))[0]) ** 2
            above += each * np.sum(measured["heading"][known, 0][None] - moved["heading"][:, known, 0], axis=1)
            below += each * known.sum()
        turn = above / below
        cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
        x, y = (points - centre)[:, :, 0], (points - centre)[:, :, 1]
        points[:] = np.stack([cos * x - sin * y, sin * x + cos * y], axis=2) + centre + shift
        if "heading" in moved:
            moved["heading"][:, :, 0] += turn[:, None]
