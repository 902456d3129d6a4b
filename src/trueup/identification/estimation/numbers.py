# SPDX-License-Identifier: Apache-2.0
"""An identification as plain numbers and texts, for scripts."""

from __future__ import annotations

from typing import Any

from trueup.formats.plain import finite
from trueup.identification.estimation.result import Identification, relative_error, relative_errors, rmse
from trueup.identification.inertial import NAMES


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
