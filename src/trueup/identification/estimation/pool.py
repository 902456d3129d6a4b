# SPDX-License-Identifier: Apache-2.0
"""All effects that a drive may show, scaled to the motion at hand, and the steps in which they are tried."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array, Integers, Mask
from trueup.errors import IdentificationError
from trueup.identification.base_parameters import BaseParameters
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.effects import OF_LOAD, SPRINGS, WAVES, Effect
from trueup.identification.estimation.moments import RIDGE, Moments
from trueup.identification.estimation.motion import Motion, Piece
from trueup.identification.estimation.selection import Choice, cross_validated, forward_selected, reweighed
from trueup.identification.inertial import from_com
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.rows import Rows
from trueup.rounding import PRINTED

_SPEEDS = (0.003, 0.01, 0.03, 0.1, 0.3)
"""Of a drive's top speed: where friction that saturates does so."""
_USUAL = _SPEEDS[1]
BASIC = ("rotor", "offset", "viscous", f"saturating {_USUAL:g}")
STRUCTURES = ("select", "paper", "common")


@dataclass(frozen=True, eq=False)
class Pool:
    """A model with every candidate effect; `groups` are those of the same kind and scale, one a drive."""

    model: DynamicModel
    groups: dict[str, tuple[int, ...]]
    """Name -> column of each drive."""
    base: BaseParameters
    independent: Mask
    """(p,) columns that torque can tell apart."""
    springs: tuple[str, ...]
    """What balances each joint, of `effects.SPRINGS`; "" where nobody says."""

    def columns(self, *names: str) -> list[int]:
        """The independent columns of groups."""
        return [k for name in names for k in self.groups[name] if self.independent[k]]

    def with_groups(self, *names: str) -> Mask:
        """(p,) all inertial combinations, these groups, and the springs that were declared."""
        mask = self.independent.copy()
        mask[10 * self.model.tree.n :] = False
        mask[self.columns(*names)] = True
        for joint, spring in enumerate(self.springs):
            mask[self.spring_at(joint, spring)] = True
        return mask

    @property
    def tied(self) -> Integers:
        """Columns of declared struts that torque cannot tell from weight: what stands for both is a combination of bodies."""
        declared = [
            self.groups[kind][j] for j, spring in enumerate(self.springs) if spring == "strut" for kind in WAVES
        ]
        return np.array([k for k in declared if not self.independent[k]], dtype=np.int64)

    def spring_at(self, joint: int, spring: str) -> list[int]:
        """The independent columns of one form of spring at a joint."""
        found = [self.groups[kind][joint] for kind in SPRINGS[spring or "none"]]
        return [k for k in found if self.independent[k]]

    def carried_links(self, parameters: Array) -> Array:
        """(n, 10) bodies of the links that gears carry, nearest to those of the file that parameters (p,) of a fit allow."""
        full = self.base.full(self.base.of(parameters), nominal_of(self.model))
        return full[: 10 * self.model.tree.n].reshape(-1, 10)

    def prior(self, nominal: Array) -> Array:
        """(p,) the base parameters of the file, of what it says (`nominal`, (p,)), at their columns, zero elsewhere."""
        prior = np.zeros(self.model.p)
        prior[10 * self.model.tree.n :] = nominal[10 * self.model.tree.n :]
        prior[self.base.independent] = self.base.of(nominal)
        return prior

    def basic(self) -> tuple[DynamicModel, Integers]:
        """A model that fits any arm roughly (rotors, offsets, viscous and Coulomb friction), and its independent columns."""
        active = np.flatnonzero(self.with_groups(*BASIC))
        first = 10 * self.model.tree.n
        model = self.model.only((active[active >= first] - first).tolist())
        return model, np.concatenate([active[active < first], np.arange(first, model.p)])

    def forms(self) -> list[str]:
        """Groups that may be the Coulomb friction."""
        return ["coulomb", *(f"saturating {s:g}" for s in _SPEEDS)]


def pool_for(
    tree: KinematicTree, drives: Array, motions: Sequence[Motion], *, gains: bool = False, springs: Sequence[str] = ()
) -> Pool:
    """Every effect of every drive, with speeds and travels taken from what the drives do in `motions`; their own scale only
    with `gains`. `springs` are those of `Drives`; one in the model file is declared there.
    """
    effects, groups = _every_effect(tree, drives, motions, gains=gains)
    model = DynamicModel.of(tree, effects, drives)
    known = _declared(tree, springs)
    waves = [groups[kind][j] for j, spring in enumerate(known) if spring == "strut" for kind in WAVES]
    base = _base(model, waves)
    independent = np.ones(model.p, dtype=bool)
    independent[[*range(12 * tree.n), *waves]] = False
    independent[base.independent] = True
    same = [groups["spring"][j] for j, spring in enumerate(known) if SPRINGS[spring or "none"]]
    independent[same] = False
    independent[list(groups["lag"])] = False  # beside rotors that may not be negative only, see bodies.py
    return Pool(model, groups, base, independent, known)


def _declared(tree: KinematicTree, springs: Sequence[str]) -> tuple[str, ...]:
    """What balances each joint. Raises IdentificationError for a strut at a joint that slides."""
    for joint, slides, spring in zip(tree.joints, tree.prismatic, springs, strict=False):
        if slides and spring == "strut":
            raise IdentificationError(
                f"joint '{joint}' slides, and no strut turns it: choices of spring: torsion (in proportion to its way), none"
            )
    filed = zip(springs or ("",) * tree.n, tree.stiffness, strict=True)
    return tuple(spring or ("torsion" if stiffness else "") for spring, stiffness in filed)


def _every_effect(
    tree: KinematicTree, drives: Array, motions: Sequence[Motion], *, gains: bool
) -> tuple[list[tuple[int, Effect]], dict[str, tuple[int, ...]]]:
    """(drive, effect) of all columns behind those of bodies, and the columns of each group."""
    speed = np.concatenate([np.abs(m.v @ drives.T) for m in motions])
    place = np.concatenate([m.q @ drives.T for m in motions])
    top, span = (np.maximum(x, PRINTED) for x in (np.quantile(speed, 0.99, axis=0), np.ptp(place, axis=0)))
    effects: list[tuple[int, Effect]] = []
    groups: dict[str, tuple[int, ...]] = {}

    def add(name: str, kind: str, scales: Array | None = None) -> None:
        start = 10 * tree.n + len(effects)
        effects.extend((d, Effect(kind, float("nan") if scales is None else float(scales[d]))) for d in range(tree.n))
        groups[name] = tuple(range(start, start + tree.n))

    friction = ("viscous", "coulomb", "quadratic", "root", "asymmetric")
    for kind in ("rotor", "offset", *friction, "spring", *SPRINGS["strut"]):
        add(kind, kind)
    for s in _SPEEDS:
        add(f"saturating {s:g}", "saturating", s * top)
    for s in _SPEEDS[1:]:  # as shares of a drive's range, over which hysteresis builds up after a reversal
        add(f"hysteresis {s:g}", "hysteresis", s * span)
    add("load", "load", _USUAL * top)
    if gains:
        add("gain", "gain")
    add("lag", "lag")
    return effects, groups


def nominal_of(model: DynamicModel) -> Array:
    """(p,) what the file says, with a body of 1 kg where it says nothing: where the consistent fit looks first."""
    inertial = np.array(model.tree.inertial)
    unknown = ~np.isfinite(inertial).all(axis=1) | (inertial[:, 0] <= 0.0)
    inertial[unknown] = from_com(1.0, np.zeros(3), np.eye(3) / 100.0)
    return replace(model, tree=model.tree.replace(inertial=inertial)).nominal()


def with_load_columns(pool: Pool, pieces: Sequence[Piece], bodies: Array) -> list[Piece]:
    """The pieces with the effects of load, for links `bodies` (n, 10) that a first fit found.

    Columns are made where the motion is still sampled finely and then filtered, as all others are.
    """
    made, columns = [], dict[int, dict[int, Array]]()
    for p in pieces:
        if id(p.whole) not in columns:
            columns[id(p.whole)] = {k: p.passed(c) for k, c in _of_load(pool.model, p.whole, bodies).items()}
        values = [np.array(v) for v in p.rows.values]
        for k, column in columns[id(p.whole)].items():
            own = pool.model.drives[pool.model.effect(k)[0]]
            for j in np.flatnonzero(own):
                values[j][int(np.flatnonzero(p.rows.columns[j] == k)[0])] = own[j] * column[p.keep]
        made.append(replace(p, rows=replace(p.rows, values=tuple(values))))
    return made


def kinds_of(pool: Pool, pieces: Sequence[Piece]) -> list[Rows]:
    """What is fitted, in sixteen kinds of motion: each joint's samples by what its own drive does, zeros behind the fewer.

    Its states are halved and halved again in their middle, by speed twice, by position, by acceleration: fast or slow, forth
    or back, here or there, speeding up or not. J. Bentley, "Multidimensional binary search trees", 1975.
    """
    fitted = [p for p in pieces if not p.held_out]
    q, v, a = (np.concatenate([getattr(p.motion, x) @ pool.model.drives.T for p in fitted]) for x in ("q", "v", "a"))
    kinds = np.zeros(v.shape, dtype=np.int64)
    for x in (v, v, q, a):
        middle = [{k: np.median(x[own == k, j]) for k in np.unique(own)} for j, own in enumerate(kinds.T)]
        kinds = 2 * kinds + (
            x > np.stack([[m[k] for k in own] for m, own in zip(middle, kinds.T, strict=True)], axis=1)
        )
    values = [np.concatenate(each, axis=1) for each in zip(*(p.rows.values for p in fitted), strict=True)]
    torque, parts = np.concatenate([p.rows.torque for p in fitted]), list[Rows]()
    for k in np.unique(kinds):
        first = np.argsort(kinds != k, axis=0, kind="stable")[: int(np.sum(kinds == k, axis=0).max())]
        inside = np.take_along_axis(kinds == k, first, axis=0)
        own = tuple(x[:, first[:, j]] * inside[:, j] for j, x in enumerate(values))
        told = np.take_along_axis(torque, first, axis=0) * inside
        parts.append(replace(fitted[0].rows, values=own, torque=told, time=np.arange(len(told), dtype=float)))
    return parts


def _of_load(model: DynamicModel, motion: Motion, bodies: Array) -> dict[int, Array]:
    """Column -> (S,) torque of one unit of each effect of load at its drive."""
    carried = model.carried(bodies, motion.q, motion.v, motion.a)
    speed = motion.v @ model.drives.T
    return {
        int(k): effect.column(speed[:, d], speed[:, d], speed[:, d], load=carried[:, d])
        for k, (d, effect) in ((k, model.effects[int(k) - 10 * model.tree.n]) for k in model.columns_of(*OF_LOAD))
    }


def _base(model: DynamicModel, waves: Sequence[int]) -> BaseParameters:
    """Groups of links, rotors, offsets and of struts (`waves`, columns): no other effect has a form that bodies have."""
    n = model.tree.n
    columns = np.concatenate([np.arange(12 * n), np.asarray(waves, dtype=np.int64)])
    part = model.only((columns[10 * n :] - 10 * n).tolist())
    base = part.base(np.repeat([2.0, 1.0, 0.0], [10 * n, n, n + len(waves)]))
    wide = np.zeros((base.rank, model.p))
    wide[:, columns] = base.grouping
    return BaseParameters(model.names, columns[base.independent], wide, base.gap)


def select_structure(pool: Pool, moments: Moments, prior: Array, structure: str = "select") -> Choice:
    """The model that predicts best: Coulomb friction's form, then effects of all drives, then of single ones, then weights.

    `structure` 'paper' (f0 sign + f1 v + f2 sign v^2, evolved trajectories, eq. 2) or 'common' (Coulomb, viscous, offset)
    fixes the effects instead.
    """
    start = {
        "paper": ("rotor", "coulomb", "viscous", "quadratic"),
        "common": ("rotor", "coulomb", "viscous", "offset"),
        "select": BASIC,
    }[structure]
    choice = reweighed(moments, prior, Choice(pool.with_groups(*start), RIDGE, np.ones(pool.model.tree.n)))
    if structure != "select":
        return choice
    forms = [replace(choice, active=pool.with_groups(*start[:-1], form)) for form in pool.forms()]
    choice = min(cross_validated(moments, prior, *forms), key=lambda c: c.loss)
    # Springs come first: what stands in for one is harder to tell from friction.
    choice = forward_selected(moments, prior, reweighed(moments, prior, choice), _undeclared(pool))
    more = [name for name in pool.groups if name not in ("rotor", "offset", "viscous", *SPRINGS["strut"])]
    groups = [pool.columns(name) for name in more]
    groups = [g for k in groups if (g := [c for c in k if not choice.active[c]])]
    choice = forward_selected(moments, prior, reweighed(moments, prior, choice), groups)
    singles = [[k] for name in more for k in pool.columns(name) if not choice.active[k]]
    choice = forward_selected(moments, prior, reweighed(moments, prior, choice), singles)
    return reweighed(moments, prior, choice)


def _undeclared(pool: Pool) -> list[list[int]]:
    """Springs where nobody says whether there is one: of torsion, or as weight; both together are a strut."""
    open_ = [j for j, spring in enumerate(pool.springs) if not spring and not pool.model.tree.prismatic[j]]
    return [[pool.groups[kind][j] for kind in kinds] for j in open_ for kinds in (("spring",), WAVES)]
