# SPDX-License-Identifier: Apache-2.0
"""Calibrates once more with recordings that came since: from the last fit, while it leads to where these are explained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trueup.calibration import Calibration, pooled_rmse
from trueup.engines.simulator import Simulator
from trueup.evidence import evidence, explained
from trueup.loop.calibrate import Options, calibrate
from trueup.loop.earlier import Earlier
from trueup.loop.fit import REFINEMENT
from trueup.parameters import ParameterSpace
from trueup.recording import Recording


def recalibrate(
    simulator: Simulator, recordings: Sequence[Recording], hold_out: Sequence[Recording], earlier: Earlier,
    options: Options, **how: Any,
) -> Calibration:  # fmt: skip
    """Like `calibrate`, but from the values of an `earlier` fit, with its structure, by slopes alone, on all `recordings`.

    Steps end where they gain no more than chance would. Where recordings that the earlier fit had not seen stay clearly
    worse replayed than those that it had, it led to the wrong place: `calibrate` searches as if there had been none, and the
    better of both is taken. `how` is passed on to it. Raises what `calibrate` raises.
    """
    space = simulator.parameters
    left_out = [name for name in earlier.left_out if name in space.names and not space[name].frozen]
    if len(left_out) == int(space.free.sum()):
        return calibrate(simulator, recordings, hold_out, options=options, **how)
    start = earlier.values_in(space)
    start = np.where(start == space.unidentified, space.nominal, start)  # a limit that was not met then may be met now
    again = replace(options, stages=REFINEMENT, select=False, later=())
    asked = [p for p in space.parameters if p.absent is not None]  # what was kept of these is no longer asked about
    space = space.freeze(left_out).without([p.name for p in asked if p.name in left_out])
    kept = {p.name for p in asked if p.name not in left_out}
    space = ParameterSpace(tuple(p.replace(optional="") if p.name in kept else p for p in space.parameters))
    refined = calibrate(
        simulator, recordings, hold_out, options=again, space=space, start=start, earlier=earlier, **how
    )
    old = {r.name for r in recordings if earlier.knew(r)}
    if _explains(refined, old):
        return replace(refined, notes=(*refined.notes, "searched from the last calibration, which leads on"))
    searched = calibrate(simulator, recordings, hold_out, options=options, **how)
    better = _error(searched) < _error(refined)
    said = (
        "recordings that the last calibration had not seen stay worse replayed from there than those it had; searched anew, "
        f"which {'led lower' if better else 'found nothing better'}"
    )
    best = searched if better else refined
    return replace(
        best, notes=(*best.notes, said), seconds=refined.seconds + searched.seconds,
        cpu_seconds=refined.cpu_seconds + searched.cpu_seconds, evaluations=refined.evaluations + searched.evaluations,
    )  # fmt: skip


def _explains(found: Calibration, old: set[str]) -> bool:
    """Whether recordings that are not `old` are replayed about as well as those that are, label by label.

    About to their noise is well enough. A single comparison has no spread: then as well at least.
    """
    unseen = [r for r in found.training() if r.recording not in old and r.noise.all()]
    residual = np.concatenate([((r.after - r.measured) / r.noise).ravel() for r in unseen]) if unseen else np.zeros(0)
    if unseen and explained(residual[np.isfinite(residual)]):
        return True
    levels: dict[tuple[str, str], list[float]] = {}
    columns = [
        (replay.recording in old, (replay.channel, label), float(error))
        for replay in found.training()
        for label, error in zip(replay.labels, replay.rmse_after(), strict=True)
        if error > 0.0
    ]
    for known, key, error in columns:
        if known:
            levels.setdefault(key, []).append(float(np.log(error)))
    new = [(error, np.exp(np.mean(levels[key]))) for known, key, error in columns if not known and key in levels]
    if not new:
        return True
    errors, expected = np.array(new).T
    worse = errors[0] > expected[0] if len(new) == 1 else evidence(errors, expected).holds
    return bool(np.isfinite(errors).all()) and not worse


def _error(calibration: Calibration) -> float:
    """Over all that was fitted: the geometric mean of replay errors; infinite where one fails."""
    errors = [pooled_rmse([r], after=True) for r in calibration.training()]
    return float(np.exp(np.mean(np.log(errors)))) if np.isfinite(errors).all() else float("inf")
