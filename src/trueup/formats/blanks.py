# SPDX-License-Identifier: Apache-2.0
"""Rows of a table in which a channel has nothing: of another topic, of a slower clock, or samples that are missing."""

from __future__ import annotations

import numpy as np

from trueup.arrays import Array
from trueup.formats.clock import Samples
from trueup.formats.table import Table
from trueup.samples import MOST


def of_a_topic(values: Array, table: Table) -> bool:
    """Whether the rows in which a channel (T, k) has nothing are those of other topics, as PlotJuggler writes each message
    into a row of its own: what stands there comes mostly where this channel has nothing.
    """
    blank = np.asarray(np.isnan(values).all(axis=1))
    if len(blank) != table.length or not blank.any() or blank.all():
        return False
    there = [known if known.ndim == 1 else known.any(axis=1) for known in map(np.isfinite, table.columns.values())]
    others = [known for known in there if known.any() and float(np.mean(blank[known])) > MOST]
    return bool(others) and float(np.mean(np.any(others, axis=0)[blank])) > MOST


def without_blanks(samples: Samples, role: str, *, topic: bool) -> Samples:
    """Drops the rows in which a table of several clocks has nothing for this channel; of a `topic` without a word."""
    blank = np.asarray(np.isnan(samples.values).all(axis=1))
    # Of most rows empty, a channel has a slower clock than its table, rather than missing samples.
    if np.all(blank) or (np.mean(blank) < MOST and not topic):
        return samples
    note = f"{role}: {int(blank.sum())} of {len(blank)} rows have no value for it and were left out"
    warnings = samples.warnings if topic else (*samples.warnings, note)
    return Samples(samples.time[~blank], samples.values[~blank], warnings)
