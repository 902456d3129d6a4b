# SPDX-License-Identifier: Apache-2.0
"""A simulated arm whose truth is known, and its logs: what the tests of identification share."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.identification.inertial import from_pseudo_inertia
from trueup.identification.kinematic_tree import KinematicTree, from_dh
from trueup.identification.regressors import inverse_dynamics
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]

ROTORS = np.array([0.4, 0.5, 0.12, 0.03])
COULOMB = np.array([6.0, 5.0, 2.0, 1.0])
VISCOUS = np.array([4.0, 3.0, 1.5, 0.6])


def bodies(rng: np.random.Generator, masses: Array) -> Array:
    """(n, 10) bodies made of eight lumps each: such a body can exist."""
    made = []
    for mass in masses:
        lumps = np.column_stack([rng.uniform(-0.15, 0.15, (8, 3)) + rng.uniform(-0.1, 0.1, 3), np.ones(8)])
        made.append(from_pseudo_inertia(lumps.T @ lumps * mass / 8.0))
    return np.array(made)


def arm(seed: int = 0) -> KinematicTree:
    """Four revolute joints; the file's inertias are the truth (tests hide them where they should not be known)."""
    rng = np.random.default_rng(seed)
    return from_dh(
        a=[0.1, 0.4, 0.0, 0.0], alpha=[np.pi / 2, 0.0, np.pi / 2, 0.0], d=[0.3, 0.0, 0.0, 0.35], name="arm",
        inertial=bodies(rng, np.array([12.0, 8.0, 4.0, 1.5])), effort=np.array([200.0, 200.0, 80.0, 20.0]),
        speed=np.full(4, 3.0), lower=np.full(4, -3.0), upper=np.full(4, 3.0),
    )  # fmt: skip


def sines(rng: np.random.Generator, time: Array, n: int, *, size: float = 1.0) -> tuple[Array, Array, Array]:
    """Positions, speeds, accelerations (S, n) of sums of five sines below 0.8 Hz, phases at random."""
    w = 2.0 * np.pi * rng.uniform(0.05, 0.8, (5, n))
    amplitude, phase = size * rng.uniform(0.2, 1.0, (5, n)) / (0.5 + w), rng.uniform(0.0, 2.0 * np.pi, (5, n))
    at = w[None] * time[:, None, None] + phase
    q = np.sum(amplitude * np.sin(at), axis=1)
    return q, np.sum(amplitude * w * np.cos(at), axis=1), -np.sum(amplitude * w**2 * np.sin(at), axis=1)


def torque(tree: KinematicTree, q: Array, v: Array, a: Array, *, quadratic: float = 0.0) -> Array:
    """(S, n) of the arm with rotors and friction; Coulomb friction sets in over 0.02 rad/s."""
    friction = COULOMB * np.tanh(v / 0.02) + VISCOUS * v + quadratic * COULOMB * v * np.abs(v)
    return inverse_dynamics(tree, np.asarray(tree.inertial), q, v, a) + ROTORS * a + friction


def recording(
    tree: KinematicTree, rng: np.random.Generator, name: str = "run", *, seconds: float = 20.0, rate: float = 200.0,
    noise: float = 0.5, late: float = 0.0, quadratic: float = 0.0, size: float = 1.0,
) -> Recording:  # fmt: skip
    """A log of positions (noise 2e-5 rad) and torques (white noise in N m), torque `late` s against position."""
    time = np.arange(int(seconds * rate)) / rate
    seed = int(rng.integers(2**32))
    q = sines(np.random.default_rng(seed), time, tree.n, size=size)[0]
    then = sines(np.random.default_rng(seed), time - late, tree.n, size=size)
    loads = torque(tree, *then, quadratic=quadratic)
    return Recording(
        name,
        {
            "position": Channel("position", tree.joints, "rad", time, q + 2e-5 * rng.normal(size=q.shape)),
            "torque": Channel("torque", tree.joints, "N m", time, loads + noise * rng.normal(size=q.shape)),
        },
    )


def without_file(tree: KinematicTree) -> KinematicTree:
    """The tree as it comes from a file without inertias."""
    return replace(tree, inertial=np.full((tree.n, 10), np.nan))


@pytest.fixture(scope="session")
def arms() -> SimpleNamespace:
    """The functions and the truth above, for tests (test folders are no packages)."""
    return SimpleNamespace(
        arm=arm, sines=sines, recording=recording, without_file=without_file, bodies=bodies, torque=torque, rotors=ROTORS,
        coulomb=COULOMB, viscous=VISCOUS,
    )  # fmt: skip
