# SPDX-License-Identifier: Apache-2.0
"""The best model of the form that a model file can hold: possible bodies, rotors, Coulomb and viscous friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trueup.arrays import Array
from trueup.identification.estimation.consistent import consistent_fit
from trueup.identification.estimation.moments import Moments, weighted_fit
from trueup.identification.estimation.pool import Pool
from trueup.identification.kinematic_tree import KinematicTree
from trueup.rounding import TINY
from trueup.samples import thinned

_FRICTION = ("coulomb", "viscous")
_LEAST = 1e-3
"""Of the largest friction: the size that one has at least, for a barrier that keeps it above zero."""


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

    def tree(self, tree: KinematicTree) -> KinematicTree:
        """The tree with these numbers."""
        names = ("inertial", "armature", "friction", "damping")
        return tree.replace(**{name: getattr(self, name) for name in names})


def file_fit(pool: Pool, moments: Moments, nominal: Array, pull: float, speeds: Sequence[Array]) -> FileFit:
    """Fits bodies, rotors and friction together, all above zero, joints weighed by what this form leaves of their torque.

    Friction of any other form would be missing in the file, and what it explained is better shared out by a fit than left
    out. `nominal` (p,) is the file, `pull` as in `consistent_fit`, `speeds` (S, n) are those of the joints in the logs, for
    drives that turn with several of them: files know friction of joints only.
    """
    model, n = pool.model, pool.model.tree.n
    columns = np.concatenate([np.array(pool.groups[kind]) for kind in _FRICTION])
    mask = pool.with_groups("rotor", *_FRICTION)
    scaled, variance = weighted_fit(moments, np.flatnonzero(mask), np.zeros(model.p))
    size = np.abs(moments.parameters(scaled))
    prior = nominal.copy()
    for kind in _FRICTION:
        own = np.array(pool.groups[kind])
        prior[own] = np.maximum(size[own], max(_LEAST * float(size[own].max()), TINY))
    whole = moments.normal(1.0 / variance / np.mean(1.0 / variance)).whole()
    fit = consistent_fit(model, whole, np.flatnonzero(mask), prior, pull=pull, positive=columns)
    rotors, coulomb, viscous = (fit.parameters[np.array(pool.groups[kind])] for kind in ("rotor", *_FRICTION))
    coupled = np.count_nonzero(model.drives) > n
    if coupled:
        rotors, coulomb, viscous = _at_joints(model.drives, rotors, coulomb, viscous, np.concatenate(speeds))
    return FileFit(fit.parameters[: 10 * n].reshape(n, 10), rotors, coulomb, viscous, fit.boundary)


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
