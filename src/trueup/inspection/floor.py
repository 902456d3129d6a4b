# SPDX-License-Identifier: Apache-2.0
"""Whether recordings show a floor or table that the model lacks: the robot stopped above where it was told to go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from trueup.arrays import Array, Mask
from trueup.inspection.diagnosis import Diagnosis
from trueup.recording import Recording
from trueup.trial import command_of, shared_joints


class Heights(Protocol):
    """How low a robot reaches, as its engine knows it."""

    @property
    def joints(self) -> Sequence[str]:
        """Those that positions may be given of."""
        ...

    def lowest(self, labels: Sequence[str], poses: Array) -> Array:
        """(T,) height in m of the robot's lowest point at positions (T, k) of these joints."""
        ...


@dataclass(frozen=True)
class Stopped:
    """What counts as stopped."""

    short: float = 0.01
    """m above the commanded height: more than friction and sag explain."""
    plainly: float = 0.02
    """m, reached at least once."""
    slow: float = 0.02
    """m/s of the lowest point: not on its way any more."""
    near: float = 0.04
    """m above the lowest height ever reached."""
    share: float = 0.01
    """Of all poses that must look stopped."""


def stopped_by_floor(heights: Heights, recordings: Sequence[Recording]) -> Diagnosis | None:
    """Whether the robot's lowest point stays well above where its commands would put it, near the lowest reach of all.

    Servos sag below their commands; one that rests above it was stopped. `numbers` has the height in m, the median of the
    lowest points where they were stopped.
    """
    rule = Stopped()
    looks = [(r.name, *seen) for r in recordings for seen in (_reached(heights, r, rule.slow),) if seen is not None]
    if not looks:
        return None
    lowest = min(float(reached.min()) for _, reached, _, _ in looks)
    stopped, names, poses = [], [], 0
    for name, reached, told, slow in looks:
        poses += len(reached)
        resting = slow & (reached - told > rule.short) & (reached < lowest + rule.near)
        if np.any(reached[resting] - told[resting] > rule.plainly):
            stopped.append(reached[resting])
            names.append(name)
    if not stopped or sum(map(len, stopped)) < rule.share * poses:
        return None
    height = float(np.median(np.concatenate(stopped)))
    return Diagnosis(
        "floor", f"the robot was stopped above where its commands would take it, about {100 * height:.1f} cm high "
        f"({', '.join(names)}), and the model has no floor", "one is added and its height calibrated (quantities "
        "floor_height, floor_roll, floor_pitch, floor_friction)",
        {"height": height, "share of poses": sum(map(len, stopped)) / poses},
    )  # fmt: skip


def _reached(heights: Heights, recording: Recording, slow: float) -> tuple[Array, Array, Mask] | None:
    """(T,) lowest points of the robot as measured and as commanded, and whether it moves slowly up or down."""
    command = command_of(recording)
    if command is None or not recording.has("position"):
        return None
    position = recording.channel("position")
    measured = position.select([label for label in position.labels if label in heights.joints])
    shared = shared_joints(command, measured)
    if not shared:
        return None
    time = position.time[:: max(1, len(position.time) // 400)]  # so many poses show where it stops
    own = measured.at(time)
    wanted = np.array(own)
    wanted[:, [measured.labels.index(label) for label in shared]] = command.select(shared).at(time, hold=True)
    good = np.isfinite(own).all(axis=1) & np.isfinite(wanted).all(axis=1)
    if good.sum() < 3:
        return None
    reached, told = (heights.lowest(measured.labels, poses[good]) for poses in (own, wanted))
    return reached, told, np.abs(np.gradient(reached, time[good])) < slow
