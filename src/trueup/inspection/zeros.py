# SPDX-License-Identifier: Apache-2.0
"""Whether joints rest beside their commands, posture after posture: a zero that is off, unless the load pulls so."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.evidence import STANDARD_ERRORS
from trueup.formats.table import listing
from trueup.inspection.diagnosis import Diagnosis
from trueup.inspection.relations import CORRELATED
from trueup.recording import Recording
from trueup.samples import correlation
from trueup.trial import command_of
from trueup.units import AS_FAR

SETTLES = 0.5
"""s within which any servo has settled, on or beside its command."""
FAR = 0.2
"""rad or m: as far as the zero of a servo is searched, and as joints are found beyond the ranges of models."""


def far_beside(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A sentence for each joint that follows its command further beside it than any servo's zero is, all along; one for all
    where most follow in proportion, beside poses of their own.
    """
    if in_proportion := _in_proportion(recordings):
        return (in_proportion,)
    found: dict[str, dict[str, float]] = {}
    for recording in recordings:
        for joint in recording.channel("position").labels if recording.has("position") else ():
            apart = _all_along(recording, joint)
            if abs(apart) > FAR:
                found.setdefault(joint, {})[recording.name] = apart
    return tuple(_sentence(joint, by) for joint, by in found.items())


def _in_proportion(recordings: Sequence[Recording]) -> str:
    """What to say of joints that follow commands which are no positions, such as actions of a learned policy: its targets are
    a pose and some times the action (N. Rudin et al., CoRL 2021). '' where most are positions.
    """
    slopes: dict[str, float] = {}
    poses: dict[str, str] = {}
    for joint in dict.fromkeys(j for r in recordings if r.has("position") for j in r.channel("position").labels):
        pairs = [pair for r in recordings if r.has("position") and (pair := with_command(r, joint)) is not None]
        position, told = (np.concatenate(each) for each in zip(*pairs, strict=True)) if pairs else (np.zeros(0),) * 2
        poses[joint], good = "?", np.isfinite(position) & np.isfinite(told)
        if correlation(position, told) > CORRELATED:
            slopes[joint], pose = np.polyfit(told[good], position[good], 1)
            poses[joint] = f"{pose:.3g}"
    times = float(np.median([*slopes.values()])) if slopes else 1.0
    if 1.0 / AS_FAR <= times <= AS_FAR:
        return ""
    return (
        f"joints go {times:.3g} times as far as their commands, so these are no positions. Of the actions of a policy say in "
        "the mapping, in [channels.command], by how much they are multiplied and which pose they are beside, as the policy's "
        f"settings have it: by these recordings about scale = {times:.3g} and offset = [{', '.join(poses.values())}], for "
        f"{listing(poses, 3)}"
    )


def _sentence(joint: str, by: Mapping[str, float]) -> str:
    apart = ", ".join(f"{each:+.3g}" for each in by.values())
    return (
        f"{joint} is measured {apart} rad (or m) beside its command, though it follows it ({', '.join(by)}). If its "
        "sensor counts from where it was switched on, or was not homed, its positions need an offset in the mapping (one for "
        f"each label; of {joint} about {-np.mean(list(by.values())):.3g} rad, in the unit of the file; a mapping each, where "
        "logs differ). Else its servo is soft, and nothing is wrong"
    )


def _all_along(recording: Recording, joint: str) -> float:
    """How far a joint that follows its command is beside it, if that is more than what changes with the motion; else 0."""
    pair = with_command(recording, joint)
    if pair is None:
        return 0.0
    position, told = pair
    good = np.isfinite(position) & np.isfinite(told)
    position, told = position[good], told[good]
    if len(told) < 3:
        return 0.0
    apart = float(np.median(position - told))
    follows = correlation(position, told) > CORRELATED  # or something holds it
    # Lags and sags change with the motion.
    return apart if follows and abs(apart) > STANDARD_ERRORS * float(np.std(position - told)) else 0.0


def zeros_off(recordings: Sequence[Recording], joints: Sequence[str]) -> Diagnosis | None:
    """Joints whose mean distance from a command that was held is beyond its standard error over all that were held.

    `numbers` has these means by joint, in rad or m. None where no joint is off, or nothing was held.
    """
    off: dict[str, float] = {}
    for joint in joints:
        rests = np.concatenate([held_at(r, joint)[1] for r in recordings] or [np.zeros(0)])
        if len(rests) > 2:
            mean, error = float(rests.mean()), float(rests.std(ddof=1) / np.sqrt(len(rests)))
            if abs(mean) > STANDARD_ERRORS * error > 0.0:
                off[joint] = mean
    if not off:
        return None
    shown = ", ".join(f"{joint} {round(1e3 * mean, 1):+g}" for joint, mean in off.items())
    return Diagnosis(
        "zero", f"joints rest beside their commands ({shown} mrad or mm in the mean)",
        "a zero of each servo is searched beside its load, and kept where left-out recordings show it", off,
    )  # fmt: skip


def held_at(recording: Recording, joint: str) -> tuple[Array, Array]:
    """(n,) instants in the second half of each stretch in which a joint's command was held, in the midst of it, and (n,) mean
    of position minus command over that half.
    """
    pair = with_command(recording, joint)
    if pair is None:
        return np.zeros(0), np.zeros(0)
    (position, told), time = pair, recording.channel("position").time
    apart = position - told
    edges = np.concatenate([[0], np.flatnonzero(np.diff(told) != 0.0) + 1, [len(told)]])
    found = []
    for first, last in itertools.pairwise(edges):
        if time[last - 1] - time[first] >= SETTLES:
            half = time[first:last] >= 0.5 * (time[first] + time[last - 1])
            if np.isfinite(later := apart[first:last][half]).any():
                found.append((float(np.mean(time[first:last][half])), float(np.nanmean(later))))
    instants, means = np.array(found, dtype=np.float64).reshape(-1, 2).T
    return instants, means


def with_command(recording: Recording, joint: str) -> tuple[Array, Array] | None:
    """(T,) each, a joint's position and the command in force then; None where it has not both, in one unit."""
    command, position = command_of(recording), recording.channels.get("position")
    if command is None or position is None or joint not in command.labels or joint not in position.labels:
        return None
    if command.unit_of(joint) != position.unit_of(joint):
        return None
    return position.column(joint), command.select([joint]).at(position.time, hold=True)[:, 0]
