# SPDX-License-Identifier: Apache-2.0
"""Recordings, or parts of them, as regressor and torque that passed the same filter: ready to be fitted or judged."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.errors import IdentificationError
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.estimation.filtering import Lowpass, decimated
from trueup.identification.estimation.motion import Motion
from trueup.identification.rows import Rows

_COMPARED = 5.0
"""Samples per second that are compared, over the cut-off."""
_GAP = 2.0
"""Between what is fitted and what is held out of the same recording, in periods of the cut-off."""
_FEWEST = 40
"""Samples in a piece."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A recording, or a part of one, ready to be compared."""

    motion: Motion
    """At the instants of `rows`."""
    rows: Rows
    held_out: bool


def pieces_of(motion: Motion, model: DynamicModel, cutoff: float, hold_out: float) -> list[Piece]:
    """The rows of a motion, filtered with its torque, whole or split in two with a gap between.

    Standstill at both ends is left out, and what a filter cannot know: one period of the cut-off there and around gaps.
    """
    rows = model.rows(motion.time, motion.q, motion.v, motion.a, motion.torque)
    every = decimated(motion.rate, _COMPARED * cutoff)
    if cutoff < 0.45 * motion.rate:
        rows = rows.filtered(Lowpass(motion.rate, cutoff), every)
    (start, stop), margin = motion.span(), 1.0 / cutoff
    start, stop = max(start, float(rows.time[0]) + margin), min(stop, float(rows.time[-1]) - margin)
    edge = start + (1.0 - hold_out) * (stop - start)
    known = np.ones(rows.length, dtype=bool)
    for first, last in motion.gaps:
        known &= (rows.time < first - margin) | (rows.time > last + margin)
    keeps = [(known & (rows.time >= start) & (rows.time <= edge), False)]
    if hold_out > 0.0:
        keeps.append((known & (rows.time > edge + _GAP / cutoff) & (rows.time <= stop), True))
    if min(np.count_nonzero(keep) for keep, _ in keeps) < _FEWEST:
        raise IdentificationError(
            f"recording '{motion.name}': {max(stop - start, 0.0):.2g} s of motion are too little for a cut-off of "
            f"{cutoff:g} Hz{' and a part held out' if hold_out else ''}"
        )
    whole = _at(motion, slice(None, None, every))
    return [Piece(_at(whole, keep), rows.part(keep), held) for keep, held in keeps]


def _at(motion: Motion, keep: slice | NDArray[np.bool_]) -> Motion:
    arrays = {name: getattr(motion, name)[keep] for name in ("time", "q", "v", "a", "torque")}
    return replace(motion, **arrays)
