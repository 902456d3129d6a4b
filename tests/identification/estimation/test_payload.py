# SPDX-License-Identifier: Apache-2.0
"""Torque constants come out of two runs with currents alone, where one carried a known mass."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from trueup.errors import IdentificationError
from trueup.identification.estimation.drives import Drives
from trueup.identification.estimation.estimate import least_squares, with_doubtful_torque
from trueup.identification.estimation.payload import drives_from_payload, payload_inertial
from trueup.identification.regressors import inverse_dynamics
from trueup.identification.rows import Rows
from trueup.recording import Channel, Recording


def test_a_payload_without_mass_is_refused() -> None:
    with pytest.raises(IdentificationError, match="above 0"):
        payload_inertial(0.0, (0.0, 0.0, 0.0))


def test_logs_of_currents_become_torques_by_a_run_with_a_payload(arms: SimpleNamespace) -> None:
    tree, rng = arms.arm(), np.random.default_rng(3)
    hidden, load = np.array([11.0, 9.0, 6.0, 2.5]), payload_inertial(4.0, (0.05, 0.0, 0.1))
    heavy = tree.replace(inertial=np.asarray(tree.inertial) + np.outer([0, 0, 0, 1], np.nan_to_num(load)))
    runs = []
    for real in (tree, heavy):
        run = arms.recording(real, rng, seconds=30.0)
        torque = run.channel("torque")
        runs.append(
            run.without("torque").with_channel(torque.replace(name="current", unit="A", values=torque.values / hidden))
        )
    drives, notes = drives_from_payload(tree, runs[:1], runs[1:], Drives.direct(tree.joints), load)
    assert np.allclose(drives.constants[1:3], hidden[1:3], rtol=0.05)
    assert "torque constants from the payload" in notes[0]
    unknown, notes = drives_from_payload(tree, runs[:1], runs[1:], Drives.direct(tree.joints), payload_inertial(4.0))
    assert np.allclose(unknown.constants[1:3], hidden[1:3], rtol=0.1)
    assert "--payload-com" in notes[1]


def test_friction_that_grows_with_the_payload_does_not_pass_for_a_torque_constant(arms: SimpleNamespace) -> None:
    tree, hidden, load = arms.arm(), np.array([11.0, 9.0, 6.0, 2.5]), payload_inertial(4.0, (0.05, 0.0, 0.1))
    heavy = tree.replace(inertial=np.asarray(tree.inertial) + np.outer([0, 0, 0, 1], np.nan_to_num(load)))
    rng, time, runs = np.random.default_rng(5), np.arange(0.0, 30.0, 0.005), []
    for real in (tree, heavy):
        q, v, a = arms.sines(rng, time, tree.n)
        rubbing = 0.2 * np.abs(inverse_dynamics(real, np.asarray(real.inertial), q, v, a)) * np.tanh(v / 0.02)
        amperes = (arms.torque(real, q, v, a) + rubbing + 0.3 * rng.normal(size=q.shape)) / hidden
        channels = {"position": Channel("position", tree.joints, "rad", time, q),
                    "current": Channel("current", tree.joints, "A", time, amperes)}  # fmt: skip
        runs.append(Recording("run", channels))
    drives, _ = drives_from_payload(tree, runs[:1], runs[1:], Drives.direct(tree.joints), load)
    assert np.allclose(drives.constants[:3], hidden[:3], rtol=0.008)


def test_friction_that_falls_with_speed_does_not_pass_for_a_torque_constant(arms: SimpleNamespace) -> None:
    tree, hidden, load = arms.arm(), np.array([11.0, 9.0, 6.0, 2.5]), payload_inertial(4.0, (0.05, 0.0, 0.1))
    heavy = tree.replace(inertial=np.asarray(tree.inertial) + np.outer([0, 0, 0, 1], np.nan_to_num(load)))
    time, off = np.arange(0.0, 30.0, 0.005), []
    for seed in range(3):
        rng, runs = np.random.default_rng(seed), []
        for real in (tree, heavy):
            q, v, a = arms.sines(rng, time, tree.n)
            stribeck = 0.6 * arms.coulomb * np.exp(-((v / 0.1) ** 2)) * np.tanh(v / 0.02)
            amperes = (arms.torque(real, q, v, a) + stribeck + 0.1 * rng.normal(size=q.shape)) / hidden
            channels = {"position": Channel("position", tree.joints, "rad", time, q),
                        "current": Channel("current", tree.joints, "A", time, amperes)}  # fmt: skip
            runs.append(Recording("run", channels))
        drives, _ = drives_from_payload(tree, runs[:1], runs[1:], Drives.direct(tree.joints), load)
        off.append(drives.constants / hidden - 1.0)
    assert np.sqrt(np.mean(np.square(off), axis=0)).max() < 0.01


def test_what_is_not_known_of_a_torque_constant_is_not_known_of_what_its_torque_tells() -> None:
    rng, own = np.random.default_rng(6), np.array([2.0, 5.0])
    speed = rng.normal(size=(2, 1, 400))
    torque = (own[:, None] * speed[:, 0] + 0.01 * rng.normal(size=(2, 400))).T
    rows = [Rows((np.array([0]), np.array([1])), tuple(speed), torque, np.arange(400.0), 2)]
    exact = least_squares(rows, [0, 1])
    doubtful = with_doubtful_torque(exact, rows, np.array([0.0, 0.05]))
    np.testing.assert_allclose(doubtful.deviations, [exact.deviations[0], 0.05 * own[1]], rtol=0.02)
    np.testing.assert_array_equal(doubtful.parameters, exact.parameters)
