# SPDX-License-Identifier: Apache-2.0
"""Stretches of recordings that stand out: off a model by far more than all that it does badly anywhere else."""

from __future__ import annotations

from collections.abc import Sequence

from trueup.arrays import Array, Mask
from trueup.inspection.released import LONG
from trueup.noise import UNUSUAL
from trueup.samples import stretches_of

NAME = "disturbed"
"""By which leaving such stretches out may be refused."""


def outstanding(sizes: Sequence[float], rest: float) -> tuple[list[int], float]:
    """Which of the sizes stand out from all that is less, the largest first, and the most of the others, `rest` at least."""
    ordered = sorted(range(len(sizes)), key=lambda k: -sizes[k])
    for count in range(len(ordered), 0, -1):
        least = max([rest, *(sizes[k] for k in ordered[count:])])
        if sizes[ordered[count - 1]] > UNUSUAL * least:
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
