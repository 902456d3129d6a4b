# SPDX-License-Identifier: Apache-2.0
"""Whether joints rest beside their commands, posture after posture: a zero that is off, unless the load pulls so."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.evidence import STANDARD_ERRORS
from trueup.inspection.diagnosis import Diagnosis
from trueup.recording import Recording
from trueup.trial import command_of

_HELD = 0.5  # s that a command stays as it is, of which the second half is looked at: servos settle faster


def zeros_off(recordings: Sequence[Recording], joints: Sequence[str]) -> Diagnosis | None:
    """Joints whose mean distance from a command that was held is beyond its standard error over all that were held.

    `numbers` has these means by joint, in rad or m. None where no joint is off, or nothing was held.
    """
    off: dict[str, float] = {}
    for joint in joints:
        rests = np.concatenate([_rests(r, joint) for r in recordings] or [np.zeros(0)])
        if len(rests) > 2:
            mean, error = float(rests.mean()), float(rests.std(ddof=1) / np.sqrt(len(rests)))
            if abs(mean) > STANDARD_ERRORS * error > 0.0:
                off[joint] = mean
    if not off:
        return None
    shown = ", ".join(f"{joint} {1e3 * mean:+.2g}" for joint, mean in off.items())
    return Diagnosis(
        "zero", f"joints rest beside their commands ({shown} mrad or mm in the mean)",
        "a zero of each servo is searched beside its load, and kept where left-out recordings show it", off,
    )  # fmt: skip


def _rests(recording: Recording, joint: str) -> Array:
    """(n,) mean of position minus command over the second half of each stretch in which the command was held."""
    command = command_of(recording)
    if command is None or not recording.has("position") or joint not in command.labels:
        return np.zeros(0)
    position = recording.channel("position")
    if joint not in position.labels or command.unit != position.unit:
        return np.zeros(0)
    told = command.select([joint]).at(position.time, hold=True)[:, 0]
    apart, time = position.column(joint) - told, position.time
    edges = np.concatenate([[0], np.flatnonzero(np.diff(told) != 0.0) + 1, [len(told)]])
    found = []
    for first, last in itertools.pairwise(edges):
        if time[last - 1] - time[first] >= _HELD:
            later = apart[first:last][time[first:last] >= 0.5 * (time[first] + time[last - 1])]
            if np.isfinite(later).any():
                found.append(float(np.nanmean(later)))
    return np.array(found, dtype=np.float64)
