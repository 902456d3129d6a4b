# SPDX-License-Identifier: Apache-2.0
"""What the recordings could tell of each combination of parameters, and which motion would tell the rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trueup.arrays import Array
from trueup.errors import listed
from trueup.identification.base_parameters import BaseParameters
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.effects import SPRINGS
from trueup.identification.estimation.estimate import Estimate
from trueup.identification.estimation.result import Parameter
from trueup.identification.rows import Rows
from trueup.rounding import TINY
from trueup.samples import SLIGHT, rms

SURE, ROUGH = 0.1, 0.5
"""Relative standard deviations up to which a parameter is identified, or roughly."""
_SHARED = ("saturating", "hysteresis", "quadratic", "root", "asymmetric", "offset", "load", "spring", *SPRINGS["strut"])
"""Effects that were kept because they predict, of which one may stand for another."""


def parameters_of(
    model: DynamicModel, base: BaseParameters, estimate: Estimate, rows: Sequence[Rows], file: Array,
    consistent: Array | None, shared: Array | None = None,
) -> tuple[Parameter, ...]:  # fmt: skip
    """One Parameter for each column that was fitted, with its verdict. `file` and `consistent` are full vectors (p,), as is
    `shared`: what a spring that nobody declared may take part in.
    """
    tree, known = model.tree, np.isfinite(model.tree.inertial).all()
    rows_of = {int(k): i for i, k in enumerate(base.independent)}
    shares, deviations, made = _shares(rows), estimate.deviations, []
    # Coulomb friction, and what sets in with speed beside it, make up one curve of the same drive.
    parted = {
        owner for owner, effect in map(model.effect, map(int, estimate.active)) if effect and effect.kind in _SHARED
    }
    for k in map(int, estimate.active):
        group = rows_of.get(k)
        owner, effect = model.effect(k)
        kind = effect.kind if effect else "inertial"
        row = base.grouping[group] if group is not None else np.eye(model.p)[k]
        value, deviation = float(estimate.parameters[k]), float(deviations[k])
        wide = deviation if shared is None else float(np.hypot(deviation, shared[k]))
        apart = kind in _SHARED or (kind == "coulomb" and owner in parted)
        alone, verdict = (_verdict(value, x, float(shares[k]), apart) for x in (deviation, wide))
        made.append(
            Parameter(
                name=model.names[k] if group is None else base.names[group], unit=model.units[k], kind=kind,
                joint=tree.joints[owner], value=value, deviation=wide,
                file=float(row @ file) if known and kind in ("inertial", "rotor") else np.nan,
                consistent=np.nan if consistent is None else float(row[row != 0.0] @ consistent[row != 0.0]),
                verdict=verdict if verdict == alone else "shared", note=effect.short if effect else "",
            )
        )  # fmt: skip
    return tuple(made)


def advice(
    model: DynamicModel, base: BaseParameters, parameters: Sequence[Parameter], rng: np.random.Generator
) -> tuple[str, ...]:
    """Sentences on what was not seen, and the kind of motion in which it would add most torque."""
    names = dict(zip(base.names, base.independent.tolist(), strict=True))
    missing = [p for p in parameters if p.verdict == "not seen" and p.kind in ("inertial", "rotor") and p.name in names]
    friction = [p for p in parameters if p.verdict == "not seen" and p.kind in ("viscous", "coulomb")]
    by_motion: dict[str, list[str]] = {}
    shown = _motions(model, rng) if missing else {}
    for p in missing:
        best = max(shown, key=lambda motion: shown[motion][names[p.name]])
        by_motion.setdefault(best, []).append(p.name)
    said = [f"not seen: {listed(found)}. {motion}" for motion, found in by_motion.items()]
    for joint in dict.fromkeys(p.joint for p in friction):
        own = [f"{p.name} ({p.kind})" for p in friction if p.joint == joint]
        said.append(
            f"not seen: {listed(own)}. Move {joint} both ways at several steady speeds, from very slow to its top speed, "
            "with hard reversals"
        )
    return tuple(said)


def _verdict(value: float, deviation: float, share: float, apart: bool) -> str:
    relative = deviation / abs(value) if value else np.inf
    if relative <= SURE:
        return "identified"
    if (abs(value) + 2.0 * deviation) * share < SLIGHT:  # of the torque that its joint carries in these motions
        return "small"
    return "roughly" if relative <= ROUGH else "shared" if apart else "not seen"


def _shares(rows: Sequence[Rows]) -> Array:
    """(p,) torque that one unit of each column adds, over what the joint carries; at the joint that it serves most."""
    total, load = np.zeros((len(rows[0].values), rows[0].p)), np.zeros(len(rows[0].values))
    for r in rows:
        load += np.sum(r.torque**2, axis=0)
        for j, (c, v) in enumerate(zip(r.columns, r.values, strict=True)):
            total[j, c] += np.sum(v**2, axis=1)
    return np.sqrt(np.max(total / np.maximum(load, TINY)[:, None], axis=0))


def _motions(model: DynamicModel, rng: np.random.Generator) -> dict[str, Array]:
    """Motion in words -> (p,) the torque that one unit of each column adds to what gravity alone shows, over the limits."""
    tree, trials = model.tree, 40
    part = model.only(range(tree.n))  # the rotors, which a pool has first
    q = rng.uniform(-np.pi, np.pi, (trials, tree.n))
    still, load = np.zeros_like(q), np.where(np.isfinite(tree.effort), tree.effort, 1.0)[:, None]
    speed = np.where(np.isfinite(tree.speed), tree.speed, 2.0)

    def shares_of_load(v: Array, a: Array) -> Array:
        shares = part.rows(np.arange(trials, dtype=float), q, v, a).dense() / load
        return rms(shares, axis=(0, 1))

    gravity = shares_of_load(still, still)
    shown = {"Hold or slowly move through many different poses: gravity shows it": gravity}
    for j, joint in enumerate(tree.joints):
        one = np.zeros_like(q)
        one[:, j] = speed[j]
        shown[f"Accelerate {joint} harder, in different poses of the other joints"] = (
            shares_of_load(still, one / 0.4) - gravity
        )
        shown[f"Turn {joint} fast while others move"] = shares_of_load(one, still) - gravity
    return shown
