# SPDX-License-Identifier: Apache-2.0
"""Makes the result of an identification from its parts: predictions, parameters with verdicts, links, what to mind."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from trueup.arrays import Array, Integers
from trueup.evidence import HALVED
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.estimation.balanced import Balance, balanced
from trueup.identification.estimation.consistent import ConsistentFit, violation, violations
from trueup.identification.estimation.diagnosis import AS_GOOD
from trueup.identification.estimation.estimate import Estimate
from trueup.identification.estimation.file_fit import FileFit
from trueup.identification.estimation.moments import Moments
from trueup.identification.estimation.pool import Pool
from trueup.identification.estimation.result import (
    Alignment,
    Identification,
    Link,
    Parameter,
    Prediction,
    relative_error,
)
from trueup.identification.estimation.selection import Choice
from trueup.identification.estimation.verdicts import advice, parameters_of
from trueup.identification.inertial import about_com
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.poses import link_poses
from trueup.identification.torque_model import TorqueModel
from trueup.instant import HARDLY, usual_step
from trueup.samples import MOST

if TYPE_CHECKING:
    from trueup.identification.estimation.motion import Piece, Torque


def outcome(
    tree: KinematicTree, pool: Pool, choice: Choice, estimate: Estimate, bodies: ConsistentFit | None,
    written: FileFit | None, pieces: Sequence[Piece], alignment: Alignment | None, *, carried: Array, moments: Moments,
    pull: float, nominal: Array, units: tuple[str, ...], cutoff: float, warnings: Sequence[str], rng: np.random.Generator,
    started: float,
) -> Identification:  # fmt: skip
    """The result. `nominal` (p,) are the file's parameters, `pull` what drew the consistent fit to them, `carried` (n, 10)
    the links that effects of load were computed from, `written` what a model file can hold.
    """
    model, active = pool.model, estimate.active
    given = TorqueModel.of_file(tree, units).torque if np.isfinite(tree.inertial).all() else None
    predictions = tuple(_prediction(p, tree, estimate.parameters, bodies, given) for p in pieces)
    parts = [p.rows for p in pieces if not p.held_out]
    held = None if written is None else _in_columns(pool, written)
    balance = balanced(pool, estimate, moments, nominal)
    shared = None if balance is None else np.abs(balance.shares)
    parameters = parameters_of(model, pool.base, estimate, parts, nominal, held, shared)
    errors = np.zeros((0, tree.n)) if choice.errors is None else np.sqrt(choice.errors / moments.count[:, None])
    made = Identification(
        model_name=tree.name, joints=tree.joints, prismatic=tuple(bool(x) for x in tree.prismatic),
        units=units, effort=np.asarray(tree.effort), parameters=parameters,
        links=_links(model, pool, estimate, written, nominal), predictions=predictions, noise=estimate.noise,
        cross_validation=errors, alignment=alignment, structure=_structure(model, active),
        model=TorqueModel.of(model, estimate.parameters, carried, units), for_file=written, cutoff=cutoff,
        rate=1.0 / usual_step(parts[0].time), weighting="each joint by its noise (weighted least squares)",
        trust=choice.strength, pull=pull, advice=advice(model, pool.base, parameters, rng),
        warnings=(
            *warnings, *_unsure(balance, parameters), *_warnings(predictions, alignment), *_thin(predictions, parameters),
        ),
        notes=_notes(tree, bodies, predictions),
        seconds=time.perf_counter() - started,
    )  # fmt: skip
    return made if all(unit.startswith("N") for unit in units) else _unweighed(made)


def _unweighed(result: Identification) -> Identification:
    """The result of logs of currents whose constants are not known: no number of a body is in kg."""
    bare = [joint for joint, unit in zip(result.joints, result.units, strict=True) if not unit.startswith("N")]
    logged = "loads" if result.unit == "units of load" else "currents"
    said = (
        f"the logs hold {logged} of {', '.join(bare)} and nothing says what torque they make: errors are in {result.unit}, "
        "no mass is in kg, and no model file is written. Give each joint's torque_constant in a drives file (--drives), or "
        "find them from runs with a payload that was weighed (--payload)"
    )
    parameters = tuple(replace(p, unit=f"{p.unit} x A/(N m)") for p in result.parameters)
    unlimited, warnings = np.full(len(result.joints), np.nan), (said, *result.warnings)
    return replace(result, parameters=parameters, links=(), for_file=None, warnings=warnings, effort=unlimited)


def _in_columns(pool: Pool, written: FileFit) -> Array:
    """(p,) what is written to a model file, at the columns of the pool; NaN for effects that it has no place for."""
    made = np.full(pool.model.p, np.nan)
    made[: written.inertial.size] = written.inertial.ravel()
    for kind, values in (("rotor", written.armature), ("coulomb", written.friction), ("viscous", written.damping)):
        made[list(pool.groups[kind])] = values
    return made


def _prediction(
    piece: Piece, tree: KinematicTree, fitted: Array, bodies: ConsistentFit | None, given: Torque | None
) -> Prediction:
    rows, motion = piece.rows, piece.motion
    return Prediction(
        recording=motion.name, held_out=piece.held_out, time=rows.time, measured=rows.torque,
        fitted=rows.predict(fitted), consistent=None if bodies is None else rows.predict(bodies.parameters),
        file=None if given is None else piece.predicted(given), position=motion.q, velocity=motion.v,
        reach=link_poses(tree, motion.q)[1][:, -1], by=piece.predicted,
    )  # fmt: skip


def _links(
    model: DynamicModel, pool: Pool, estimate: Estimate, written: FileFit | None, nominal: Array
) -> tuple[Link, ...]:
    if written is None:
        return ()
    nearest = pool.base.full(pool.base.of(estimate.parameters), nominal)
    impossible, made = violations(model, nearest), []
    for j, name in enumerate(model.tree.links):
        row = written.inertial[j]
        mass, com, inertia = about_com(row)
        said = impossible.get(j, "") if j in written.boundary else ""
        x, y, z = (float(c) for c in com)
        small, middle, large = (float(m) for m in np.linalg.eigvalsh(inertia))
        made.append(Link(name, mass, (x, y, z), (small, middle, large), j in written.boundary, said))
    return tuple(made)


def _structure(model: DynamicModel, active: Integers) -> tuple[tuple[str, ...], ...]:
    """For each drive its effects in words, without repeating one kind."""
    said: list[list[str]] = [[] for _ in model.tree.joints]
    for d, effect in (model.effect(int(k)) for k in active):
        if effect is not None:
            said[d].append(effect.short)
    return tuple(tuple(dict.fromkeys(each)) for each in said)


def _warnings(predictions: Sequence[Prediction], alignment: Alignment | None) -> list[str]:
    said = []
    if not any(p.held_out for p in predictions):
        said.append(
            "nothing was held out: the errors below are those of a fit to the data it was made from, and too small. "
            "Give a recording of another motion (--hold-out), or keep the end of each (--hold-out 30%)"
        )
    if alignment is not None and abs(alignment.shift) > 2.0 * alignment.deviation and alignment.corrected:
        late = "later" if alignment.shift > 0 else "earlier"
        said.append(
            f"torque was logged {1e3 * abs(alignment.shift):.2g} +- {1e3 * alignment.deviation:.1g} ms "
            f"({abs(alignment.samples):.3g} samples) {late} than the position that it belongs to; this was corrected "
            f"(squared error {100 * alignment.gain:.0f} % smaller). Look for a filter or a queue in the logger"
        )
    return said


def _unsure(balance: Balance | None, parameters: Sequence[Parameter]) -> list[str]:
    """What to say of a spring where what is known of bodies hangs on it."""
    return [str(balance)] if balance and any(p.kind == "inertial" and p.verdict == "shared" for p in parameters) else []


def _thin(predictions: Sequence[Prediction], parameters: Sequence[Parameter]) -> list[str]:
    """What to say where the logs excite too little for the model that they are asked for."""
    inertial = [p for p in parameters if p.kind == "inertial"]
    unseen = sum(p.verdict == "not seen" for p in inertial)
    held = [p for p in predictions if p.held_out]
    fitted = [p for p in predictions if not p.held_out]
    trained, said = relative_error(fitted), []
    if unseen > MOST * len(inertial):
        said.append(
            f"too little excitation: {unseen} of {len(inertial)} combinations of inertial parameters cannot be told from "
            "these logs (below: which, and which motion would show them); outside the motions fitted the model may be far off"
        )
    if held and HALVED * relative_error(held) > trained:
        said.append(
            f"held-out motion is predicted {relative_error(held) / trained:.0f} times worse than the fitted one: "
            f"{unlike(fitted, held) or 'the logs that were fitted are too short or too unlike it. Add motion of that kind'}"
        )
    return said


def unlike(fitted: Sequence[Prediction], held: Sequence[Prediction]) -> str:
    """How held-out motion differs from the fitted one where most of the error is; nothing where it does not."""
    known = (np.concatenate([p.position for p in fitted]), np.abs(np.concatenate([p.velocity for p in fitted])))
    asked = (np.concatenate([p.position for p in held]), np.abs(np.concatenate([p.velocity for p in held])))
    square = np.concatenate([p.measured - p.fitted for p in held]) ** 2
    square = square / np.mean(np.concatenate([p.measured for p in held]) ** 2, axis=0)  # joints as far as they are off
    low, high = np.quantile(known[0], [0.005, 0.995], axis=0)
    slow, fast = np.quantile(known[1], 0.99, axis=0) * HARDLY, np.quantile(known[1], 0.995, axis=0)
    kinds = (
        ("where joints hardly turn", "slow moves with reversals and pauses", lambda q, v: v < slow),
        ("where joints are faster than any fitted", "moves that fast", lambda q, v: v > fast),
        ("in positions beyond those fitted", "motion that reaches there", lambda q, v: (q < low) | (q > high)),
    )
    found = []
    for where, add, there in kinds:
        now, before = there(*asked), there(*known)
        share = float(square[now].sum() / square.sum())
        if share > 0.5 and now.mean() > 2.0 * before.mean():
            found.append((share, f"{100 * share:.0f} % of the error is {where}, which is {100 * now.mean():.0f} % of it and "
                          f"{100 * before.mean():.0f} % of what was fitted. Add {add}"))  # fmt: skip
    return max(found)[1] if found else ""


def _notes(tree: KinematicTree, bodies: ConsistentFit | None, predictions: Sequence[Prediction]) -> tuple[str, ...]:
    said = list(tree.notes)
    filed = {j: np.asarray(row) for j, row in enumerate(tree.inertial) if np.isfinite(row).all()}
    wrong = [f"{tree.links[j]} ({why})" for j, row in filed.items() if (why := violation(row))]
    if wrong:
        said.append(
            f"the model file gives bodies that cannot exist: {', '.join(wrong)}. Torque was identified all the same"
        )
    if not np.isfinite(tree.inertial).all():
        said.append("the model file gives no inertia for some links: bodies of 1 kg stand for what torque cannot tell")
    if bodies is not None:
        said += [_lag(tree, bodies)] if bodies.lagging else []
        judged = [p for p in predictions if p.held_out] or list(predictions)
        free, possible = relative_error(judged), relative_error(judged, "consistent")
        if possible > AS_GOOD * free:
            said.append(
                f"keeping all links physically possible costs accuracy: {100 * possible:.2f} % instead of "
                f"{100 * free:.2f} %. Something other than rigid links pushes the fit there: friction, elasticity, "
                "a wrong length or mounting (--gravity) in the model"
            )
    return tuple(said)


def _lag(tree: KinematicTree, bodies: ConsistentFit) -> str:
    names = ", ".join(tree.joints[d] for d in bodies.lagging)
    return (
        f"torque of {names} falls with acceleration, which no rotor and no body does: friction that comes behind its speed, "
        "or a late log. A term of its own carries it in the predictions; the model file has bodies and rotors without it"
    )
