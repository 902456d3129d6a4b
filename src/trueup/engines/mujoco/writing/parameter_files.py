# SPDX-License-Identifier: Apache-2.0
"""The parameters files of a calibration: what was found, and the same with what the recordings show the model to lack."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from trueup.articulated.assignments import Assignment
from trueup.articulated.declaration_file import write_parameters
from trueup.calibration import Calibration, Estimate, Lacked
from trueup.engines.mujoco.rollout import MujocoSimulator
from trueup.parameters import Parameter, ParameterSpace

_UNJUDGED = "fitted with what the model lacks; to be judged by the next calibration"


def write_parameter_files(simulator: MujocoSimulator, calibration: Calibration, path: Path) -> tuple[str, ...]:
    """Writes the parameters file, and beside it one with what the model lacks, if the evidence holds for that: all that was
    fitted with it, ready to be given back. Notes on the second one. Raises OutputError.
    """
    write_parameters(calibration, simulator.parameters, simulator.quantities, path, simulator.gains.given_for)
    beside = Lacked.beside(path)
    beside.unlink(missing_ok=True)  # of an earlier calibration in the same folder
    lacked = calibration.lacked
    more = () if lacked is None or not lacked.shown.holds else _lacking(simulator, lacked)
    if lacked is None or not more:
        return ()
    own = [_with_it(e, lacked) for e in calibration.estimates]
    new = [_with_it(_begun(parameter), lacked) for parameter, _ in more]
    whole = replace(calibration, estimates=(*own, *new))
    space = ParameterSpace((*simulator.parameters.parameters, *(parameter for parameter, _ in more)))
    quantities = (*simulator.quantities, *(assignment for _, assignment in more))
    write_parameters(whole, space, quantities, beside, simulator.gains.given_for)
    names = ", ".join(parameter.name for parameter, _ in more)
    return (
        f"{beside} has what the model lacks, too ({names}): calibrate with --parameters {beside} to have it in the model",
    )


def _lacking(simulator: MujocoSimulator, lacked: Lacked) -> tuple[tuple[Parameter, Assignment], ...]:
    """The parameters of the structure that was fitted, and what each of them sets."""
    there = len(simulator.parameters)
    for structure in simulator.structures().values():
        if isinstance(structure, MujocoSimulator):
            declared = zip(structure.parameters.parameters[there:], structure.quantities[there:], strict=True)
            found = tuple((p, a) for p, a in declared if p.name in lacked.intervals)
            if found:
                return found
    return ()


def _with_it(estimate: Estimate, lacked: Lacked) -> Estimate:
    if estimate.name not in lacked.intervals:
        return estimate
    value, low, high = lacked.intervals[estimate.name]
    return replace(estimate, value=value, low=low, high=high, fitted=True, verdict="", note=_UNJUDGED)


def _begun(p: Parameter) -> Estimate:
    nan = float("nan")
    return Estimate(p.name, p.unit, p.nominal, p.nominal, nan, nan, p.lower, p.upper, True, "")
