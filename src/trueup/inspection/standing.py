# SPDX-License-Identifier: Apache-2.0
"""Whether a robot that was to follow a path went anywhere: of one that stood nothing can be judged or calibrated."""

from __future__ import annotations

import numpy as np

from trueup.recording import Recording
from trueup.tracking.windows import moves
from trueup.trial import Trial

_PLACE = ("x", "y")


def standing(trial: Trial, recording: Recording) -> str:
    """That the robot stayed where it was on a path that leads away from there, in words; '' where it did not.

    A recording that shows no place, and a trial that follows no path, say nothing about that.
    """
    path = trial.references.get("path")
    if path is None or not set(_PLACE) <= set(path.labels) or not recording.has("position"):
        return ""
    position = recording.channel("position")
    if not set(_PLACE) <= set(position.labels):
        return ""
    wanted = path.values[:, [path.labels.index(label) for label in _PLACE]]
    driven = position.select(_PLACE).values
    if not np.isfinite(driven).all(axis=1).any() or moves(driven) or not moves(wanted):
        return ""
    extent, asked = (float(np.linalg.norm(np.nanmax(p, axis=0) - np.nanmin(p, axis=0))) for p in (driven, wanted))
    return f"the robot stood all along: its position stays within {extent:.2g} m, where the path extends over {asked:.3g} m"
