# SPDX-License-Identifier: Apache-2.0
"""The outcome of an identification as plain numbers and texts, for scripts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from trueup.formats.plain import finite
from trueup.identification.estimation.result import (
    Deliverable,
    Identification,
    relative_error,
    relative_errors,
    rmse,
)
from trueup.identification.inertial import NAMES
from trueup.rounding import TINY


def numbers_of(result: Identification, delivered: Sequence[Deliverable] = ()) -> dict[str, Any]:
    """SI units; null where there is no number. Errors are given for held-out motion and for the training data."""
    return finite(
        {
            "model": result.model_name,
            "joints": list(result.joints), "units": list(result.units),
            "deliverables": [_deliverable(d, result.joints) for d in delivered],
            "held_out": _errors(result, held_out=True),
            "training": _errors(result, held_out=False),
            "cross_validation": {
                "rmse": result.cross_validated(),
                "blocks": result.cross_validation.tolist(),
                "note": "the structure of friction was chosen by the same blocks",
            },
            "parameters": [vars(p) for p in result.parameters],
            "links": [
                {**vars(link), "inertial": dict(zip(NAMES, row.tolist(), strict=True))}
                for link, row in zip(result.links, result.for_file.inertial if result.for_file else (), strict=False)
            ],
            "formulas": list(result.model.formulas()),
            "effects": dict(zip(result.joints, map(list, result.structure), strict=True)),
            "in_the_model_file": None if (f := result.for_file) is None else [
                {"joint": joint, "coulomb": float(f.friction[j]), "viscous": float(f.damping[j]),
                 "rotor_inertia": float(f.armature[j])}
                for j, joint in enumerate(result.joints)
            ],
            "noise": result.noise.tolist(),
            "error_density": result.error_density().tolist(),
            "alignment": None
            if result.alignment is None
            else {**vars(result.alignment), "samples": result.alignment.samples},
            "cutoff": result.cutoff,
            "rate": result.rate,
            "weighting": result.weighting,
            "advice": list(result.advice),
            "warnings": list(result.warnings),
            "notes": list(result.notes),
            "seconds": result.seconds,
        }
    )  # fmt: skip


def _errors(result: Identification, *, held_out: bool) -> dict[str, Any] | None:
    """Errors of the fitted, the consistent and the file's model; None where there is nothing of the kind."""
    chosen = result.held_out() if held_out else result.training()
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


def _deliverable(d: Deliverable, joints: Sequence[str]) -> dict[str, Any]:
    """What a deliverable is for, and its errors: all, by joint, by log."""
    kinds = {"held_out": True, "training": False}
    seen = {name: held for name, held in kinds.items() if any(e.held_out == held for e in d.errors)}
    return {
        "name": d.name, "files": list(d.files), "use": d.use, "note": d.note or None,
        "largest_difference_from_fit": d.difference, "seconds_per_call": d.seconds,
        "relative_error": {name: d.relative(held_out=held) for name, held in seen.items()},
        "relative_error_by_joint": {
            name: dict(zip(joints, d.relative_by_joint(held_out=held).tolist(), strict=True)) for name, held in seen.items()
        },
        "by_log": [
            {"recording": e.recording, "held_out": e.held_out,
             "relative_error": float(np.sqrt(e.squares.sum() / max(e.power.sum(), TINY))),
             "rmse_by_joint": np.sqrt(e.squares / max(e.count, 1)).tolist()}
            for e in d.errors
        ],
    }  # fmt: skip
