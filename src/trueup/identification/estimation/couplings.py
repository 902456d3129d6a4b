# SPDX-License-Identifier: Apache-2.0
"""Finds drives that turn with several joints, as in many wrists, in the recordings: nobody need know the gears' drawing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trueup.arrays import Array, Integers
from trueup.identification.dynamic_model import DynamicModel
from trueup.identification.estimation.blocks import blocks_of, numbered
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.moments import RIDGE, moments_of
from trueup.identification.estimation.motion import Motion, Piece, pieces_of
from trueup.identification.estimation.pool import pool_for
from trueup.identification.estimation.selection import TIME_BLOCKS, Choice, reweighed
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.rows import Rows
from trueup.rounding import TINY

Pair = tuple[int, int]
"""A drive, and a joint beside its own that it turns with too."""

_RATIOS = (-1.0, -0.5, -0.2, 0.2, 0.5, 1.0)
"""That are tried first; between them the loss is smooth, so that it can be followed down from the best."""
_PITCHES = tuple(sign * size for sign in (-1.0, 1.0) for size in (0.03, 0.06, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0))
"""The same where one of the two slides and the other turns, of what the drive's own joint moves (rms speeds): a screw's pitch
may be any, and a log may move one joint much and the other little."""
_NEAR, _ROUGH, _EXACT = 0.1, 0.03, 0.005
"""First steps of that search in the ratios, those that tell whether one more pair is coupled, and the last ones."""


def coupled(motions: Sequence[Motion], tree: KinematicTree, drives: Drives, cutoff: float, hold_out: float) -> Drives:
    """Drives of the last three joints that turn with others of them, and the screw that lifts the tool of a SCARA and turns
    with it, where that predicts clearly better; `drives` else.

    Joint angles and torques that a controller has decoupled already still show the friction and rotor of a drive that
    turns with several joints. Couplings come one by one, the ratios of all of them followed down together each time: one
    left out leads those beside it astray. A ratio of one, as most gears are cut, gives way only to one that is clearly
    better. Nothing is looked for where couplings are given or the log is of motors. The share held out is not looked at.
    """
    n, rest, ratios = tree.n, _pairs(tree), dict[Pair, float]()
    if not rest or np.count_nonzero(drives.coupling) > n or drives.motor_positions or drives.motor_torques:
        return drives
    basic = _Basic.of(motions, tree, cutoff, hold_out, drives.springs)
    best = basic.choice(ratios)
    while rest:
        tried = [{**ratios, p: r} for p in rest for r in (_PITCHES if _mixed(tree, p) else _RATIOS)]
        more = basic.lowest(min(tried, key=lambda each: basic.choice(each).loss), _ROUGH)
        if not (new := basic.choice(more)).beats(best):
            break
        best, ratios = new, more
        # Of a screw the nut or the spline turns with the other.
        rest = [pair for pair in rest if pair not in ratios and pair[::-1] not in ratios]
    if not ratios:
        return drives
    ratios = basic.lowest(ratios, _EXACT)
    best = basic.choice(ratios)
    for pair, ratio in [(p, r) for p, r in ratios.items() if not _mixed(tree, p)]:
        plain = {**ratios, pair: float(np.sign(ratio))}
        if not best.beats(other := basic.choice(plain)):
            best, ratios = other, plain
    return replace(drives, coupling=basic.coupling(ratios))


def _pairs(tree: KinematicTree) -> list[Pair]:
    """Which drives may turn with which joints: in a wrist, and where the last two joints slide and turn."""
    n, wrist = tree.n, 5
    pairs = [(n - 2, n - 3), (n - 1, n - 2), (n - 1, n - 3)] if n >= wrist else []
    screw = [(n - 2, n - 1), (n - 1, n - 2)] if n > 1 and _mixed(tree, (n - 2, n - 1)) else []
    return [*pairs, *(p for p in screw if p not in pairs)]


def _mixed(tree: KinematicTree, pair: Pair) -> bool:
    """Whether one of two joints slides and the other turns."""
    return bool(tree.prismatic[pair[0]] != tree.prismatic[pair[1]])


def confirmed(coupling: Drives, drives: Drives, choices: Callable[[Drives], Sequence[Choice]]) -> Drives:
    """The drives with those couplings alone without which the model of torque predicts worse what its fit did not see.

    `choices` are that model with its errors on left-out blocks of time, and on left-out kinds of motion. `coupling` was
    found beside basic friction, by clear evidence; `drives` have none. Friction of another form (with load, or that falls
    with speed) is explained in part by a drive that turns a little with another joint, until it is in the model itself. The
    models that were selected with and without a coupling are alternatives, of which the better one is taken: in a narrow
    log friction stands in for much of a coupling, and would win by default if that had to be clear a second time.
    """

    def better(one: Drives, other: Drives) -> bool:
        return all(a.loss < b.loss for a, b in zip(choices(one), choices(other), strict=True))

    pairs = [(int(d), int(j)) for d, j in np.argwhere(coupling.coupling != drives.coupling)]
    if pairs and not better(coupling, drives):
        return drives
    for pair in pairs if len(pairs) > 1 else ():
        less = coupling.coupling.copy()
        less[pair] = 0.0
        without = replace(coupling, coupling=less)
        if not better(coupling, without):
            coupling = without
    return coupling


def coupling_notes(coupling: Drives, drives: Drives) -> list[str]:
    """What to say of the couplings that `drives` lack."""
    pairs = [(int(d), int(j)) for d, j in np.argwhere(coupling.coupling != drives.coupling)]
    return [
        f"the drive of {drives.joints[d]} turns with {drives.joints[j]} too (ratio {coupling.coupling[d, j]:.3g}): its "
        "friction and rotor were taken so; say what is true in a drives file, [[couplings]]"
        for d, j in pairs
    ]


@dataclass(frozen=True, eq=False)
class _Basic:
    """A basic model of the arm (rotors, offsets, viscous and Coulomb friction) for any coupling of its drives."""

    model: DynamicModel
    """Without couplings."""
    active: Integers
    pieces: Sequence[Piece]
    numbers: Sequence[Integers]
    """Of the block of each sample."""
    margin: float
    """s that are left out at both ends of blocks."""
    unit: Array
    """(n, n) in which a ratio of the drives (rows) to joints (columns) is told."""

    @classmethod
    def of(
        cls, motions: Sequence[Motion], tree: KinematicTree, cutoff: float, hold_out: float, springs: Sequence[str]
    ) -> _Basic:
        """What is the same for all couplings: the columns of links, and of the other drives."""
        model, active = pool_for(tree, np.eye(tree.n), motions, springs=springs).basic()
        pieces = [pieces_of(m, model, cutoff, hold_out)[0] for m in motions]
        numbers = numbered([p.rows for p in pieces], TIME_BLOCKS, [p.motion.q for p in pieces])
        speed = np.sqrt(np.mean(np.concatenate([m.v for m in motions]) ** 2, axis=0))
        mixed = tree.prismatic[:, None] != tree.prismatic
        unit = np.where(mixed, speed[:, None] / np.maximum(speed, TINY), 1.0)
        return cls(model, active, pieces, numbers, 1.0 / cutoff, unit)

    def coupling(self, ratios: Mapping[Pair, float]) -> Array:
        """(n, n) speeds of the drives for those of the joints."""
        C = np.eye(self.model.tree.n)
        for pair, ratio in ratios.items():
            C[pair] = ratio * self.unit[pair]
        return C

    def choice(self, ratios: Mapping[Pair, float]) -> Choice:
        """The model with its errors on blocks that were left out of the part that is fitted."""
        rows = [self._driven(piece, self.coupling(ratios)) for piece in self.pieces]
        moments = moments_of(blocks_of(rows, self.numbers, self.margin))
        mask = np.isin(np.arange(self.model.p), self.active)
        return reweighed(moments, np.zeros(self.model.p), Choice(mask, RIDGE, np.ones(self.model.tree.n)))

    def _driven(self, piece: Piece, C: Array) -> Rows:
        """The rows of a piece with the columns of those drives anew that turn with several joints."""
        n, rows, whole = self.model.tree.n, piece.rows, piece.whole
        coupled = np.flatnonzero(np.count_nonzero(C, axis=1) > 1)
        new = [(10 * n + k, d, effect) for k, (d, effect) in enumerate(self.model.effects) if d in coupled]
        if not new:
            return rows
        q, v, a = (x @ C.T for x in (whole.q, whole.v, whole.a))
        made = np.stack([effect.column(q[:, d], v[:, d], a[:, d]) for _, d, effect in new], axis=1)
        own, at = piece.passed(made)[piece.keep].T, np.array([k for k, _, _ in new])
        of, columns, values = C[[d for _, d, _ in new]], list(rows.columns), list(rows.values)
        for j in range(n):
            stays, turns = ~np.isin(columns[j], at), np.flatnonzero(of[:, j])
            columns[j] = np.concatenate([columns[j][stays], at[turns]])
            values[j] = np.concatenate([values[j][stays], of[turns, j, None] * own[turns]])
        return replace(rows, columns=tuple(columns), values=tuple(values))

    def lowest(self, ratios: Mapping[Pair, float], exact: float) -> dict[Pair, float]:
        """The ratios of these pairs that predict best, followed down from the given ones (Nelder & Mead, 1965)."""
        from scipy.optimize import minimize  # half a second to load, and rarely needed

        pairs, start = list(ratios), np.array(list(ratios.values()))
        simplex = start + np.vstack([np.zeros(len(start)), _NEAR * np.eye(len(start))])
        found: Any = minimize(
            lambda r: self.choice(dict(zip(pairs, r.tolist(), strict=True))).loss, start, method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": exact, "fatol": np.inf},
        )  # fmt: skip
        return dict(zip(pairs, found.x.tolist(), strict=True))
