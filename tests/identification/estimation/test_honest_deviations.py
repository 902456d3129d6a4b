# SPDX-License-Identifier: Apache-2.0
"""Deviations hold the truth about as often as they claim where friction has a form that no column has."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from trueup.identification.estimation.identify import identify
from trueup.identification.kinematic_tree import KinematicTree
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]
SEEDS = 4


def presliding(q: Array, travel: float) -> Array:
    """(S, n) -1 ... 1: friction that builds up over a travel after each reversal (P. Dahl, 1968)."""
    z = np.zeros_like(q)
    for k, step in enumerate(np.diff(q, axis=0), 1):
        z[k] = np.clip(z[k - 1] + step / travel * (1.0 - np.sign(step) * z[k - 1]), -1.0, 1.0)
    return z


def logged(tree: KinematicTree, arms: SimpleNamespace, seed: int, name: str) -> Recording:
    """20 s at 200 Hz of an arm whose friction also falls with speed."""
    rng, time = np.random.default_rng(seed), np.arange(4000) / 200.0
    q, v, a = arms.sines(rng, time, tree.n)
    falls = 1.0 + 0.3 * np.exp(-((v / 0.1) ** 2))
    stuck = arms.coulomb * (falls * presliding(q, 0.01) - np.tanh(v / 0.02))
    torque = arms.torque(tree, q, v, a) + stuck + 0.2 * rng.normal(size=q.shape)
    return Recording(
        name,
        {
            "position": Channel("position", tree.joints, "rad", time, q + 2e-5 * rng.normal(size=q.shape)),
            "torque": Channel("torque", tree.joints, "N m", time, torque),
        },
    )


def test_friction_after_reversals_does_not_make_bodies_seem_more_certain_than_they_are(arms: SimpleNamespace) -> None:
    tree, errors = arms.arm(), list[float]()
    for seed in range(SEEDS):
        found = identify(tree, [logged(tree, arms, 2 * seed + k, f"run{k}") for k in range(2)])
        # Rotors, which the file does not hold, have an m at the end.
        known = [p for p in found.parameters if p.kind == "inertial" and not re.search(r"I\dm", p.name)]
        errors += [(p.value - p.file) / p.deviation for p in known]
    assert np.sqrt(np.mean(np.square(errors))) < 1.1
