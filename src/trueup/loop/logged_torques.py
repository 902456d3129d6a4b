# SPDX-License-Identifier: Apache-2.0
"""Torques that recordings hold and a calibration did not compare: how large they are beside those of the fitted model.

By positions alone a robot whose masses, gains and friction are all a times as large replays as well; its torques are a times
as large, and tell (M. Gautier and S. Briot, J. Dynamic Systems, Measurement and Control 136(5), 2014).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from trueup.arrays import Array
from trueup.engines.simulator import Simulator
from trueup.errors import SimulationFailedError
from trueup.loop.replay import replays
from trueup.recording import Recording

_TORQUE = "torque"


def beside_logged(
    simulator: Simulator, values: Array, recordings: Sequence[Recording], compared: Collection[str] = ()
) -> tuple[str, ...]:
    """A note with the measured torque of each joint over that of the simulator with these `values` (n,), by least squares;
    () where torques are among the channels that were `compared`, told to drives, or not measured in N m or N.
    """
    told = any(r.has("command_torque") or r.has("command_sent_torque") for r in recordings)
    held = [r for r in recordings if r.has(_TORQUE) and _TORQUE in simulator.observable(r)]
    if _TORQUE in compared or told or not held:
        return ()
    try:
        found = replays(simulator, values, held, (), channels=(_TORQUE,))
    except SimulationFailedError:
        return ()
    sums: dict[str, tuple[float, float]] = {}
    for replay in found:
        good = np.isfinite(replay.measured) & np.isfinite(replay.after)
        for k, label in enumerate(replay.labels):
            seen, own = replay.measured[good[:, k], k], replay.after[good[:, k], k]
            product, square = sums.get(label, (0.0, 0.0))
            sums[label] = product + float(seen @ own), square + float(own @ own)
    ratios = [f"{product / square:.3g} ({label})" for label, (product, square) in sums.items() if square > 0.0]
    if not ratios:
        return ()
    return (
        f"the measured torques, which were not compared, are {', '.join(ratios)} times those of the fitted model: where they "
        "are what drives give, in N m (N of slides), its forces and inertia are off by as much, its masses first. "
        "--channels position,torque compares them",
    )
