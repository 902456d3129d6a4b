# SPDX-License-Identifier: Apache-2.0
"""Whether joints run into hard stops that the model lacks: they rest at one place while their commands go on beyond it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.inspection.diagnosis import Diagnosis
from trueup.inspection.inspection import STUCK_SECONDS
from trueup.noise import UNUSUAL, estimate_noise
from trueup.recording import Recording
from trueup.samples import stretches_of
from trueup.trial import command_of

_NOISES, _SHARE = (
    6.0,
    0.01,
)  # of the noise's deviation, of the joint's way: positions as near as that are the same place


def stopped_at(recordings: Sequence[Recording], ranges: Mapping[str, tuple[float, float]]) -> Diagnosis | None:
    """Joints that rest again and again at the end of all that they reach, while their commands move on beyond it.

    `ranges` are those that a model has of its joints, infinite where it has none. `numbers` has the stops that it lacks, by
    joint and side, in rad or m: '<joint> upper'. None where there are none. What stops several joints together (a floor)
    is another diagnosis.
    """
    found = {}
    for joint, ends in ranges.items():
        for side, sign, end in zip(("lower", "upper"), (-1.0, 1.0), ends, strict=True):
            stop = _stop(recordings, joint, sign)
            if stop is not None and not abs(stop[0] - end) < stop[1]:
                found[f"{joint} {side}"] = stop[0]
    if not found:
        return None
    shown = ", ".join(f"{name} {value:.4g}" for name, value in found.items())
    return Diagnosis(
        "stops", f"joints rest at one place while their commands go on beyond it ({shown} rad or m), where the model lets "
        "them pass", "hard stops are added and calibrated (quantities stop_lower, stop_upper)", found,
    )  # fmt: skip


def _stop(recordings: Sequence[Recording], joint: str, sign: float) -> tuple[float, float] | None:
    """Where a joint is stopped on one side and how exactly that is seen, in rad or m; None where it is not. What holds a
    joint once may be anything.
    """
    parts = [part for r in recordings for part in (_commanded(r, joint),) if part is not None]
    if not parts:
        return None
    most, least = (f([sign * position for _, position, _, _ in parts]) for f in (_most, _least))
    near = max(_NOISES * max(noise for *_, noise in parts), _SHARE * (most - least))
    rests = []
    for time, position, command, _ in parts:
        pressed = (sign * position > most - near) & (sign * command > most + near)
        for first, last in stretches_of(pressed):
            if time[last - 1] - time[first] >= STUCK_SECONDS and float(np.ptp(command[first:last])) > UNUSUAL * near:
                rests.append(position[first:last])
    return (float(np.median(np.concatenate(rests))), near) if len(rests) > 1 else None


def _most(signals: Sequence[Array]) -> float:
    return max(float(s.max()) for s in signals)


def _least(signals: Sequence[Array]) -> float:
    return min(float(s.min()) for s in signals)


def _commanded(recording: Recording, joint: str) -> tuple[Array, Array, Array, float] | None:
    """Times in s, positions, commands (T,) of a joint and the positions' noise; None where either is missing."""
    command = command_of(recording)
    if command is None or not recording.has("position") or joint not in command.labels:
        return None
    position = recording.channel("position")
    if joint not in position.labels or command.unit_of(joint) != position.unit_of(joint):
        return None
    good = np.isfinite(position.column(joint))
    time, values = position.time[good], position.column(joint)[good]
    if len(time) < 8:
        return None
    noise = float(estimate_noise(values[:, None], time)[0])
    told = command.select([joint]).at(time, hold=True)[:, 0]
    return (time, values, told, noise) if np.isfinite(noise) and np.isfinite(told).all() else None
