# SPDX-License-Identifier: Apache-2.0
"""Stretches of recordings that stand out: off a model by far more than all that it does badly anywhere else."""

from __future__ import annotations

from collections.abc import Sequence

from trueup.arrays import Array, Mask
from trueup.inspection.released import LONG
from trueup.samples import stretches_of

NAME = "disturbed"
"""By which leaving such stretches out may be refused."""
FAR = 5.0
"""Times how far a model is off anywhere else. In logs of real robots on which nothing acted the largest error of positions is
up to 2.8 times what comes next (AlienGo 2.8, SO-101 2.6, XL330 1.4, UR10 1.3), that of torques up to 1.3 (UR10 1.3, Panda,
TX40 1.1); a table in the way, or a push of 30 to 60 N, are 10 to 200."""


def outstanding(sizes: Sequence[float], rest: float) -> tuple[list[int], float]:
    """Which of the sizes stand out from all that is less, the largest first, and the most of the others, `rest` at least."""
    ordered = sorted(range(len(sizes)), key=lambda k: -sizes[k])
    for count in range(len(ordered), 0, -1):
        least = max([rest, *(sizes[k] for k in ordered[count:])])
        if sizes[ordered[count - 1]] > FAR * least:
            return ordered[:count], least
    return [], rest


def joined(far: Mask, time: Array) -> list[tuple[int, int]]:
    """First and last of the samples of each stretch, those that are less than `LONG` apart as one."""
    made: list[tuple[int, int]] = []
    for begin, end in stretches_of(far).tolist():
        if made and time[begin] - time[made[-1][1]] < LONG:
            begin = made.pop()[0]
        made.append((begin, end - 1))
    return made
