# SPDX-License-Identifier: Apache-2.0
"""Whether a robot that was to move did so at all: of one that stood nothing can be judged or calibrated."""

from __future__ import annotations

import numpy as np

from trueup.instant import HARDLY
from trueup.recording import Recording
from trueup.tracking.windows import moves
from trueup.trial import Trial

_PLACE = ("x", "y")


def standing(trial: Trial, recording: Recording) -> str:
    """That the robot stayed where it was, on a path that leads away from there or with all joints that were commanded to
    move, in words; '' where it did not.

    A recording that shows no place of a path, and no joint that is commanded, says nothing about that.
    """
    return _held(trial, recording) or _off_its_path(trial, recording)


def _held(trial: Trial, recording: Recording) -> str:
    command, position = trial.command, recording.channels.get("position")
    if command is None or position is None or command.unit != position.unit:
        return ""
    spans = {c.name: np.fmax.reduce(c.values) - np.fmin.reduce(c.values) for c in (command, position)}
    asked, moved = (dict(zip(c.labels, spans[c.name].tolist(), strict=True)) for c in (command, position))
    told = [label for label in command.labels if label in moved and asked[label] > 0.0]
    if not told or not all(moved[label] < HARDLY * asked[label] for label in told):
        return ""
    most = max(told, key=lambda label: asked[label])
    return (
        f"no joint moved: '{most}' stays within {moved[most]:.2g} {position.unit}, where its command ranges over "
        f"{asked[most]:.3g} {position.unit}"
    )


def _off_its_path(trial: Trial, recording: Recording) -> str:
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
