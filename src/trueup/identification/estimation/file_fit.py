# SPDX-License-Identifier: Apache-2.0
"""The best model of the form that a model file can hold: possible bodies, rotors, Coulomb and viscous friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array, Mask
from trueup.identification.effects import SPRINGS
from trueup.identification.estimation.consistent import consistent_fit
from trueup.identification.estimation.moments import Moments, weighted_fit
from trueup.identification.estimation.pool import Pool
from trueup.identification.kinematic_tree import KinematicTree
from trueup.rounding import PRINTED, TINY
from trueup.samples import thinned

_FRICTION = ("coulomb", "viscous")


@dataclass(frozen=True, eq=False)
class FileFit:
    """What is written to a model file; arrays have a row for each joint."""

    inertial: Array
    """(n, 10) bodies that can exist."""
    armature: Array
    """Rotor inertias, kg m^2 (kg)."""
    friction: Array
    """Coulomb, N m (N)."""
    damping: Array
    """Viscous, N m s/rad (N s/m)."""
    boundary: tuple[int, ...]
    """Links that stopped at the edge of what is possible."""
    stiffness: Array
    """Of torsion springs, N m/rad (N/m); zero for none."""
    slack: Array
    """rad (m) where these pull to neither side."""
    springs: tuple[str, ...]
    """Torque of every spring in words, a function of the joint's q; "" where there is none."""

    def tree(self, tree: KinematicTree) -> KinematicTree:
        """The tree with these numbers."""
        names = ("inertial", "armature", "friction", "damping", "stiffness", "slack")
        return tree.replace(**{name: getattr(self, name) for name in names})


def file_fit(
    pool: Pool, moments: Moments, nominal: Array, pull: float, speeds: Sequence[Array], active: Mask
) -> FileFit:
    """Fits bodies, rotors and friction together, all above zero, joints weighed by what this form leaves of their torque.

    Friction of any other form would be missing in the file, and what it explained is better shared out by a fit than left
    out. `nominal` (p,) is the file, `pull` as in `consistent_fit`, `speeds` (S, n) are those of the joints in the logs, for
    drives that turn with several of them: files know friction of joints only. `active` (p,) are the columns of the model
    that was chosen: its springs are fitted beside bodies, which are no lighter where a file cannot hold them.
    """
    model, n = pool.model, pool.model.tree.n
    columns = np.concatenate([np.array(pool.groups[kind]) for kind in _FRICTION])
    mask, springs = pool.with_groups("rotor", *_FRICTION), _springs(pool, active)
    mask[[k for columns in springs for k in columns]] = True
    scaled, variance = weighted_fit(moments, np.flatnonzero(mask), np.zeros(model.p))
    size = np.abs(moments.parameters(scaled))
    prior = nominal.copy()
    for kind in _FRICTION:
        own = np.array(pool.groups[kind])
        prior[own] = np.maximum(size[own], max(PRINTED * float(size[own].max()), TINY))
    whole = moments.normal(1.0 / variance / np.mean(1.0 / variance)).whole()
    fit = consistent_fit(model, whole, np.flatnonzero(mask), prior, pull=pull, positive=columns)
    rotors, coulomb, viscous = (fit.parameters[np.array(pool.groups[kind])] for kind in ("rotor", *_FRICTION))
    coupled = np.count_nonzero(model.drives) > n
    if coupled:
        rotors, coulomb, viscous = _at_joints(model.drives, rotors, coulomb, viscous, np.concatenate(speeds))
    stiffness, slack, said = _springs_in_words(pool, springs, fit.parameters)
    return FileFit(
        fit.parameters[: 10 * n].reshape(n, 10), rotors, coulomb, viscous, fit.boundary, stiffness, slack, said
    )


def _springs(pool: Pool, active: Mask) -> list[list[int]]:
    """For each joint the columns of its spring, with an offset, that nothing at rest tells from where it is slack."""
    known = active.copy()
    known[pool.tied] = True
    each = [[k for kind in SPRINGS["strut"] if known[k := pool.groups[kind][j]]] for j in range(pool.model.tree.n)]
    return [[*columns, pool.groups["offset"][j]] if columns else [] for j, columns in enumerate(each)]


def _springs_in_words(
    pool: Pool, springs: Sequence[Sequence[int]], parameters: Array
) -> tuple[Array, Array, tuple[str, ...]]:
    """Stiffness and where it is slack (n,) of springs of torsion, and the torque of all of them, by joint."""
    effects, torsion = pool.model.effects, np.array(pool.groups["torsion"])
    alone = np.array([len(columns) == 2 and torsion[j] in columns for j, columns in enumerate(springs)])
    stiffness = np.where(alone, parameters[torsion], 0.0)
    offset = -parameters[np.array(pool.groups["offset"])]
    slack = np.divide(offset, stiffness, out=np.zeros(len(stiffness)), where=stiffness != 0.0)
    first = 10 * pool.model.tree.n
    said = [
        " + ".join(
            f"{parameters[k]:.5g} {effects[k - first][1].formula}".removesuffix(" 1.0") for k in columns
        ).replace("+ -", "- ")
        for columns in springs
    ]
    return stiffness, slack, tuple(said)


def _at_joints(
    drives: Array, rotors: Array, coulomb: Array, viscous: Array, speed: Array
) -> tuple[Array, Array, Array]:
    """Rotors, Coulomb and viscous friction of joints that come nearest to those of drives which turn with several joints.

    Nearest in motion in which joints turn independently, each as fast as in the logs `speed` (S, n): in one log joints may
    turn together, which another does not.
    """
    from scipy.optimize import nnls  # half a second to load, and rarely needed

    squares = drives.T**2
    turned = np.stack([np.roll(v, j * len(v) // len(drives)) for j, v in enumerate(speed.T)], axis=1)
    turned = thinned(turned, 2000)
    through = turned @ drives.T
    torque = (coulomb * np.sign(through) + viscous * through) @ drives
    pairs = [nnls(np.column_stack([np.sign(v), v]), t)[0] for v, t in zip(turned.T, torque.T, strict=True)]
    return squares @ rotors, np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])
