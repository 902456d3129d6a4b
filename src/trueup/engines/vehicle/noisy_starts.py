# SPDX-License-Identifier: Apache-2.0
"""Vehicles searched with the states at which predictions begin known but for their noise, and what that does to estimates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.arrays import Array
from trueup.calibration import Calibration, Estimate
from trueup.engines.family import Fit
from trueup.engines.vehicle.judging import Ahead
from trueup.engines.vehicle.prediction import prediction_errors
from trueup.engines.vehicle.quantities import LASTING
from trueup.engines.vehicle.rollout import VehicleSimulator
from trueup.engines.vehicle.vehicle import HORIZONS
from trueup.evidence import half_interval
from trueup.parameters import ParameterSpace
from trueup.recording import Recording
from trueup.samples import MOSTLY
from trueup.verdicts import judged

ROUGHLY = ("first seconds", "all, coarse step")
"""Stages of a search that see a part of the recordings, or all roughly: one that goes on from where a fit of all of them
has ended would be led away from there."""
SEARCHED = (*ROUGHLY, "lines", "evolution", "profiles", "off bounds", "implicit filtering")
"""Stages that look for lower places than slopes lead to: done, where a fit goes on from the same search of a part."""


def begun_with_noise(
    simulator: VehicleSimulator, found: Calibration, drives: Sequence[Recording], others: Sequence[Recording], fit: Fit
) -> Calibration:
    """The calibration, searched on from there with noise of the states at which predictions begin eliminated, where what is
    left is not mostly (`MOSTLY`) something else: all samples of a stretch share it, so that it moves estimates more than all
    other noise.

    Whether a speed follows late by a slow command or by a soft controller is told only then, so both are searched from.
    """
    residuals = Ahead(simulator, drives).residuals(found.values, drives)
    measure = _with_noise(simulator, residuals, drives, found.values)
    if measure.noise_of_starts(residuals, drives) < 1.0 - MOSTLY:
        return found
    held = _held(simulator, found)
    how = {"discrepancy": measure, "cross_validate": False, "again": True, "without": ROUGHLY}
    begun = [found.values, *_late_otherwise(held.parameters, found.values)]
    ended = [fit(held, drives, others, **how, start=values) for values in begun]
    return min(ended, key=lambda c: astray(simulator, c.values, drives))


def confirmed(
    simulator: VehicleSimulator, found: Calibration, noisy: bool, drives: Sequence[Recording],
    others: Sequence[Recording], fit: Fit,
) -> Calibration:  # fmt: skip
    """A calibration with a share of the drives fitted to all of them from where it has ended, with noise of starts eliminated
    where it is `noisy`.
    """
    measure = Ahead(simulator, drives)
    if noisy:
        measure = _with_noise(simulator, measure.residuals(found.values, drives), drives, found.values)
    held = _held(simulator, found)
    return fit(held, drives, others, discrepancy=measure, cross_validate=False, again=True, without=SEARCHED,
               start=found.values)  # fmt: skip


def _held(simulator: VehicleSimulator, found: Calibration) -> VehicleSimulator:
    """With what `LASTING` names as it was found, and structures that were kept as part of the vehicle: asked about anew they
    would be gone at the start, and the search led away for want of them.
    """
    space = simulator.parameters
    lasting = [n for n in LASTING if n in space.names]
    held = space.freeze(lasting, dict(zip(space.names, found.values, strict=True)))
    kept = {e.name for e in found.estimates if e.fitted}
    parts = (p.replace(optional="") if p.name in kept else p for p in held.parameters)
    return simulator.with_parameters(ParameterSpace(tuple(parts)))


def _with_noise(
    simulator: VehicleSimulator, residuals: Sequence[Array], drives: Sequence[Recording], values: Array
) -> Ahead:
    """The measure that eliminates noise of starts, at the level of residuals (M,) of each drive with values (n,)."""
    each = np.concatenate(residuals)
    return Ahead(simulator, drives, level=float(np.sqrt(np.mean(each[each != 0.0] ** 2))), values=values)


def by_both(estimates: Sequence[Estimate], others: Sequence[Estimate], space: ParameterSpace) -> tuple[Estimate, ...]:
    """With intervals that hold whether starts of predictions are taken to be exact or not, and verdicts on these: how far
    that moves estimates is what the model is wrong by, which neither fit alone shows.
    """
    beside = {e.name: e for e in others if e.fitted and np.isfinite([e.low, e.high]).all()}
    return tuple(_by_either(e, beside[e.name], space) if e.fitted and e.name in beside else e for e in estimates)


def _by_either(found: Estimate, other: Estimate, space: ParameterSpace) -> Estimate:
    wide = replace(found, low=min(found.low, other.low), high=max(found.high, other.high))
    if wide.verdict != "identified":
        return wide
    alone = ParameterSpace((space[wide.name].replace(frozen=False),))
    low, value, high = alone.to_unit([[wide.low], [wide.value], [wide.high]])[:, 0].tolist()
    verdict = judged(
        alone.parameters[0], value, (high - low) / (2.0 * half_interval()), wide.value, wide.low, wide.high
    )
    return replace(wide, verdict=verdict.word, note=verdict.note or wide.note)


def _late_otherwise(space: ParameterSpace, values: Array) -> list[Array]:
    """Values (n,) of a vehicle whose command is as slow as its controller was soft, and the other way round; none of one that
    does not pursue a speed, or of which these are not searched.
    """
    names = ("speed_lag", "speed_gain")
    if any(n not in space.names or space[n].frozen for n in names):
        return []
    lag, gain = (space.names.index(n) for n in names)
    other, (slow, stiff) = np.array(values), (space[n] for n in names)
    other[lag] = np.clip(1.0 / values[gain], slow.lower, slow.upper)
    other[gain] = np.clip(1.0 / max(values[lag], 1.0 / stiff.upper), stiff.lower, stiff.upper)
    return [other]


def astray(simulator: VehicleSimulator, values: Array, drives: Sequence[Recording]) -> float:
    """Mean over horizons of the logarithm of the mean error in m of predictions with values (n,)."""
    errors = [e for d in drives if len(e := prediction_errors(simulator, values, d, HORIZONS))]
    return float(np.mean(np.log(np.concatenate(errors).mean(axis=0)))) if errors else np.inf
