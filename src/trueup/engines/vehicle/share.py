# SPDX-License-Identifier: Apache-2.0
"""A share of long drives that a vehicle is searched with: some of the stretches that are predicted, from all over them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.engines.vehicle.rollout import VehicleSimulator
from trueup.recording import Recording
from trueup.trial import Trial

ENOUGH = 300.0
"""s of stretches with which a vehicle is searched: of more, the search's many ways cost in proportion, and end where these
do; the rest is for the last word."""


def shared(
    simulator: VehicleSimulator, drives: Sequence[Recording], seed: int = 0
) -> tuple[VehicleSimulator, list[Recording], tuple[str, ...]]:
    """The simulator and those of the drives with which a search may begin, and what is said of that: one stretch, drawn by
    chance, of so many that follow one another across all drives that no more than `ENOUGH` remain. Evenly spaced ones would
    be the same place of every lap.
    """
    counts = [len(simulator.starts(Trial.of(d, simulator.observable(d)))) for d in drives]
    every = int(np.ceil(sum(counts) * simulator.horizon / ENOUGH))
    if every <= 1:
        return simulator, list(drives), ()
    blocks = np.arange(0, sum(counts), every)
    drawn = blocks + np.random.default_rng(seed).integers(0, np.minimum(every, sum(counts) - blocks))
    first = np.cumsum([0, *counts])
    shares = {d.name: drawn[(drawn >= first[k]) & (drawn < first[k + 1])] - first[k] for k, d in enumerate(drives)}
    said = (
        f"searched with {len(drawn) * simulator.horizon:.0f} s from all over the drives, then fitted to all "
        f"{sum(counts) * simulator.horizon:.0f} s from there"
    )
    return simulator.predicting(shares), [d for d in drives if len(shares[d.name])], (said,)
