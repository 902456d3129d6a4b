# SPDX-License-Identifier: Apache-2.0
"""Whether the base stands as the model file has it: a turn of gravity, asked of the torque beside all that explains it.

The torque of links is linear in gravity. Its slope with respect to a small turn of the base, at the estimate, is one column
for each axis of it; what these columns add to a model that was chosen without them is a score test (C. R. Rao, "Large
sample tests of statistical hypotheses", 1948), judged here as all structure is: on blocks of time that the fit did not see.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.arrays import Array, Integers
from trueup.evidence import Evidence, half_interval, jackknife
from trueup.identification.estimation.beside_choice import (
    left_out_errors,
    links_of,
    solved,
    solved_without_each,
    with_columns,
)
from trueup.identification.estimation.modelled import Modelled, fitted_blocks
from trueup.identification.estimation.moments import Moments, moments_of
from trueup.identification.estimation.motion import Motion, Piece
from trueup.identification.estimation.pool import Pool
from trueup.identification.estimation.quick import FURTHEST
from trueup.identification.estimation.selection import Choice, compared
from trueup.identification.kinematic_tree import KinematicTree, exponential
from trueup.identification.regressors import inverse_dynamics
from trueup.identification.rows import Rows
from trueup.inspection.diagnosis import Diagnosis
from trueup.rounding import TINY

NAME = "lean"
"""By which it may be refused."""
_STEP = float(np.cbrt(np.finfo(np.float64).eps))
"""rad (m) by which a joint is moved for the slope of torque in its zero: where rounding and curvature err alike."""
Cut = Callable[[Sequence[Piece]], list[Rows]]
"""Pieces to the blocks of time that are left out in turn."""


@dataclass(frozen=True, eq=False)
class Lean:
    """How far the base is turned from how the tree has it, and what left-out blocks say of that."""

    turn: Array
    """(3,) rad in the base frame: the base leans by it."""
    covariance: Array
    """(3, 3)."""
    parts: int
    """Blocks that it is known from."""
    alone: Evidence
    """Of the turn, beside the model that was chosen without it."""
    beside_zeros: Evidence
    """The same where the zeros of all joints may be others, too."""
    zeros: Evidence
    """Of other zeros in its place."""

    def applied(self, tree: KinematicTree) -> KinematicTree:
        """The tree on a base that leans so."""
        return tree.replace(gravity=exponential(-self.turn) @ tree.gravity)

    def deviation(self, about: Array) -> float:
        """Standard deviation of the turn about a unit vector (3,), rad."""
        return float(np.sqrt(about @ self.covariance @ about))

    @property
    def there(self) -> bool:
        """Whether it is more than what chance makes of none."""
        size = float(np.linalg.norm(self.turn))
        return size > self.deviation(self.turn / max(size, TINY))


def as_it_leans(
    tree: KinematicTree, modelled: Callable[[KinematicTree], Modelled], margin: float, refuse: Collection[str]
) -> tuple[KinematicTree, list[str]]:
    """The tree on its base as it leans where the model of torque predicts left-out blocks clearly better so, and a note.

    Where other zeros of joints explain the same, both are named and neither is taken, unless it is one in torque, as where
    the base turns about the axis of the first joint.
    """
    level = modelled(tree)
    lean = _beside(level, margin)
    if lean is None or not lean.alone.holds or (lean.zeros.holds and not lean.beside_zeros.holds):
        return tree, []
    leant, last = lean.applied(tree), lean
    # Slopes are taken again where gravity then points, while more is left than chance makes of none and errors fall.
    while (rest := _beside(modelled(leant), margin, leans=True)) is not None and rest.there:
        further = rest.applied(leant)
        if not modelled(further)[-1][-1].against(modelled(leant)[-1][-1]).gain > 0.0:
            break
        leant, last = further, rest
    evidence = modelled(leant)[-1][-1].against(level[-1][-1])
    if not evidence.holds:
        return tree, []
    sure = lean.beside_zeros.holds
    first = "" if sure else _same_as_zero_of(tree, lean)
    found = Diagnosis(NAME, *_in_words(tree, leant, last, evidence, first, sure=sure)).unless(refuse)
    return (leant if (sure or first) and not found.refused else tree), [str(found)]


def _same_as_zero_of(tree: KinematicTree, lean: Lean) -> str:
    """The first joint of an arm, where another zero of it turns gravity as the base does; else ''."""
    roots = np.flatnonzero(tree.parent < 0)
    if len(roots) > 1 or tree.prismatic[0]:
        return ""
    down, axis = tree.gravity / np.linalg.norm(tree.gravity), tree.rotation[0] @ tree.axis[0]
    own = axis - (axis @ down) * down
    own = own / max(float(np.linalg.norm(own)), TINY)
    rest = lean.turn - (lean.turn @ own) * own
    size = float(np.linalg.norm(rest))
    chance = half_interval(lean.parts) * lean.deviation(rest / max(size, TINY))
    return tree.joints[0] if size < chance else ""


def _in_words(
    tree: KinematicTree, leant: KinematicTree, last: Lean, evidence: Evidence, first: str, *, sure: bool
) -> tuple[str, str]:
    """What is seen of a base that leans, and what is done about it; `first` is a joint whose zero would do the same."""
    before, now = (t.gravity / np.linalg.norm(t.gravity) for t in (tree, leant))
    across = np.cross(now, before)
    angle = float(np.arctan2(np.linalg.norm(across), now @ before))
    wide = half_interval(last.parts) * last.deviation(across / max(float(np.linalg.norm(across)), TINY))
    low, high = (float(np.degrees(max(angle + sign * wide, 0.0))) for sign in (-1.0, 1.0))
    downhill = now - (now @ before) * before
    x, y, z = (f"{round(float(c), 2) + 0.0:.2f}" for c in downhill / max(float(np.linalg.norm(downhill)), TINY))
    gravity = " ".join(f"{round(float(g), 3) + 0.0:g}" for g in leant.gravity)
    how = (
        f"the base leans {np.degrees(angle):.3g} deg [{low:.3g}, {high:.3g}] from how the model has it, down towards "
        f"({x}, {y}, {z}) of its frame (errors on stretches that were left out are {evidence.in_words()})"
    )
    taken = (
        f"it was identified with --gravity {gravity}. Say with --gravity what is measured, or keep what the model says with "
        f"--refuse {NAME}"
    )
    if sure:
        return how, taken
    if first:
        return f"either {how}, or {first} has another zero than the model, which makes the same torque", taken
    return (
        f"either {how}, or joints have other zeros than the model: these logs do not tell which. Look at both: --gravity "
        f"{gravity} is for a base that leans, offset in a drives file for a joint's zero"
    ), ""


def _beside(modelled: Modelled, margin: float, *, leans: bool = False) -> Lean | None:
    pool, _, _, (pieces, _, _, choice) = modelled
    return leaning(pool, pieces, lambda made: fitted_blocks(made, margin), choice, leans=leans)


def leaning(pool: Pool, pieces: Sequence[Piece], cut: Cut, choice: Choice, *, leans: bool = False) -> Lean | None:
    """The lean of the base beside a model that was chosen; None where no motion tells one, or nothing weighs.

    Three kinds of columns are added: the slopes of torque with respect to the base's turn about two axes across gravity; the
    zeros of joints; and torque that comes again with each turn of a joint, in the model without a lean too. What turns about
    a vertical axis has moments that show only where that leans, in its own torque, and so cannot be told from cables,
    sensors and gears that do the same: a lean must show in how the others' weight moves. Once it does (`leans`) it is
    estimated beside other zeros in the place of these, which would hide much of what joints carry.
    """
    tree, active = pool.model.tree, np.flatnonzero(choice.active)
    if not np.linalg.norm(tree.gravity) > 0.0:
        return None
    axes = np.linalg.svd(tree.gravity[None])[2][1:]
    fitted = [p for p in pieces if not p.held_out]
    links = links_of(pool, moments_of(cut(fitted)), choice)

    def further(motion: Motion) -> Array:
        made = _ripples(tree, motion), _zeros(tree, links, motion), _slopes(tree, links, axes, motion)
        return np.concatenate(made, axis=2)

    moments = moments_of(cut(with_columns(fitted, active, further)))
    last = len(moments.scale)
    level, zeros = np.arange(last - 2 - tree.n), np.arange(last - 2 - tree.n, last - 2)
    own = np.arange(np.count_nonzero(choice.active))
    told = _well_known(moments, choice, np.append(own, zeros) if leans else level)
    if told is None:
        return None
    masks = [level, np.append(level, zeros)]
    masks += [np.append(each, told.columns) for each in masks]
    plain, other, alone, both = left_out_errors(told.moments, choice, masks)
    return Lean(
        told.along @ axes, axes.T @ told.covariance @ axes, len(moments.count), compared(alone, plain), compared(both, other),
        compared(other, alone),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _WellKnown:
    """What is told of a turn about two axes: moments whose last two columns are of axes so chosen that they err apart."""

    moments: Moments
    columns: Integers
    """Of the last two, those that are told."""
    along: Array
    """(2,) rad about the axes that were asked for."""
    covariance: Array


def _well_known(moments: Moments, choice: Choice, beside: Integers) -> _WellKnown | None:
    """The directions of a turn, of which the last two columns are, that are known to better than `FURTHEST`."""
    last = len(moments.scale) - 2 + np.arange(2)
    each = solved_without_each(moments, choice, np.append(beside, last))[:, -2:]
    deviations = (each - each.mean(axis=0)) * np.sqrt((len(each) - 1) / len(each))
    sizes, across = np.linalg.eigh(deviations.T @ deviations)
    sure = half_interval(len(each)) * np.sqrt(sizes) < FURTHEST
    if not sure.any():
        return None
    turned, known = _turned(moments, last, across), int(sure.sum())
    used = np.append(beside, last[sure])
    along = np.zeros(2)
    along[sure] = solved(turned, choice, used)[-known:]
    errors = np.full(2, FURTHEST)
    errors[sure] = jackknife(solved_without_each(turned, choice, used)[:, -known:])
    return _WellKnown(turned, last[sure], across @ along, (across * errors**2) @ across.T)


def _turned(moments: Moments, turns: Integers, across: Array) -> Moments:
    """Moments with two columns replaced by combinations of them, (2, 2) `across`."""
    p = len(moments.scale)
    T = np.eye(p)
    # Columns are scaled; those that are combined as they are, in rad.
    T[np.ix_(turns, turns)] = moments.scale[turns, None] * across
    gram, cross = T.T @ moments.gram @ T, moments.cross @ T
    scale = moments.scale.copy()
    scale[turns] = 1.0
    return replace(moments, gram=gram, cross=cross, scale=scale)


def _slopes(tree: KinematicTree, links: Array, axes: Array, motion: Motion) -> Array:
    """(S, n, 2) torque for a turn of the base about each of two axes by a unit angle, of links (n, 10)."""
    still = np.zeros_like(motion.q)
    turned = (tree.replace(gravity=np.cross(-axis, tree.gravity)) for axis in axes)
    return np.stack([inverse_dynamics(t, links, motion.q, still, still) for t in turned], axis=-1)


def _zeros(tree: KinematicTree, links: Array, motion: Motion) -> Array:
    """(S, n, n) torque for another zero of each joint, of links (n, 10)."""
    made = []
    for j in range(tree.n):
        step = _STEP * (np.arange(tree.n) == j)
        ahead, behind = (inverse_dynamics(tree, links, motion.q + s, motion.v, motion.a) for s in (step, -step))
        made.append((ahead - behind) / (2.0 * _STEP))
    return np.stack(made, axis=-1)


def _ripples(tree: KinematicTree, motion: Motion) -> Array:
    """(S, n, 2 r) torque of each of r hinges that comes again with a turn of its own."""
    made = [
        wave(motion.q[:, j, None]) * (np.arange(tree.n) == j)
        for j in np.flatnonzero(~tree.prismatic)
        for wave in (np.cos, np.sin)
    ]
    return np.stack(made, axis=-1) if made else np.zeros((*motion.q.shape, 0))
