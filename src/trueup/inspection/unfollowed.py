# SPDX-License-Identifier: Apache-2.0
"""Commands that no joint follows: where a tool was to go, or by how much, under the name of a command (a policy's action)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.evidence import HALVED
from trueup.inspection.relations import CORRELATED
from trueup.inspection.zeros import SETTLES, far_beside, with_command
from trueup.noise import estimate_grid, estimate_noise, is_noise
from trueup.recording import Recording
from trueup.rounding import TINY
from trueup.trial import LOOK

_SEVERAL = 3
"""Joints: fewer may all be in vain."""


def beside_commands(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A sentence on each joint that follows its command far beside it, and on commands that none follows."""
    return (*far_beside(recordings), *unfollowed(recordings))


def unfollowed(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A sentence, where several joints moved and were commanded, and none of them, over all recordings, as commanded."""
    pairs, lags = _pairs(recordings), np.arange(0.0, SETTLES, LOOK)
    alike = {joint: [_likeness(each, late) for late in lags] for joint, each in pairs.items()}
    # All joints are as late, nearly, so that one lag is the best: each by itself finds one by chance.
    best = max(range(len(lags)), key=lambda k: sum(each[k] for each in alike.values()))
    if len(alike) < _SEVERAL or max(each[best] for each in alike.values()) >= CORRELATED:
        return ()
    shown = ", ".join(f"{joint} {each[best]:.2f}" for joint, each in alike.items())
    return (
        f"no joint goes where it is commanded (correlations of positions and commands {1e3 * lags[best]:.0f} ms before: "
        f"{shown}). If the commands are of something else, as a policy's actions may be steps or where the tool goes, or if "
        "joints are mixed up, name what the joints were told in [channels.command] of the mapping. Else the servos are "
        "soft, and nothing is wrong",
    )


def astray(recordings: Sequence[Recording]) -> float:
    """Share of the joints' motion that going where commanded leaves open, at the delay at which that is least; 1 at most, and
    where nothing was commanded in the unit of the positions.
    """
    pairs = _pairs(recordings)
    lags = np.arange(0.0, SETTLES, LOOK)
    left = [[min(1.0, _beside(each, late)) for each in pairs.values()] for late in lags]
    return min((float(np.mean(each)) for each in left if each), default=1.0)


def _beside(pairs: Sequence[_Pair], late: float) -> float:
    """Mean square of positions beside what was commanded so long before, over that of positions; both without their means."""
    one, other = _held(pairs, late)
    return float(np.sum((one - other) ** 2) / max(np.sum(one**2), TINY))


def _pairs(recordings: Sequence[Recording]) -> dict[str, list[_Pair]]:
    """By joint, in whichever recordings it has some."""
    pairs: dict[str, list[_Pair]] = {}
    for recording in recordings:
        for joint in recording.channel("position").labels if recording.has("position") else ():
            pair = _pair(recording, joint)
            if pair is not None:
                pairs.setdefault(joint, []).append(pair)
    return pairs


@dataclass(frozen=True, eq=False)
class _Pair:
    """A joint's position and what it was told, (T,) each, every `step` s."""

    position: Array
    command: Array
    step: float


def _pair(recording: Recording, joint: str) -> _Pair | None:
    """None where a joint has no command, or none that changes, or shows nothing but noise."""
    pair = with_command(recording, joint)
    if pair is None or len(np.unique(pair[1][np.isfinite(pair[1])])) < 2:
        return None
    (position, told), time = pair, recording.channel("position").time
    if is_noise(position, float(estimate_noise(position, time)[0]), estimate_grid(position)):
        return None
    return _Pair(position, told, float(np.median(np.diff(time))))


def _likeness(pairs: Sequence[_Pair], late: float) -> float:
    """The correlation of positions and commands so many seconds before, over all recordings; 1 where going where commanded
    explains half of the motion.
    """
    one, other = _held(pairs, late)
    if np.sum((one - other) ** 2) < HALVED * np.sum(one**2):
        return 1.0
    return float(one @ other / max(np.sqrt(np.sum(one**2) * np.sum(other**2)), TINY))


def _held(pairs: Sequence[_Pair], late: float) -> tuple[Array, Array]:
    """Positions, and commands so many seconds before, each without the mean of its recording."""
    ones, others = [np.zeros(0)], [np.zeros(0)]
    for pair in pairs:
        shift = round(late / pair.step)
        one, other = pair.position[shift:], pair.command[: max(len(pair.command) - shift, 0)]
        good = np.isfinite(one) & np.isfinite(other)
        if np.count_nonzero(good) > 1:
            ones.append(one[good] - one[good].mean())
            others.append(other[good] - other[good].mean())
    return np.concatenate(ones), np.concatenate(others)
