# SPDX-License-Identifier: Apache-2.0
"""Torques that recordings hold and a calibration did not compare: how large they are beside those of the fitted model.

By positions alone a robot whose masses, gains and friction are all a times as large replays as well; its torques are a times
as large, and tell (M. Gautier and S. Briot, J. Dynamic Systems, Measurement and Control 136(5), 2014).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Estimate
from trueup.engines.simulator import Simulator
from trueup.errors import SimulationFailedError
from trueup.evidence import FEWEST_PARTS, half_interval, jackknife, without_each
from trueup.loop.replay import replays
from trueup.noise import UNUSUAL
from trueup.proportion import either, weighed
from trueup.recording import Recording
from trueup.rounding import TINY

_TORQUE = "torque"


@dataclass(frozen=True)
class Ratio:
    """The measured torque of a joint over that of the model, by least squares, and half of its interval on a log scale."""

    times: float
    half: float


def ratios(
    simulator: Simulator, values: Array, recordings: Sequence[Recording], compared: Collection[str] = ()
) -> dict[str, Ratio]:
    """Of each joint, with these `values` (n,); none where torques are among the channels that were `compared`, told to
    drives, or not measured in N m or N.
    """
    told = any(r.has("command_torque") or r.has("command_sent_torque") for r in recordings)
    held = [r for r in recordings if r.has(_TORQUE) and _TORQUE in simulator.observable(r)]
    if _TORQUE in compared or told or not held:
        return {}
    try:
        found = replays(simulator, values, held, (), channels=(_TORQUE,))
    except SimulationFailedError:
        return {}
    sums: dict[str, list[Array]] = {}
    for replay in found:
        for k, label in enumerate(replay.labels):
            seen, own = replay.measured[:, k], replay.after[:, k]
            good = np.isfinite(seen) & np.isfinite(own)
            both = np.stack([(seen * own)[good], (own * own)[good]], axis=1)
            sums.setdefault(label, []).extend(part.sum(axis=0) for part in np.array_split(both, FEWEST_PARTS))
    each = {label: np.array(parts) for label, parts in sums.items()}
    return {label: _ratio(parts) for label, parts in each.items() if parts[:, 1].sum() > 0.0}


def _ratio(parts: Array) -> Ratio:
    product, square = parts.sum(axis=0)
    without = without_each(parts)
    spread = float(jackknife(without[:, 0] / np.maximum(without[:, 1], TINY)))
    return Ratio(float(product / square), half_interval(len(parts)) * spread / max(abs(float(product / square)), TINY))


def with_logged(
    estimates: Sequence[Estimate], simulator: Simulator, values: Array, recordings: Sequence[Recording]
) -> tuple[Estimate, ...]:
    """Estimates of what grows with the masses that hold whether these are right or the torques that were logged and not
    compared, where both clearly cannot be, as in `trueup.proportion`.
    """
    own = weighed(simulator)
    of = {} if own is None else own.grown(simulator.parameters)
    clear = {
        label: r for label, r in ratios(simulator, values, recordings).items()
        if r.times > 0.0 and r.half < abs(np.log(r.times)) < np.log(UNUSUAL)  # further off they are in another unit
    } if of else {}  # fmt: skip
    if not clear:
        return tuple(estimates)
    logs = np.array([np.log(r.times) for r in clear.values()])
    common = Ratio(float(np.exp(logs.mean())), float(np.ptp(logs)) / 2.0 + max(r.half for r in clear.values()))
    told = []
    for e in estimates:
        if e.fitted and e.value > 0.0 and e.name in of and (of[e.name] in clear or not of[e.name]):
            ratio = clear.get(of[e.name], common)
            e = either(e, np.array([ratio.times]), ratio.half)
        told.append(e)
    return tuple(told)


def beside_logged(
    simulator: Simulator, values: Array, recordings: Sequence[Recording], compared: Collection[str] = ()
) -> tuple[str, ...]:
    """A note with the `ratios`; () without any."""
    found = [f"{r.times:.3g} ({label})" for label, r in ratios(simulator, values, recordings, compared).items()]
    if not found:
        return ()
    return (
        f"the measured torques, which were not compared, are {', '.join(found)} times those of the fitted model: where they "
        "are what drives give, in N m (N of slides), its forces and inertia are off by as much, its masses first. "
        "--channels position,torque compares them",
    )
