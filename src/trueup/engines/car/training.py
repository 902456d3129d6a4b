# SPDX-License-Identifier: Apache-2.0
"""Each drive fitted several times with stretches that begin at other moments, and counted once in the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.calibration import Calibration, Estimate
from trueup.errors import RecordingError
from trueup.recording import Recording, part_of

PHASES = 3


def begun_apart(recordings: Sequence[Recording], horizon: float) -> list[Recording]:
    """Every recording, and as often as there are PHASES without its first moments, so that its stretches begin between.

    One way of cutting a drive leaves too much to the chance of where the cuts are.
    """
    found = list(recordings)
    for recording in recordings:
        for k in range(1, PHASES):
            try:
                later = recording.slice(recording.start + horizon * k / PHASES, recording.stop)
            except RecordingError:
                continue  # too short to be cut otherwise
            quiet = {key: text for key, text in part_of(recording).items() if key != "warnings"}  # said once already
            if later.has("position") and np.isfinite(later.channel("position").values).any():
                found.append(later.replace(name=f"{recording.name}, cut {k + 1}", provenance=quiet))
    return found


def counted_once(calibration: Calibration, recordings: Sequence[Recording]) -> Calibration:
    """The calibration with the replays of `recordings` only, and as uncertain as one look at each of them leaves it."""
    names = {r.name for r in recordings}
    wider = float(np.sqrt(PHASES))
    return replace(
        calibration,
        replays=tuple(replace(r, noise=np.zeros(0)) for r in calibration.replays if r.held_out or r.recording in names),
        estimates=tuple(_widened(e, wider) for e in calibration.estimates),
        covariance=calibration.covariance * PHASES,
    )


def _widened(e: Estimate, factor: float) -> Estimate:
    low = max(e.lower_bound, e.value - factor * (e.value - e.low))
    return replace(e, low=low, high=min(e.upper_bound, e.value + factor * (e.high - e.value))) if e.fitted else e
