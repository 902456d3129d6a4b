# SPDX-License-Identifier: Apache-2.0
"""What an identification found: everything that reports and files are made from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.formats.plain import finite
from trueup.identification.inertial import NAMES

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Prediction:
    """One recording's torque, measured and predicted; arrays are (S, n) in N m (N), rad and rad/s (m, m/s)."""

    recording: str
    held_out: bool
    time: Array
    """(S,) in s."""
    measured: Array
    fitted: Array
    """By the unconstrained model."""
    consistent: Array | None
    """By the physically consistent one."""
    file: Array | None
    """By the inertias of the model file alone, without friction; None where it has none."""
    position: Array
    velocity: Array
    reach: Array
    """(S, 3) where the last link's frame is, in m in the base frame."""


@dataclass(frozen=True)
class Parameter:
    """One combination that torque can tell."""

    name: str
    """Readable: 'I2zz + I2m + 0.49 m3'."""
    unit: str
    kind: str
    """'inertial' or the name of an effect ('viscous', 'rotor', ...)."""
    joint: str
    value: float
    deviation: float
    """Standard deviation, with the errors' memory."""
    file: float
    """What the model file says; NaN where it says nothing."""
    consistent: float
    """In the physically consistent model; NaN without one."""
    verdict: str
    """'identified', 'roughly', 'small', 'shared' or 'not seen'."""
    note: str = ""

    @property
    def relative(self) -> float:
        """Standard deviation over size."""
        return self.deviation / abs(self.value) if self.value else math.inf


@dataclass(frozen=True)
class Link:
    """One link's ten inertial parameters in the consistent model, and what to mind."""

    name: str
    mass: float
    com: tuple[float, float, float]
    """m, in the link's frame."""
    moments: tuple[float, float, float]
    """Principal moments of inertia about the centre of mass in kg m^2, largest last."""
    on_boundary: bool
    """Whether the fit wanted a mass distribution that no body has, and stopped at the edge of what is possible."""
    violation: str = ""
    """What would be impossible in the unconstrained fit, in words."""


@dataclass(frozen=True)
class Alignment:
    """Torque against position in time."""

    shift: float
    """s by which torque comes late (negative: early)."""
    deviation: float
    rate: float
    """Samples per second of the log."""
    corrected: bool
    gain: float
    """How much smaller the squared error is with the shift taken out, as a share."""

    @property
    def samples(self) -> float:
        """The shift in samples of the log."""
        return self.shift * self.rate


@dataclass(frozen=True, eq=False)
class Identification:
    """A dynamic model of an arm and how well it predicts torque. Arrays are (n,), in the order of `joints`."""

    model_name: str
    joints: tuple[str, ...]
    prismatic: tuple[bool, ...]
    units: tuple[str, ...]
    """Of each joint's torque: N m, N for a slide, or that of the log where it holds currents of unknown constants."""
    effort: Array
    """Torque limits of the model file, N m (N); NaN where it has none."""
    parameters: tuple[Parameter, ...]
    links: tuple[Link, ...]
    predictions: tuple[Prediction, ...]
    noise: Array
    """Standard deviation of the error on the training data."""
    cross_validation: Array
    """(K, n) root mean squared errors of blocks, each predicted by a fit to the others."""
    alignment: Alignment | None
    structure: tuple[tuple[str, ...], ...]
    """For each joint the effects that were kept, in words."""
    simple_friction: Array
    """(n, 2) Coulomb and viscous friction that come closest to what was identified, for URDF and MJCF."""
    armature: Array
    """Rotor inertias that stand apart from the links, kg m^2 (kg)."""
    inertial: Array
    """(n, 10) inertial parameters of the links in their joints' frames, consistent ones where they were asked for."""
    cutoff: float
    """Hz."""
    rate: float
    """Samples per second that were compared."""
    weighting: str
    trust: float
    """Strength of the pull of the fit towards the model file; about 1e-9 is none."""
    pull: float
    """The same for the consistent model, which takes from the file what torque cannot tell."""
    advice: tuple[str, ...]
    """What these recordings could not tell, and which motion would."""
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    seconds: float

    @property
    def unit(self) -> str:
        """The unit of all torques, or the units."""
        return ", ".join(dict.fromkeys(self.units))

    def held_out(self) -> list[Prediction]:
        """The recordings, or parts of them, that were not fitted."""
        return [p for p in self.predictions if p.held_out]

    def training(self) -> list[Prediction]:
        """Those that were."""
        return [p for p in self.predictions if not p.held_out]

    def judged(self) -> list[Prediction]:
        """Held out if there is any, else training: say which."""
        return self.held_out() or self.training()

    def cross_validated(self) -> float:
        """Root mean squared error over all joints and blocks."""
        return float(np.sqrt(np.mean(self.cross_validation**2))) if self.cross_validation.size else math.nan


def relative_error(predictions: Sequence[Prediction], which: str = "fitted") -> float:
    """||measured - predicted|| / ||measured|| over all joints and samples; NaN where there is no such prediction."""
    errors, size = 0.0, 0.0
    for p in predictions:
        predicted = getattr(p, which)
        if predicted is None:
            return math.nan
        errors += float(np.sum((p.measured - predicted) ** 2))
        size += float(np.sum(p.measured**2))
    return math.sqrt(errors / size) if size else math.nan


def rmse(predictions: Sequence[Prediction], which: str = "fitted") -> Array:
    """(n,) root mean squared error of each joint, N m (N)."""
    errors = np.concatenate([p.measured - getattr(p, which) for p in predictions])
    return np.sqrt(np.mean(errors**2, axis=0))


def relative_errors(predictions: Sequence[Prediction], which: str = "fitted") -> Array:
    """(n,) the relative error of each joint."""
    size = np.sqrt(np.mean(np.concatenate([p.measured for p in predictions]) ** 2, axis=0))
    return rmse(predictions, which) / np.maximum(size, np.finfo(float).tiny)


def numbers_of(found: Identification) -> dict[str, Any]:
    """SI units; null where there is no number. Errors are given for held-out motion and for the training data."""
    return finite(
        {
            "model": found.model_name,
            "joints": list(found.joints), "units": list(found.units),
            "held_out": _errors(found, held_out=True),
            "training": _errors(found, held_out=False),
            "cross_validation": {
                "rmse": found.cross_validated(),
                "blocks": found.cross_validation.tolist(),
                "note": "the structure of friction was chosen by the same blocks",
            },
            "parameters": [vars(p) for p in found.parameters],
            "links": [
                {**vars(link), "inertial": dict(zip(NAMES, row.tolist(), strict=True))}
                for link, row in zip(found.links, found.inertial, strict=False)
            ],
            "joints_friction": [
                {
                    "joint": j,
                    "coulomb": float(f[0]),
                    "viscous": float(f[1]),
                    "rotor_inertia": float(a),
                    "effects": list(e),
                }
                for j, f, a, e in zip(found.joints, found.simple_friction, found.armature, found.structure, strict=True)
            ],
            "noise": found.noise.tolist(),
            "alignment": None
            if found.alignment is None
            else {**vars(found.alignment), "samples": found.alignment.samples},
            "cutoff": found.cutoff,
            "rate": found.rate,
            "weighting": found.weighting,
            "advice": list(found.advice),
            "warnings": list(found.warnings),
            "notes": list(found.notes),
            "seconds": found.seconds,
        }
    )  # fmt: skip


def _errors(found: Identification, *, held_out: bool) -> dict[str, Any] | None:
    """Errors of the fitted, the consistent and the file's model; None where there is nothing of the kind."""
    chosen = found.held_out() if held_out else found.training()
    if not chosen:
        return None
    said: dict[str, Any] = {"recordings": list(dict.fromkeys(p.recording for p in chosen))}
    for which in ("fitted", "consistent", "file"):
        if all(getattr(p, which) is not None for p in chosen):
            said[which] = {
                "relative_error": relative_error(chosen, which),
                "relative_error_by_joint": relative_errors(chosen, which).tolist(),
                "rmse_by_joint": rmse(chosen, which).tolist(),
            }
    return said
