# SPDX-License-Identifier: Apache-2.0
"""Finds drives that turn with several joints, as in many wrists, in the recordings: nobody need know the gears' drawing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.moments import RIDGE, blocks_of, moments_of
from trueup.identification.estimation.motion import Motion, pieces_of
from trueup.identification.estimation.pool import pool_for
from trueup.identification.estimation.selection import BLOCKS, Choice, reweighed
from trueup.identification.kinematic_tree import KinematicTree

Array = NDArray[np.float64]

_RATIOS = (-1.0, -0.5, 0.5, 1.0)
"""That are tried first; between them the loss is smooth, so that it can be followed down from the best."""
_WRIST = 5


def coupled(
    motion: Motion, tree: KinematicTree, drives: Drives, cutoff: float, hold_out: float
) -> tuple[Drives, tuple[str, ...]]:
    """Drives of the last three joints that turn with another of them, where that predicts clearly better, and notes.

    Joint angles and torques that a controller has decoupled already still show the friction and rotor of the drive that
    turns with two joints. A ratio of one, as most gears are cut, gives way only to one that is clearly better. Nothing is
    looked for where couplings are given or the log is of motors. The share held out is not looked at.
    """
    n, C = tree.n, drives.coupling
    if n < _WRIST or np.count_nonzero(C) > n or drives.motor_positions or drives.motor_torques:
        return drives, ()
    from scipy.optimize import minimize_scalar  # half a second to load, and rarely needed

    basic = _Basic(motion, tree, cutoff, hold_out)
    pairs, notes = [(n - 2, n - 3), (n - 1, n - 2), (n - 1, n - 3)], []
    best = basic.choice(C)
    while pairs:
        tried = [(basic.choice(_with(C, pair, r)), pair, r) for pair in pairs for r in _RATIOS]
        new, pair, ratio = min(tried, key=lambda entry: entry[0].loss)
        if not new.beats(best):
            break
        loss = partial(lambda r, C, pair: basic.choice(_with(C, pair, float(r))).loss, C=C, pair=pair)
        lowest: Any = minimize_scalar(loss, bounds=(ratio - 0.5, ratio + 0.5), method="bounded")
        exact = float(lowest.x)
        other = basic.choice(_with(C, pair, exact))
        if abs(ratio) < 1.0 or other.beats(new):
            new, ratio = other, exact
        notes.append(
            f"the drive of {tree.joints[pair[0]]} turns with {tree.joints[pair[1]]} too (ratio {ratio:.3g}): its "
            "friction and rotor were taken so; say what is true in a drives file, [[couplings]]"
        )
        best, C = new, _with(C, pair, ratio)
        pairs.remove(pair)
    return replace(drives, coupling=C) if notes else drives, tuple(notes)


@dataclass(frozen=True, eq=False)
class _Basic:
    """A basic model of the arm (rotors, offsets, viscous and Coulomb friction) for any coupling of its drives."""

    motion: Motion
    tree: KinematicTree
    cutoff: float
    hold_out: float

    def choice(self, C: Array) -> Choice:
        """The model with its errors on blocks that were left out of the part that is fitted."""
        model, active = pool_for(self.tree, C, [self.motion]).basic()
        rows = pieces_of(self.motion, model, self.cutoff, self.hold_out)[0].rows
        moments = moments_of(blocks_of([rows], BLOCKS, 1.0 / self.cutoff))
        mask = np.isin(np.arange(model.p), active)
        return reweighed(moments, np.zeros(model.p), Choice(mask, RIDGE, np.ones(self.tree.n)))


def _with(C: Array, pair: tuple[int, int], ratio: float) -> Array:
    other = C.copy()
    other[pair] = ratio
    return other
