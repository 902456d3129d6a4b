# SPDX-License-Identifier: Apache-2.0
"""Clocks of torque and position: a late log is told from friction that only looks like one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from trueup.identification.estimation.identify import Options, identify
from trueup.identification.estimation.result import relative_error
from trueup.identification.kinematic_tree import KinematicTree
from trueup.identification.regressors import inverse_dynamics
from trueup.recording import Channel, Recording

Array = NDArray[np.float64]


def moves(rng: np.random.Generator, time: Array, n: int, pause: float) -> Array:
    """(S, n) joint moves of smooth speed from pose to pose, up to `pause` s of rest between them."""
    q, at, now = np.zeros((len(time), n)), 0.0, np.zeros(n)
    while at < time[-1]:
        goal = rng.uniform(-1.5, 1.5, n)
        share = np.clip((time - at) / rng.uniform(0.6, 1.6), 0.0, 1.0)[:, None]
        later = time >= at
        q[later] = (now + (goal - now) * share**3 * (10.0 - 15.0 * share + 6.0 * share**2))[later]
        at, now = float(time[np.flatnonzero(share[:, 0] < 1.0)[-1]]) + pause * rng.uniform(), goal
    return q


def log(
    tree: KinematicTree, arms: SimpleNamespace, rng: np.random.Generator, name: str, late: float = 0.0
) -> Recording:
    """60 s of moves with pauses, at 200 Hz; friction is higher near standstill, grows with load, bends down."""
    fine = np.arange(0.0, 60.0, 1e-3)
    q = moves(rng, fine, tree.n, 4.0)
    v = np.gradient(q, 1e-3, axis=0)
    a = np.gradient(v, 1e-3, axis=0)
    carried = inverse_dynamics(tree, np.asarray(tree.inertial), q, v, a)
    sliding = 0.4 * arms.coulomb * (1.0 + 0.3 * np.exp(-((v / 0.2) ** 2))) + 0.05 * np.abs(carried)
    loads = (
        carried + arms.rotors * a + sliding * np.tanh(v / 0.004) + 0.4 * arms.viscous * np.sign(v) * np.abs(v) ** 0.8
    )
    time = np.arange(0.1, 59.9, 5e-3)
    position, torque = (
        np.stack([np.interp(t, fine, column) for column in x.T], axis=1) for t, x in ((time, q), (time - late, loads))
    )
    position = position + 1e-5 * rng.normal(size=position.shape)
    torque = torque + 0.1 * rng.normal(size=torque.shape)
    channels = {
        "position": Channel("position", tree.joints, "rad", time, position),
        "torque": Channel("torque", tree.joints, "N m", time, torque),
    }
    return Recording(name, channels)


@pytest.mark.parametrize(("late", "seed"), [(0.0, 0), (0.0, 1), (0.008, 0)])
def test_friction_of_moves_with_pauses_is_not_taken_for_a_late_clock_and_a_late_clock_is(
    arms: SimpleNamespace, late: float, seed: int
) -> None:
    tree, rng = arms.arm(), np.random.default_rng(seed)
    runs = [log(tree, arms, rng, name, late) for name in ("run", "other")]
    found = identify(arms.without_file(tree), runs[:1], runs[1:], options=Options(consistent=False))
    assert found.alignment is not None
    assert found.alignment.corrected == (late > 0.0)
    if late:
        assert found.alignment.shift == pytest.approx(late, abs=0.0025)
    assert relative_error(found.held_out()) < 0.02


def test_a_late_clock_is_found_in_a_log_with_gaps(arms: SimpleNamespace) -> None:
    tree, rng = arms.arm(), np.random.default_rng(5)
    runs = [_with_gaps(log(tree, arms, rng, name, 0.012)) for name in ("run", "other")]
    found = identify(arms.without_file(tree), runs[:1], runs[1:], options=Options(consistent=False))
    assert found.alignment is not None
    assert found.alignment.shift == pytest.approx(0.012, abs=0.0025)
    assert relative_error(found.held_out()) < 0.02


def _with_gaps(recording: Recording) -> Recording:
    """Without three stretches of one second, which a logger dropped."""
    time = recording.channel("position").time
    keep = np.all([(time < start) | (time > start + 1.0) for start in (11.0, 25.0, 44.0)], axis=0)
    channels = {name: c.replace(time=c.time[keep], values=c.values[keep]) for name, c in recording.channels.items()}
    return recording.replace(channels=channels)


def test_torque_that_comes_a_few_milliseconds_late_is_found_between_the_shifts_that_are_looked_at(
    arms: SimpleNamespace,
) -> None:
    tree, rng = arms.arm(), np.random.default_rng(2)
    run = arms.recording(tree, rng, seconds=30.0, noise=0.1, late=0.0025)
    found = identify(arms.without_file(tree), [run], options=Options(consistent=False)).alignment
    assert found is not None
    assert found.corrected
    assert found.shift == pytest.approx(0.0025, abs=0.0005)
