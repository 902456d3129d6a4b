# SPDX-License-Identifier: Apache-2.0
"""Calibrates without an optional structure first, then with it: what bends the whole fit must not lead it astray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trueup.calibration import Calibration, pooled_rmse
from trueup.discrepancies.discrepancy import Discrepancy
from trueup.engines.simulator import Simulator
from trueup.loop.calibrate import Options, calibrate
from trueup.loop.fit import Checkpoint, Progress
from trueup.recording import Recording

_CLEARLY = 0.95  # share of the replay error up to which the structure is taken


def calibrate_stepwise(
    simulator: Simulator, recordings: Sequence[Recording], hold_out: Sequence[Recording], later: str, options: Options, *,
    discrepancy: Discrepancy | None = None, progress: Progress | None = None, checkpoint: Checkpoint | None = None,
    resume: dict[str, Any] | None = None,
) -> Calibration:  # fmt: skip
    """Like `calibrate`, but the optional structure `later` (`Parameter.optional`) is at zero first.

    Then it is searched with it, from where that ended and from the start values, and the best of these is taken where it
    replays the recordings clearly better: never worse than without. An interrupted search goes on in the first of them.
    Raises what `calibrate` raises.
    """
    space = simulator.parameters
    names = [p.name for p in space.parameters if p.optional == later and not p.frozen]
    if not names or len(names) == int(space.free.sum()):
        return calibrate(simulator, recordings, hold_out, options=options, discrepancy=discrepancy, progress=progress,
                         checkpoint=checkpoint, resume=resume)  # fmt: skip
    without = calibrate(
        simulator, recordings, hold_out, options=options, discrepancy=discrepancy, progress=progress,
        checkpoint=checkpoint, resume=resume,
        space=space.freeze(names, dict.fromkeys(names, 0.0)),
    )  # fmt: skip
    from_there = np.where([name in names for name in space.names], space.nominal, without.values)
    found = [
        calibrate(
            simulator, recordings, hold_out, options=options, discrepancy=discrepancy, progress=progress, start=start
        )
        for start in (from_there, space.nominal)
    ]
    best = min(found, key=_error)
    better = _error(best) < _CLEARLY * _error(without)
    said = f"{later}: the replay error of what was fitted is {_error(best) / _error(without):.2f} times that without it"
    every = (without, *found)
    return replace(
        best if better else without, notes=(*(best if better else without).notes, said),
        seconds=sum(c.seconds for c in every), cpu_seconds=sum(c.cpu_seconds for c in every),
        evaluations=sum(c.evaluations for c in every),
    )  # fmt: skip


def _error(calibration: Calibration) -> float:
    """The geometric mean over replays of what was fitted; infinite where one fails."""
    errors = [pooled_rmse([r], after=True) for r in calibration.training()]
    return float(np.exp(np.mean(np.log(errors)))) if np.isfinite(errors).all() else float("inf")
